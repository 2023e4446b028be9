"""The simulator's requests by the SDK."""

import pytest

from jezero import Refused, Unreachable, Vehicle
from jezero.schemas.simulator import SimulatorReply, SimulatorState
from jezero.schemas.topics import liveliness_key
from tests.client.rig import Server, a_status, endpoint, server, vehicle, wait_for

__all__ = ["endpoint", "server", "vehicle"]

STATE = SimulatorState(
    t_ns=5,
    epoch_id=1,
    paused=False,
    speed=1.0,
    autopilot=True,
    motors=False,
    pos_uav_ned_m=(0.0, 0.0, 0.0),
    vel_uav_ned_mps=(0.0, 0.0, 0.0),
    yaw_uav_rad=0.0,
    height_uav_m=0.0,
    pos_rover_ned_m=(5.0, -3.0, 0.0),
    yaw_rover_rad=0.0,
    speed_rover_mps=0.0,
    wind_mean_mps=0.0,
    wind_from_deg=0.0,
    std_gust_mps=0.0,
    wind_ned_mps=(0.0, 0.0, 0.0),
)


def test_each_method_sends_its_change_and_returns_the_state(vehicle: Vehicle, server: Server) -> None:
    server.serve("@simulator/control", SimulatorReply(accepted=True, state=STATE))
    simulator = vehicle.simulator
    states = [
        simulator.state(),
        simulator.reset(),
        simulator.place(1.0, 2.0, yaw_deg=180.0, what="rover"),
        simulator.wind(4.0, 90.0),
        simulator.fault("gps", "off", for_s=3.0),
        simulator.pause(),
        simulator.step(0.5),
        simulator.speed(0.5),
        simulator.resume(),
    ]
    assert states == [STATE] * 9
    changes = [payload["do"] for _, _, payload in server.asked]
    assert changes[0] is None
    assert [change["change"] for change in changes[1:]] == [
        *("reset", "place", "wind", "fault", "pause", "step", "speed", "resume")
    ]
    assert changes[2]["yaw_rad"] == pytest.approx(3.14159, abs=1e-4)
    assert (changes[4]["unit"], changes[4]["kind"], changes[4]["duration_s"]) == ("gps", "off", 3.0)


def test_a_refused_change_raises_with_the_reason(vehicle: Vehicle, server: Server) -> None:
    server.serve("@simulator/control", SimulatorReply(accepted=False, reason="the rover is there", state=STATE))
    with pytest.raises(Refused, match="the rover is there"):
        vehicle.simulator.place(1.0, 2.0)


def test_a_step_of_a_negative_duration_waits_for_its_refusal(vehicle: Vehicle, server: Server) -> None:
    server.serve("@simulator/control", SimulatorReply(accepted=False, reason="do.duration_s: expected", state=STATE))
    with pytest.raises(Refused, match=r"do\.duration_s: expected"):
        vehicle.simulator.step(-1.0)


def test_a_vehicle_without_a_simulator_is_named_in_one_sentence(vehicle: Vehicle, server: Server) -> None:
    server.serve("status", a_status())
    token = server.session.liveliness().declare_token(liveliness_key("v", "service", "vehicle_bridge"))
    wait_for(vehicle._connection.sees_bridge)
    with pytest.raises(Unreachable, match="v has no simulator: its stack runs without one"):
        vehicle.simulator.pause()
    token.undeclare()  # type: ignore[no-untyped-call]
