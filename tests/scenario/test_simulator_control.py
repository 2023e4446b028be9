"""Requests to the simulator while the whole stack flies, in virtual time."""

import pytest

from jezero.base.frames import horizontal, subtract
from jezero.schemas import topics
from jezero.schemas.simulator import Change, ControlSimulator, PlaceBody, ResetWorld, SetFault, SetWind, SimulatorState
from jezero.schemas.state import StatusCode
from tests.scenario.rig import Flight, go_to, land_at


def change(flight: Flight, do: Change) -> SimulatorState:
    """Make a change that is accepted."""
    sent = flight.bus.send_request(topics.CONTROL_SIMULATOR, ControlSimulator(do=do))
    assert flight.bus.run_for(2.0, stop=lambda: sent.ended)
    (reply,) = sent.replies
    assert reply.accepted, reply.reason
    state: SimulatorState = reply.state
    return state


@pytest.mark.long
def test_a_flight_survives_wind_faults_and_a_leap_and_begins_anew_after_a_reset() -> None:
    flight = Flight(seed=3)
    flight.take_off(3.0)
    change(flight, SetWind(mean_mps=5.0, from_deg=90.0))
    flight.bus.run_for(8.0)
    odometry = flight.status.odometry
    assert odometry is not None
    assert horizontal(subtract(odometry.pos_uav_ned_m, (0.0, 0.0, 0.0))) < 1.0
    change(flight, SetFault(unit="gps", kind="off", duration_s=2.0))
    flight.bus.run_for(4.0)
    assert change(flight, SetFault(unit="baro", kind="ok")).faults == ()
    before = flight.truth
    change(flight, PlaceBody(north_m=before.pos_uav_ned_m[0] + 3.0, east_m=before.pos_uav_ned_m[1], height_m=3.0))
    flight.bus.run_for(15.0)
    assert flight.status.code == StatusCode.HOVER
    flight.do(topics.GO_TO, go_to(0.0, 0.0, -3.0))
    epoch = flight.status.epoch_id
    change(flight, ResetWorld())
    flight.bus.run_for(20.0, stop=lambda: flight.status.epoch_id != epoch and flight.status.ready)
    assert not flight.status.armed
    assert horizontal(flight.truth.pos_uav_ned_m) < 0.1
    flight.take_off(2.0)
    flight.do(topics.LAND_ON_SPOT, land_at(0.0, 0.0))
