"""The client against a real router and hand-made servers, on a free loopback port."""

import asyncio
import re
import threading
import time
from typing import Any

import msgspec
import pytest
import zenoh
from msgspec.structs import replace

from jezero import Aborted, Canceled, JezeroError, Refused, TimedOut, Unreachable, Vehicle
from jezero.aio.vehicle import Vehicle as AsyncVehicle
from jezero.base.zenoh_client import client_config
from jezero.schemas import topics
from jezero.schemas.actions import (
    Accepted,
    CancelReply,
    ModifyReply,
    PauseReply,
    Rejected,
    Result,
    ResultReply,
    ResumeReply,
)
from jezero.schemas.commands import AbortReply, HoverReply, KillReply
from jezero.schemas.estimate import Lease, ParametersReply, SetParameters
from jezero.schemas.goals import MoveResult, TakeoffGoal
from jezero.schemas.state import Status, StatusCode
from tests.client.rig import (
    ACCEPTED,
    POINT,
    Server,
    a_feedback,
    a_result,
    a_status,
    close,
    endpoint,
    open_router,
    own_stack,
    published,
    server,
    vehicle,
    wait_for,
)

__all__ = ["endpoint", "server", "vehicle"]


def test_a_goal_streams_its_feedback_and_returns_its_result(vehicle: Vehicle, server: Server) -> None:
    server.serve("@action/takeoff", ACCEPTED, a_feedback(2.0), a_feedback(1.0), a_result())
    goal = vehicle.takeoff(altitude_m=2.0)
    assert (goal.goal_id, goal.warning, goal.code) == ("g", "careful", None)
    assert [feedback.distance_m for feedback in goal.feedback()] == [2.0, 1.0]
    assert goal.code == 1
    assert goal.result() == MoveResult(completed=True, pos_uav_ned_m=POINT)
    assert goal.result() == goal.result(timeout_s=0.0)
    assert list(goal.feedback()) == []


def test_feedback_arrives_while_the_goal_runs(vehicle: Vehicle, server: Server) -> None:
    server.serve("@action/takeoff", ACCEPTED, end=False)
    goal = vehicle.takeoff()
    stream = goal.feedback()
    (query,) = server.open.pop("@action/takeoff")
    server.reply(query, a_feedback(5.0))
    assert next(stream).distance_m == 5.0
    server.reply(query, a_result())
    server.end(query)
    assert list(stream) == []
    assert goal.result().completed


def test_every_goal_carries_an_id_its_time_and_its_client(vehicle: Vehicle, server: Server, endpoint: str) -> None:
    server.serve("status", a_status(t_ns=1234))
    server.serve("@action/go_to", ACCEPTED, a_result())
    vehicle.go_to(-1, -2, -3, speed_mps=1.5, on_client_loss="cancel").result()
    name, client, goal = server.asked[-1]
    assert name == "@action/go_to"
    assert goal["target_ned_m"] == [-1, -2, -3]
    assert goal["issued_t_ns"] == 1234
    assert goal["goal_id"].startswith(client)
    assert (goal["speed_mps"], goal["frame"], goal["on_client_loss"]) == (1.5, "world", "cancel")
    with zenoh.open(client_config(endpoint)) as other:
        key = topics.liveliness_key("v", "client", client)
        assert [str(r.ok.key_expr) for r in other.liveliness().get(key, timeout=1.0) if r.ok] == [key]
    vehicle.close()
    gone: list[object] = []

    def is_gone() -> bool:
        with zenoh.open(client_config(endpoint)) as other:
            gone[:] = list(other.liveliness().get(key, timeout=1.0))
        return not gone

    wait_for(is_gone)


def test_vehicle_time_that_was_just_told_is_not_asked_for_again(vehicle: Vehicle, server: Server) -> None:
    server.serve("status", a_status(t_ns=1234))
    server.serve("@action/go_to", ACCEPTED, a_result())
    vehicle.status()
    vehicle.go_to(-1, -2, -3).result()
    told_ns = a_result().t_ns
    vehicle.go_to(-2, -2, -3).result()
    assert [name for name, _, _ in server.asked] == ["status", "@action/go_to", "@action/go_to"]
    assert [goal["issued_t_ns"] for _, _, goal in server.asked[1:]] == [1234, told_ns]


def test_a_refusal_has_its_reason_and_the_status_code(vehicle: Vehicle, server: Server) -> None:
    server.serve("@action/takeoff", Rejected(goal_id="g", reason="it flies already", code=3))
    with pytest.raises(Refused, match="it flies already") as refusal:
        vehicle.takeoff()
    assert refusal.value.code == StatusCode.HOVER
    assert isinstance(refusal.value, JezeroError)


