"""Encoding refuses what isn't finite; decoding refuses what the contract doesn't allow."""

import json
import math
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jezero.base.codec import (
    MAX_JSON_BYTES,
    BadPayloadError,
    NotFiniteError,
    decode,
    decode_request,
    encode,
    join_attachment,
    reader,
    split_attachment,
)
from jezero.schemas.commands import Hover, Phase, Release, Setpoint
from jezero.schemas.goals import GoToGoal, TakeoffGoal
from jezero.schemas.sensors import Altimeter, CameraFrame, CornersOfTag, TagCorners, Uwb, UwbRange
from jezero.schemas.state import Clock
from jezero.schemas.struct import Payload, WithReadings
from jezero.schemas.topics import ACTIONS, ENDPOINTS, GROUND, TOPICS

SETPOINT = Setpoint(t_ns=5, control_id="c", sequence=1, phase=Phase.GO_TO, vel_ned_mps=(1.0, 2.0, 3.0))


def test_a_message_survives_the_round_trip() -> None:
    assert decode(Setpoint, encode(SETPOINT)) == SETPOINT


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_number_that_is_not_finite_is_never_sent_and_the_field_is_named(bad: float) -> None:
    message = Setpoint(t_ns=5, control_id="c", sequence=1, phase=Phase.GO_TO, vel_ned_mps=(1.0, bad, 3.0))
    with pytest.raises(NotFiniteError, match=r"Setpoint\.vel_ned_mps\[1\]"):
        encode(message)


FRAME = CameraFrame(
    t_ns=5, sequence=1, width_px=2, height_px=1, pitch_camera_rad=-1.5, exposure_s=0.01, pixels=b"\n\x00\xffabc"
)


def test_a_picture_travels_as_a_header_in_json_and_its_bare_pixels() -> None:
    data = encode(FRAME)
    header, pixels = split_attachment(data)
    assert pixels == FRAME.pixels
    assert json.loads(header)["width_px"] == 2 and "pixels" not in json.loads(header)
    assert decode(CameraFrame, data) == FRAME


@pytest.mark.parametrize("pixels", [b"", b"12345", b"1234567"])
def test_a_picture_with_too_few_or_too_many_pixels_is_refused(pixels: bytes) -> None:
    header, _ = split_attachment(encode(FRAME))
    with pytest.raises(BadPayloadError, match="2 x 1 pixels"):
        decode(CameraFrame, join_attachment(header, pixels))


def test_a_picture_with_pixels_in_its_header_is_refused() -> None:
    with pytest.raises(BadPayloadError, match="attachment"):
        decode(CameraFrame, join_attachment(msgspec.json.encode(FRAME), FRAME.pixels))


@pytest.mark.parametrize("message", [SETPOINT, FRAME])
def test_the_same_bytes_are_decoded_once_for_all_their_readers(message: Payload) -> None:
    data = encode(message)
    assert decode(type(message), data) is decode(type(message), data)


def test_a_message_that_is_too_long_is_refused_unless_any_length_is_allowed() -> None:
    data = encode(SETPOINT) + b" " * MAX_JSON_BYTES
    with pytest.raises(BadPayloadError, match="more than 4000000"):
        decode(Setpoint, data)
    assert reader(Setpoint, None).read(data) == SETPOINT


def test_an_honest_none_is_sent() -> None:
    assert b"null" in encode(Altimeter(t_ns=1, range_m=None))


def test_text_about_null_is_sent_and_does_not_hide_a_number_that_is_not_finite() -> None:
    release = Release(control_id="c", outcome="aborted", reason="null")
    assert decode(Release, encode(release)) == release
    with pytest.raises(NotFiniteError, match=r"Release\.hover_pos_ned_m\[0\]"):
        encode(msgspec.structs.replace(release, hover_pos_ned_m=(math.nan, 0.0, -1.0)))


def test_a_none_that_is_left_out_does_not_hide_a_number_that_is_not_finite() -> None:
    still = (0.0, 0.0, 0.0)
    whole = msgspec.structs.replace(SETPOINT, pos_ned_m=still, acc_ned_mps2=still, yaw_rad=0.0)
    assert whole.yaw_rate_rps is None and b"null" not in encode(whole)
    with pytest.raises(NotFiniteError, match=r"Setpoint\.yaw_rad is nan"):
        encode(msgspec.structs.replace(whole, yaw_rad=math.nan))


