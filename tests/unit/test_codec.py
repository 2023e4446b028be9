"""Encoding refuses what isn't finite; decoding refuses what the contract doesn't allow."""

import json
import math

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jezero.runtime.codec import BadPayloadError, NotFiniteError, decode, decode_request, encode
from jezero.schemas.actions import GoToGoal, TakeoffGoal
from jezero.schemas.commands import Hover, Phase, Setpoint
from jezero.schemas.sensors import Altimeter
from jezero.schemas.state import Clock
from jezero.schemas.topics import ACTIONS, ENDPOINTS, TOPICS

SETPOINT = Setpoint(t_ns=5, control_id="c", sequence=1, phase=Phase.GO_TO, vel_ned_mps=(1.0, 2.0, 3.0))


def test_a_message_survives_the_round_trip() -> None:
    assert decode(Setpoint, encode(SETPOINT)) == SETPOINT


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_number_that_is_not_finite_is_never_sent_and_the_field_is_named(bad: float) -> None:
    message = Setpoint(t_ns=5, control_id="c", sequence=1, phase=Phase.GO_TO, vel_ned_mps=(1.0, bad, 3.0))
    with pytest.raises(NotFiniteError, match=r"Setpoint\.vel_ned_mps\[1\]"):
        encode(message)


def test_an_honest_none_is_sent() -> None:
    assert b"null" in encode(Altimeter(t_ns=1, range_m=None))


@pytest.mark.parametrize(
    "text",
    [
        '{"t_ns": 1}',
        '{"t_ns": 1, "epoch_id": 2, "colour": "red"}',
        '{"t_ns": -1, "epoch_id": 2}',
        '{"t_ns": 1e400, "epoch_id": 2}',
        '{"t_ns": null, "epoch_id": 2}',
        '{"t_ns": NaN, "epoch_id": 2}',
        "",
        "\xff",
        "[" * 100_000,
    ],
)
def test_a_malformed_message_is_refused(text: str) -> None:
    with pytest.raises(BadPayloadError):
        decode(Clock, text.encode("latin-1"))


@pytest.mark.parametrize("number", ["1e300", "-1e300", "1e999"])
def test_a_number_out_of_its_range_is_refused(number: str) -> None:
    good = json.loads(encode(SETPOINT))
    text = json.dumps(good).replace("2.0", number)
    with pytest.raises(BadPayloadError, match="vel_ned_mps"):
        decode(Setpoint, text.encode())


def test_selector_parameters_become_the_same_goal_as_a_json_body() -> None:
    wanted = GoToGoal(target_ned_m=(0.0, 0.0, -4.0), frame="world", do_takeoff=True)
    parameters = {"target_ned_m": "[0,0,-4]", "frame": "world", "do_takeoff": "true", "_time": "[..]"}
    assert decode_request(GoToGoal, b"", parameters) == wanted
    assert decode_request(GoToGoal, b'{"target_ned_m":[0,0,-4],"do_takeoff":true}', {}) == wanted


def test_body_and_parameters_at_once_are_refused() -> None:
    with pytest.raises(BadPayloadError, match="both"):
        decode_request(TakeoffGoal, b"{}", {"altitude_m": "3"})


@pytest.mark.parametrize("value", ["high", "NaN", "[3]", "1e999", "{"])
def test_a_parameter_of_the_wrong_kind_is_refused_by_name(value: str) -> None:
    with pytest.raises(BadPayloadError, match="altitude_m"):
        decode_request(TakeoffGoal, b"", {"altitude_m": value})


def test_an_unknown_parameter_is_refused_by_name() -> None:
    with pytest.raises(BadPayloadError, match="altitude"):
        decode_request(TakeoffGoal, b"", {"altitude": "3"})


@given(st.binary(max_size=200))
def test_no_bytes_do_more_than_a_refusal(data: bytes) -> None:
    for topic in TOPICS:
        try:
            decode(topic.type, data)
        except BadPayloadError:
            continue


@given(st.dictionaries(st.text(max_size=12), st.text(max_size=20), max_size=4))
def test_no_parameters_do_more_than_a_refusal(parameters: dict[str, str]) -> None:
    try:
        decode_request(Hover, b"", parameters)
    except BadPayloadError:
        return


def test_every_key_of_the_contract_is_declared_once() -> None:
    names = [entry.name for entry in (*TOPICS, *ENDPOINTS)]
    assert len(names) == len(set(names))


def test_everything_with_an_effect_is_out_of_reach_of_wildcards() -> None:
    assert all(endpoint.name.startswith("@") for endpoint in ENDPOINTS)


def test_every_field_of_the_contract_refuses_unknown_fields() -> None:
    kinds = [topic.type for topic in TOPICS] + [e.request_type for e in ENDPOINTS]
    kinds += [kind for a in ACTIONS.values() for kind in (a.goal_type, a.feedback_type, a.result_type)]
    for kind in kinds:
        assert issubclass(kind, msgspec.Struct)
        assert kind.__struct_config__.forbid_unknown_fields, kind
        assert kind.__struct_config__.frozen, kind