@pytest.mark.parametrize(("outcome", "error"), [("aborted", Aborted), ("canceled", Canceled)])
def test_an_unhappy_end_raises_by_its_name(
    vehicle: Vehicle, server: Server, outcome: str, error: type[JezeroError]
) -> None:
    server.serve("@action/takeoff", ACCEPTED, a_feedback(1.0), a_result(outcome, "because"))
    goal = vehicle.takeoff()
    assert len(list(goal.feedback())) == 1
    for _ in range(2):
        with pytest.raises(error, match="because") as raised:
            goal.result()
    assert raised.value.result == MoveResult(completed=False, pos_uav_ned_m=POINT)  # type: ignore[attr-defined]


def test_a_goal_that_still_runs_times_out_and_can_be_waited_for_again(vehicle: Vehicle, server: Server) -> None:
    server.serve("@action/takeoff", ACCEPTED, end=False)
    goal = vehicle.takeoff()
    with pytest.raises(TimedOut, match=r"takeoff still runs after 0.1 s"):
        goal.result(timeout_s=0.1)
    (query,) = server.open.pop("@action/takeoff")
    server.reply(query, a_result())
    server.end(query)
    assert goal.result(timeout_s=2.0).completed


def test_a_cancel_is_a_question_of_its_own(vehicle: Vehicle, server: Server) -> None:
    server.serve("@action/takeoff", ACCEPTED, end=False)
    server.serve("@action/takeoff/cancel", CancelReply(canceled=True))
    goal = vehicle.takeoff()
    assert goal.cancel() is True
    assert server.asked[-1][2] == {"goal_id": "g"}


def test_pause_resume_and_modify_name_the_goal_and_tell_the_reason_of_a_refusal(
    vehicle: Vehicle, server: Server
) -> None:
    server.serve("@action/takeoff", ACCEPTED, end=False)
    server.serve("@action/takeoff/pause", PauseReply(paused=True))
    server.serve("@action/takeoff/resume", ResumeReply(resumed=False, reason="goal g is not paused"))
    server.serve("@action/takeoff/modify", ModifyReply(modified=True, warning="flown at 1 m/s"))
    goal = vehicle.takeoff()
    goal.pause(wait=False)
    assert server.asked[-1][2]["goal_id"] == "g"
    with pytest.raises(Refused, match="goal g is not paused"):
        goal.resume()
    goal.modify(altitude_m=3.0)
    assert server.asked[-1][2]["fields"] == {"altitude_m": 3.0}
    assert goal.warning == "flown at 1 m/s"


def test_a_pause_returns_when_the_vehicle_hovers(vehicle: Vehicle, server: Server) -> None:
    server.serve("@action/takeoff", ACCEPTED, end=False)
    server.serve("@action/takeoff/pause", PauseReply(paused=True))
    server.serve("@action/result", ResultReply(goal_id="g", action="takeoff", running=True))
    braking = replace(a_status(), goal_id="g", action="takeoff")
    server.serve("status", braking)
    goal, t_paused_ns, published_ns = vehicle.takeoff(), 115, [0]

    def make(t_ns: int) -> Status:
        published_ns[0] = t_ns
        return replace(braking, t_ns=t_ns, paused=t_ns >= t_paused_ns)

    with published(server, make):
        goal.pause()
    assert published_ns[0] >= t_paused_ns
    with published(server, make):
        assert vehicle.pause() == "g"


def test_a_pause_of_a_goal_that_ends_meanwhile_is_refused(vehicle: Vehicle, server: Server) -> None:
    server.serve("@action/takeoff", ACCEPTED, end=False)
    server.serve("@action/takeoff/pause", PauseReply(paused=True))
    server.serve("@action/result", ResultReply(goal_id="g", action="takeoff", running=False))
    server.serve("status", a_status())
    with pytest.raises(Refused, match="takeoff ended before the vehicle hovered"):
        vehicle.takeoff().pause()


def test_the_goal_in_charge_is_paused_whoever_sent_it(vehicle: Vehicle, server: Server) -> None:
    server.serve("status", a_status())
    with pytest.raises(Refused, match="no goal is in charge, the vehicle hovers"):
        vehicle.pause()


