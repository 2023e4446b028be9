"""The failsafes of the autopilot in virtual time: their actions, and a safe touchdown."""

from collections.abc import Iterable
from math import degrees

import pytest

from jezero.base.frames import altitude_m, horizontal, tilt_from_quat
from jezero.base.mavlink import MavlinkCodec, MavMessage, dialect
from jezero.base.vehicle_config import BatteryConfig, VehicleConfig
from jezero.runtime.memory_bus import UDP_DELAY
from jezero.runtime.service import Inbox, Output, Send, Spec
from jezero.schemas import topics
from jezero.schemas.goals import TakeoffGoal
from jezero.schemas.state import StatusCode
from jezero.services.autopilot.config import AutopilotConfig, FailsafeConfig, NavigatorConfig
from jezero.services.vehicle_bridge.config import VehicleBridgeConfig
from jezero.trials.stack import build_stack
from tests.scenario.rig import Flight, go_to

CLOSE_TO_HOME = NavigatorConfig(rtl_return_alt_m=6.0)


class GroundStation:
    """Sends a heartbeat once a second until `silent` is set."""

    spec = Spec(name="station", links=("autopilot",), rate_hz=1.0)

    def __init__(self) -> None:
        self.silent = False
        self._codec = MavlinkCodec(255, 190)

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        if not self.silent:
            yield Send("autopilot", self._codec.pack(dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)))


def flight_with(
    config: AutopilotConfig, vehicle: VehicleConfig | None = None, bridge: VehicleBridgeConfig | None = None
) -> Flight:
    """A stack without the mission service, which flies home before a failsafe does."""
    return Flight(
        seed=5,
        make_bus=lambda seed: build_stack(seed, autopilot=config, bridge=bridge, vehicle=vehicle, without=("mission",)),
    )


def wait_mode(flight: Flight, mode: str, timeout_s: float) -> None:
    flight.wait(lambda: flight.status.autopilot_mode == mode, timeout_s, mode)


def assert_lands_by_itself(flight: Flight, timeout_s: float, away_m: float) -> None:
    """Assert that the autopilot lands slowly and upright and disarms, and that the bridge is idle afterwards."""
    assert flight.status.code == StatusCode.EXTERNAL
    assert flight.status.in_charge == "failsafe"
    start = len(flight.truths)
    flight.wait(lambda: not flight.status.armed, timeout_s, "disarmed")
    down = [t.vel_uav_ned_mps[2] for t in flight.truths[start:]]
    assert max(down) < 1.8
    assert altitude_m(flight.truth.pos_uav_ned_m[2]) < 1.0
    assert degrees(tilt_from_quat(flight.truth.q_ned_from_frd)) < 15.0
    assert horizontal(flight.truth.pos_uav_ned_m) < away_m
    flight.wait_code(StatusCode.IDLE, 5.0)


def test_without_setpoints_it_lands_within_a_second_and_a_half() -> None:
    config = AutopilotConfig()
    flight = flight_with(config)
    flight.take_off(4.0)
    flight.bus.freeze("vehicle_bridge", 60.0)
    start = len(flight.truths)
    flight.bus.run_for(25.0)
    truths = flight.truths[start:]
    t_ns = truths[0].t_ns
    sinks = next(t for t in truths if t.vel_uav_ned_mps[2] > 0.3)
    assert 1.0 < (sinks.t_ns - t_ns) * 1e-9 < 2.5
    assert not truths[-1].armed_motors
    assert altitude_m(truths[-1].pos_uav_ned_m[2]) < 1.0


@pytest.mark.long
def test_without_its_ground_station_it_returns_and_lands_if_the_parameter_says_so() -> None:
    config = AutopilotConfig(failsafe=FailsafeConfig(nav_dll_act=2), navigator=CLOSE_TO_HOME)
    flight, station = flight_with(config), GroundStation()
    flight.bus.wire(("autopilot", "gcs"), ("station", "autopilot"), UDP_DELAY)
    flight.bus.add(station)
    flight.take_off(3.0)
    flight.do(topics.GO_TO, go_to(8.0, 0.0, -3.0))
    flight.bus.run_for(12.0)
    assert flight.status.code == StatusCode.HOVER
    station.silent = True
    flight.bus.run_for(11.0)
    assert flight.status.code == StatusCode.HOVER
    wait_mode(flight, "AUTO.RTL", 2.0)
    assert_lands_by_itself(flight, 60.0, away_m=2.0)