@pytest.mark.parametrize(
    "text",
    [
        '{"t_ns": 1}',
        '{"t_ns": 1, "epoch_id": 2, "wall_ns": 3, "colour": "red"}',
        '{"t_ns": -1, "epoch_id": 2, "wall_ns": 3}',
        '{"t_ns": 1e400, "epoch_id": 2, "wall_ns": 3}',
        '{"t_ns": null, "epoch_id": 2, "wall_ns": 3}',
        '{"t_ns": NaN, "epoch_id": 2, "wall_ns": 3}',
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


WITH_READINGS: dict[Any, Any] = {
    Uwb: Uwb(
        t_ns=1,
        ranges=tuple(
            UwbRange(t_ns=1, anchor=anchor, pos_anchor_rover_body_m=(0.5, 0.5, -0.3), range_m=2.0)
            for anchor in range(4)
        ),
    ),
    TagCorners: TagCorners(
        t_ns=1,
        pitch_camera_rad=-1.5,
        tags=tuple(CornersOfTag(tag_id=tag, corners_px=((0, 0), (9, 0), (9, 9), (0, 9))) for tag in range(4)),
    ),
}


def test_every_message_with_a_list_of_readings_is_tried() -> None:
    assert {topic.type for topic in TOPICS if issubclass(topic.type, WithReadings)} == set(WITH_READINGS)


@pytest.mark.parametrize("kind", WITH_READINGS)
@pytest.mark.parametrize("bad", [None, -1.0, "2", {}, [], [1, 2]])
@pytest.mark.parametrize("number", range(4))
def test_a_bad_reading_is_left_out_and_named_and_the_others_are_kept(kind: Any, bad: Any, number: int) -> None:
    message: Any = WITH_READINGS[kind]
    fields = json.loads(encode(message))
    field = "range_m" if kind is Uwb else "corners_px"
    fields[kind.readings_field][number][field] = bad
    data = json.dumps(fields).encode()
    read = reader(kind).read(data)
    assert read == message.with_readings(each for index, each in enumerate(message.readings) if index != number)
    (why,) = reader(kind).dropped(data)
    assert why.startswith(f"{kind.readings_field}[{number}]: ") and field in why
    assert reader(kind).dropped(encode(message)) == ()


@pytest.mark.parametrize("kind", WITH_READINGS)
def test_what_is_wrong_beside_the_readings_refuses_the_message(kind: Any) -> None:
    fields = json.loads(encode(WITH_READINGS[kind]))
    name = kind.readings_field
    for wrong in (
        fields | {"t_ns": -1},
        fields | {"t_ns": -1, name: [None]},
        fields | {"more": 1},
        fields | {name: fields[name] * 100},
        fields | {name: 5},
        {key: value for key, value in fields.items() if key != name},
        [fields],
    ):
        with pytest.raises(BadPayloadError):
            decode(kind, json.dumps(wrong).encode())


def test_a_message_all_of_whose_readings_are_bad_is_one_without_readings() -> None:
    fields = json.loads(encode(WITH_READINGS[Uwb])) | {"ranges": [None, 1, "x"]}
    assert decode(Uwb, json.dumps(fields).encode()).ranges == ()


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
    names = [topic.name for topic in TOPICS] + [endpoint.name for endpoint in ENDPOINTS]
    assert len(names) == len(set(names))


def test_everything_with_an_effect_is_out_of_reach_of_wildcards() -> None:
    assert all(endpoint.name.startswith("@") != endpoint.wildcards for endpoint in ENDPOINTS)
    readable = {endpoint for action in ACTIONS.values() for endpoint in (action.describe, action.running)}
    assert {endpoint for endpoint in ENDPOINTS if endpoint.wildcards} == {GROUND, *readable}


def test_every_field_of_the_contract_refuses_unknown_fields() -> None:
    kinds = [topic.type for topic in TOPICS] + [e.request_type for e in ENDPOINTS]
    kinds += [kind for a in ACTIONS.values() for kind in (a.goal_type, a.feedback_type, a.result_type)]
    for kind in kinds:
        assert issubclass(kind, msgspec.Struct)
        assert kind.__struct_config__.forbid_unknown_fields, kind
        assert kind.__struct_config__.frozen, kind