def test_a_server_that_dies_is_told_within_a_second(vehicle: Vehicle, server: Server, endpoint: str) -> None:
    other = Server(endpoint)
    other.serve("@action/takeoff", ACCEPTED, end=False)
    server.serve("@action/result", complete=False)
    goal = vehicle.takeoff()
    start = time.monotonic()
    other.close()
    with pytest.raises(Unreachable, match="the takeoff server died or lost its router; the vehicle hovers"):
        goal.result()
    assert time.monotonic() - start < 1.0
    with pytest.raises(Unreachable):
        goal.result()


def test_a_cut_link_to_the_vehicles_computer_is_not_taken_for_a_dead_server(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("jezero.client.goal.RECOVER_S", 0.5)
    with own_stack() as (endpoint, _, server), Vehicle.connect("v", router=endpoint) as vehicle:
        server.serve("@action/takeoff", ACCEPTED, end=False)
        goal = vehicle.takeoff()
        server.close()
        with pytest.raises(
            Unreachable, match=rf"the link to v is lost \(`jezero ps`\); goal {goal.goal_id} may still run"
        ):
            goal.result()


def test_a_goal_goes_on_for_its_client_when_the_link_to_the_vehicles_computer_is_there_again() -> None:
    text = msgspec.json.encode(a_result()).decode()
    with own_stack() as (endpoint, _, server), Vehicle.connect("v", router=endpoint) as vehicle:
        server.serve("@action/takeoff", ACCEPTED, end=False)
        goal = vehicle.takeoff()
        server.close()
        again: list[Server] = []

        def come_back() -> None:
            far = Server(endpoint)
            far.serve("@action/result", ResultReply(goal_id="g", action="takeoff", running=False, result=text))
            again.append(far)

        opener = threading.Timer(1.0, come_back)
        opener.start()
        try:
            assert goal.result(timeout_s=10.0).completed
        finally:
            opener.join()
            again[0].close()


def test_a_lost_connection_is_not_taken_for_a_dead_server() -> None:
    with own_stack() as (endpoint, router, server):
        server.serve("@action/takeoff", ACCEPTED, end=False)
        text = msgspec.json.encode(a_result()).decode()
        server.serve("@action/result", ResultReply(goal_id="g", action="takeoff", running=False, result=text))
        again: list[zenoh.Session] = []
        opener = threading.Timer(0.5, lambda: again.append(open_router(endpoint)))
        with Vehicle.connect("v", router=endpoint) as vehicle:
            goal = vehicle.takeoff()
            close(router)
            opener.start()
            try:
                assert goal.result(timeout_s=10.0).completed
            finally:
                opener.join()
                close(again[0])


def test_a_router_that_stays_away_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("jezero.client.goal.RECOVER_S", 0.5)
    with own_stack() as (endpoint, router, server), Vehicle.connect("v", router=endpoint) as vehicle:
        server.serve("@action/takeoff", ACCEPTED, end=False)
        goal = vehicle.takeoff()
        close(router)
        with pytest.raises(Unreachable, match=r"connection to the router .* is lost; goal g may still run"):
            goal.result()
        with pytest.raises(Unreachable, match="is lost"):
            vehicle.status()


def test_without_a_router_connecting_says_so_in_time() -> None:
    start = time.monotonic()
    with pytest.raises(Unreachable, match=r"no router at tcp/127.0.0.1:1 within 0.6 s"):
        Vehicle.connect("v", router="tcp/127.0.0.1:1", timeout_s=0.6)
    assert time.monotonic() - start < 1.0


def test_without_a_server_a_goal_is_unreachable_at_once(vehicle: Vehicle) -> None:
    start = time.monotonic()
    with pytest.raises(
        Unreachable, match=r"no server replies on @action/takeoff of v: the stack is up, but this service"
    ):
        vehicle.takeoff()
    assert time.monotonic() - start < 0.5


def test_of_a_vehicle_that_is_not_there_only_a_request_with_an_effect_may_have_arrived(
    endpoint: str, server: Server
) -> None:
    with Vehicle.connect("w", router=endpoint) as vehicle:
        server.clients.append(vehicle._connection._session)
        with pytest.raises(Unreachable, match=r"is the stack up\?.* may have arrived"):
            vehicle.takeoff()
        with pytest.raises(Unreachable, match=r"the link to that computer may be cut$"):
            vehicle.status()


def test_a_server_that_never_accepts_times_out_and_the_goal_is_withdrawn(
    vehicle: Vehicle, server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("jezero.client.goal_sender.REPLY_TIMEOUT_S", 0.3)
    server.serve("@action/takeoff", end=False)
    server.serve("@action/takeoff/cancel", CancelReply(canceled=True))
    with pytest.raises(TimedOut, match=r"did not reply within 0.3 s"):
        vehicle.takeoff()
    wait_for(lambda: server.asked[-1][0] == "@action/takeoff/cancel")
    assert server.asked[-1][2]["goal_id"] == server.asked[-2][2]["goal_id"]


def test_numbers_that_json_cannot_carry_are_refused_here(vehicle: Vehicle, server: Server) -> None:
    server.serve("@action/go_to", ACCEPTED, a_result())
    with pytest.raises(ValueError, match="speed_mps is nan"):
        vehicle.go_to(0, 0, -3, speed_mps=float("nan"))
    with pytest.raises(ValueError, match=r"hover_pos\[1\] is inf"):
        vehicle.hover((0.0, float("inf"), -3.0))
    with pytest.raises(ValueError, match="altitude_m"):
        vehicle.takeoff(float("nan"))
    assert server.asked == []


def test_an_answer_of_another_version_is_named_so(vehicle: Vehicle, server: Server) -> None:
    server.serve("status", Accepted(goal_id="x"))
    with pytest.raises(JezeroError, match="same version"):
        vehicle.status()


def test_hover_abort_and_kill_ask_the_bridge(vehicle: Vehicle, server: Server) -> None:
    server.serve("@control/hover", HoverReply(hover_mode=True))
    server.serve("@control/abort", AbortReply(hovering=True, reason="was going to"))
    server.serve("@control/kill", KillReply(killed=True))
    vehicle.hover()
    assert server.asked[-1][2] == {"hover_req": True, "hover_pos": None}
    vehicle.hover((0.0, 0.0, -3.0))
    assert server.asked[-1][2] == {"hover_req": True, "hover_pos": [0.0, 0.0, -3.0]}
    assert vehicle.abort("enough") == AbortReply(hovering=True, reason="was going to")
    assert server.asked[-1][2] == {"reason": "enough"}
    vehicle.kill(confirm=True, vehicle="v")
    assert server.asked[-1][2] == {"confirm": True, "vehicle": "v"}


def test_a_refused_hover_or_kill_raises(vehicle: Vehicle, server: Server) -> None:
    server.serve("@control/hover", HoverReply(hover_mode=False, reason="it stands on the ground"))
    server.serve("@control/kill", KillReply(killed=False, reason="not confirmed"))
    with pytest.raises(Refused, match="stands on the ground"):
        vehicle.hover()
    with pytest.raises(Refused, match="not confirmed"):
        vehicle.kill()


def test_the_estimators_parameters_are_read_and_changed(vehicle: Vehicle, server: Server) -> None:
    after = SetParameters(std_uwb_m=0.2, use_tag=True)
    server.serve("@estimator/parameters/get", ParametersReply(accepted=True, parameters=after))
    server.serve("@estimator/parameters/set", ParametersReply(accepted=True, parameters=after))
    assert vehicle.estimator_parameters() == after
    assert vehicle.set_estimator_parameters(std_uwb_m=0.2) == after
    assert {name: value for name, value in server.asked[-1][2].items() if value is not None} == {"std_uwb_m": 0.2}
    for wrong, what in ({"std_uwb": 0.2}, "std_uwb"), ({"std_uwb_m": "small"}, "std_uwb_m"):
        with pytest.raises(ValueError, match=what):
            vehicle.set_estimator_parameters(**wrong)


def test_the_estimators_lease_is_read(vehicle: Vehicle, server: Server) -> None:
    lease = Lease(goal_id="a", use_uwb=False, use_tag=True, pos_rover_ned_m=(1.0, 2.0, 0.0))
    server.serve("@estimator/parameters/get", ParametersReply(accepted=True, lease=lease))
    assert vehicle.estimator_lease() == lease


def test_a_refused_parameter_raises(vehicle: Vehicle, server: Server) -> None:
    server.serve("@estimator/parameters/set", ParametersReply(accepted=False, reason="std_uwb_m is too large"))
    with pytest.raises(Refused, match="too large"):
        vehicle.set_estimator_parameters(std_uwb_m=50.0)


def test_status_is_read_and_watched(vehicle: Vehicle, server: Server) -> None:
    server.serve("status", a_status(t_ns=1))
    assert vehicle.status() == a_status(t_ns=1)
    stream = vehicle.watch_status()
    assert next(stream).t_ns == 1
    with published(server, lambda t_ns: a_status(t_ns=t_ns)):
        first = next(stream).t_ns
        assert first > 100
        assert next(stream).t_ns == first + 1
    stream.close()  # type: ignore[attr-defined]


def test_a_silent_status_ends_the_watch(vehicle: Vehicle, server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("jezero.client.status.STATUS_TIMEOUT_S", 0.2)
    server.serve("status", a_status())
    stream = vehicle.watch_status()
    next(stream)
    with pytest.raises(Unreachable, match=r"no status of v for 0.2 s"):
        next(stream)


def test_waiting_until_ready_says_what_is_missing(vehicle: Vehicle, server: Server) -> None:
    with pytest.raises(TimedOut, match=r"v is not ready after 0.1 s: no server replies on status"):
        vehicle.wait_ready(timeout_s=0.1)
    server.serve("status", a_status(ready=False, missing="no GNSS fix yet"))
    with published(server, lambda t_ns: a_status(t_ns=t_ns, ready=t_ns == 111, missing="no GNSS fix yet")):
        assert vehicle.wait_ready(timeout_s=5.0).t_ns == 111
    with (
        published(server, lambda t_ns: a_status(t_ns=t_ns, ready=False, missing="no GNSS fix yet")),
        pytest.raises(TimedOut, match="no GNSS fix yet"),
    ):
        vehicle.wait_ready(timeout_s=0.2)


def test_the_result_of_a_lost_goal_can_be_asked_for(vehicle: Vehicle, server: Server) -> None:
    assert vehicle.result_of("g") is None
    server.serve("@action/result", ResultReply(goal_id="g", action="takeoff", running=True), complete=False)
    reply = vehicle.result_of("g")
    assert reply is not None
    assert reply.running


@pytest.mark.parametrize("fails", [False, True])
def test_a_flight_takes_off_and_lands_where_it_is(vehicle: Vehicle, server: Server, fails: bool) -> None:
    server.serve("status", a_status())
    server.serve("@action/takeoff", ACCEPTED, a_result())
    landed = Result(goal_id="g", t_ns=2, outcome="succeeded", result={"completed": True, "touchdown_ned_m": None})
    server.serve("@action/land_on_spot", ACCEPTED, landed)

    def fly() -> None:
        with vehicle.flight(altitude_m=3.0) as uav:
            assert uav is vehicle
            if fails:
                raise KeyError("my own bug")

    if fails:
        with pytest.raises(KeyError):
            fly()
    else:
        fly()
    goals = [(name, goal) for name, _, goal in server.asked if name.startswith("@action")]
    assert [name for name, _ in goals] == ["@action/takeoff", "@action/land_on_spot"]
    assert goals[0][1]["altitude_m"] == 3.0
    assert goals[1][1]["landing_spot_ned_m"] == [1.0, 2.0, -2.0]
    assert goals[1][1]["use_uwb"] is False


def test_a_flight_that_a_pilot_took_over_is_left_alone(vehicle: Vehicle, server: Server) -> None:
    server.serve("status", a_status(StatusCode.EXTERNAL))
    server.serve("@action/takeoff", ACCEPTED, a_result())
    with vehicle.flight():
        pass
    assert {name for name, _, _ in server.asked} == {"status", "@action/takeoff"}


def test_the_goal_says_what_it_is(vehicle: Vehicle, server: Server) -> None:
    server.serve("@action/takeoff", ACCEPTED, a_result())
    goal = vehicle.takeoff()
    assert repr(goal) == "<takeoff goal g: running>"
    goal.result()
    assert repr(goal) == "<takeoff goal g: succeeded>"
    assert topics.TAKEOFF.goal_type is TakeoffGoal


def test_the_name_of_a_file_is_no_fence_and_no_mission(vehicle: Vehicle) -> None:
    name: Any = "field.yaml"
    with pytest.raises(ValueError, match=r"'field.yaml' is no Fence: jezero.mission_files.read_fence reads one"):
        vehicle.set_fence(name)
    with pytest.raises(ValueError, match=r"'field.yaml' is no Mission: jezero.mission_files.read_mission reads one"):
        vehicle.mission.run(name)


@pytest.mark.parametrize("name", ["new*", "*", "**", "", "a/b", "v\n", 5, b"v"])
def test_a_name_that_no_vehicle_can_have_is_refused(name: Any, endpoint: str) -> None:
    sentence = re.escape(f"the vehicle's name is {name!r}: expected 1 to 32 letters, digits, '-' and '_'")
    with pytest.raises(ValueError, match=sentence):
        Vehicle.connect(name, router=endpoint)
    with pytest.raises(ValueError, match=sentence):
        asyncio.run(AsyncVehicle.connect(name, router=endpoint))