@pytest.mark.long
def test_a_low_battery_warns_a_critical_one_returns_and_an_empty_one_lands() -> None:
    config = AutopilotConfig(navigator=CLOSE_TO_HOME, charge_at_start=0.2)
    flight = flight_with(config, VehicleConfig(battery=BatteryConfig(capacity_mah=1200.0)))
    flight.take_off(3.0)
    flight.do(topics.GO_TO, go_to(8.0, 0.0, -3.0))
    assert flight.status.code == StatusCode.HOVER
    wait_mode(flight, "AUTO.RTL", 60.0)
    assert flight.status.battery is not None
    assert flight.status.battery.remaining is not None
    assert 0.05 < flight.status.battery.remaining < 0.08
    wait_mode(flight, "AUTO.LAND", 20.0)
    assert_lands_by_itself(flight, 40.0, away_m=9.0)


def test_a_takeoff_that_the_battery_does_not_hold_is_refused_on_the_ground() -> None:
    flight = flight_with(AutopilotConfig(charge_at_start=0.078), VehicleConfig())
    flight.wait_ready()
    assert flight.status.battery is not None
    assert flight.status.battery.critical == 0.07
    reason = flight.refusal(topics.TAKEOFF, TakeoffGoal(altitude_m=2.0))
    assert "only 7.5 % are sure to be there, and 7.0 % must be left" in reason
    flight.bus.run_for(3.0)
    assert flight.codes == [StatusCode.IDLE]
    assert not flight.status.armed


@pytest.mark.long
def test_an_empty_battery_only_warns_without_the_bridges_parameters() -> None:
    bridge = VehicleBridgeConfig()
    assert not bridge.parameters
    config = AutopilotConfig(charge_at_start=0.2)
    vehicle = VehicleConfig(battery=BatteryConfig(capacity_mah=1000.0))
    flight = flight_with(config, vehicle, bridge)
    flight.take_off(3.0)
    flight.bus.run_for(35.0)
    assert flight.status.battery is not None
    assert flight.status.battery.remaining is not None
    assert flight.status.battery.remaining < 0.05
    assert flight.status.code == StatusCode.HOVER


def test_without_gnss_it_comes_down_where_it_is() -> None:
    flight, simulator = Flight.with_tampered_simulator(lambda m: m.get_msgId() != dialect.MAVLINK_MSG_ID_HIL_GPS)
    flight.take_off(4.0)
    simulator.active = True
    flight.bus.run_for(4.5)
    assert flight.status.code == StatusCode.HOVER
    wait_mode(flight, "AUTO.LAND", 2.0)
    assert_lands_by_itself(flight, 40.0, away_m=12.0)


@pytest.mark.long
@pytest.mark.parametrize(
    ("seed", "height_m"),
    [(1, 12.0), *(pytest.param(seed, 12.0, marks=pytest.mark.slow) for seed in (2, 3)), (1, 30.0)],
)
def test_losing_gnss_in_fast_flight_it_stops_and_touches_down_slowly(seed: int, height_m: float) -> None:
    flight, simulator = Flight.with_tampered_simulator(lambda m: m.get_msgId() != dialect.MAVLINK_MSG_ID_HIL_GPS, seed)
    flight.take_off(height_m)
    flight.send(topics.GO_TO, go_to(60.0, 0.0, -height_m, speed_mps=3.0))
    flight.bus.run_for(3.0)
    simulator.active = True
    wait_mode(flight, "AUTO.LAND", 7.0)
    assert horizontal(flight.truth.vel_uav_ned_mps) > 2.5
    flight.wait(lambda: flight.truth.contact_force_n > 0.0, 60.0, "on the ground")
    assert horizontal(flight.truths[-2].vel_uav_ned_mps) < 1.2
    assert_lands_by_itself(flight, 6.0, away_m=60.0)


def test_a_vehicle_that_tips_over_stops_its_motors() -> None:
    def rolled(message: MavMessage) -> bool:
        """Add a roll rate to the gyroscope: the controller rolls the other way until the vehicle tips over."""
        if message.get_msgId() == dialect.MAVLINK_MSG_ID_HIL_SENSOR:
            message.xgyro -= 1.5
        return True

    flight, simulator = Flight.with_tampered_simulator(rolled)
    flight.take_off(4.0)
    simulator.active = True
    flight.wait(lambda: not flight.truth.armed_motors, 15.0, "motors off")
    assert not flight.status.armed or flight.bus.run_for(0.5, stop=lambda: not flight.status.armed)
