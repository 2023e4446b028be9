"""The autopilot's own modes, flown in virtual time by a ground station that only speaks MAVLink."""

from collections.abc import Iterable
from math import nan

import msgspec
import pytest

from benchmarks.quality.autopilot import windy
from jezero.base.config import load_config
from jezero.base.frames import EARTH_RADIUS_M, horizontal
from jezero.base.mavlink import MavlinkCodec, MavMessage, dialect
from jezero.base.vehicle_config import VehicleConfig
from jezero.runtime.memory_bus import UDP_DELAY, MemoryBus
from jezero.runtime.service import Inbox, Output, Send, Spec
from jezero.schemas import topics
from jezero.schemas.state import Truth
from jezero.services.autopilot.config import AutopilotConfig
from jezero.services.autopilot.service import Autopilot
from jezero.services.simulator.service import Simulator
from jezero.trials.stack import SYSTEM_ID

ARM, TAKEOFF, LAND, RETURN, REPOSITION = 400, 22, 21, 20, 192
NORTH_10_M_DEG = 10.0 / EARTH_RADIUS_M * 57.29577951308232


class GroundStation:
    """Sends what is queued and keeps the newest message of each kind."""

    spec = Spec(name="station", links=("autopilot",), triggers=("autopilot",), rate_hz=20)

    def __init__(self) -> None:
        self._codec = MavlinkCodec(255, 190)
        self._queue = b""
        self.newest: dict[int, MavMessage] = {}

    def send(self, command: int, *parameters: float) -> None:
        self._queue += self._codec.pack(
            dialect.MAVLink_command_long_message(SYSTEM_ID, 1, command, 0, *(*parameters, *[0.0] * 7)[:7])
        )

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        for message in self._codec.parse(inbox.received("autopilot")):
            self.newest[message.get_msgId()] = message
        if self._queue:
            yield Send("autopilot", self._queue)
            self._queue = b""


class Flight:
    def __init__(self) -> None:
        self.bus = MemoryBus(4)
        self.station = GroundStation()
        self.truth: Truth | None = None
        self.bus.observe(self._observe)
        self.bus.wire(("simulator", "hil"), ("autopilot", "hil"))
        self.bus.wire(("autopilot", "gcs"), ("station", "autopilot"), UDP_DELAY)
        vehicle = load_config(VehicleConfig, "vehicle")
        self.bus.add(Simulator(windy(2.0, 0.3), vehicle, 4, 1))
        self.bus.add(Autopilot(load_config(AutopilotConfig, "autopilot"), vehicle, SYSTEM_ID))
        self.bus.add(self.station)
        self.bus.run_for(6.0)

    def _observe(self, t_ns: int, topic: str, data: bytes) -> None:
        if topic == topics.TRUTH.name:
            self.truth = msgspec.json.decode(data, type=Truth)

    @property
    def height_m(self) -> float:
        assert self.truth is not None
        return -self.truth.pos_uav_ned_m[2]

    @property
    def mode(self) -> tuple[int, int]:
        custom = self.station.newest[dialect.MAVLINK_MSG_ID_HEARTBEAT].custom_mode
        return custom >> 16 & 0xFF, custom >> 24 & 0xFF

    @property
    def armed(self) -> bool:
        return bool(self.station.newest[dialect.MAVLINK_MSG_ID_HEARTBEAT].base_mode & 128)

    def take_off(self) -> None:
        self.station.send(ARM, 1.0)
        self.bus.run_for(1.0)
        assert self.armed
        self.station.send(TAKEOFF, 0.0, 0.0, 0.0, nan, nan, nan, nan)
        self.bus.run_for(1.0)
        assert self.mode == (4, 2)
        assert self.bus.run_for(15.0, stop=lambda: self.mode == (4, 3)), "takeoff didn't end in hold"


def test_takeoff_climbs_to_the_parameters_height_and_holds() -> None:
    flight = Flight()
    flight.take_off()
    flight.bus.run_for(4.0)
    assert 2.0 < flight.height_m < 3.0


def test_takeoff_to_an_altitude_above_sea_level_and_a_place_ends_there() -> None:
    flight = Flight()
    home = flight.station.newest[dialect.MAVLINK_MSG_ID_HOME_POSITION]
    latitude_deg = home.latitude * 1e-7 + NORTH_10_M_DEG
    flight.station.send(ARM, 1.0)
    flight.bus.run_for(1.0)
    flight.station.send(TAKEOFF, 0.0, 0.0, 0.0, nan, latitude_deg, home.longitude * 1e-7, home.altitude * 1e-3 + 1.5)
    flight.bus.run_for(15.0)
    assert flight.mode == (4, 3)
    assert 1.0 < flight.height_m < 2.0
    assert flight.truth is not None
    assert 8.5 < flight.truth.pos_uav_ned_m[0] < 11.5


@pytest.mark.parametrize(("latitude_deg", "above_m", "result"), [(nan, -400.0, 0), (0.0, 5.0, 2)])
def test_takeoff_to_below_the_ground_or_out_of_reach_stays_on_it(
    latitude_deg: float, above_m: float, result: int
) -> None:
    """PX4 doesn't lift off in these cases either. Latitude and longitude 0 mean the present position."""
    flight = Flight()
    home = flight.station.newest[dialect.MAVLINK_MSG_ID_HOME_POSITION]
    flight.station.send(ARM, 1.0)
    flight.bus.run_for(1.0)
    flight.station.send(TAKEOFF, 0.0, 0.0, 0.0, nan, latitude_deg, latitude_deg, home.altitude * 1e-3 + above_m)
    flight.bus.run_for(1.0)
    assert flight.station.newest[dialect.MAVLINK_MSG_ID_COMMAND_ACK].result == result
    assert flight.mode == ((4, 2) if result == 0 else (4, 3))
    assert flight.bus.run_for(12.0, stop=lambda: not flight.armed)
    assert flight.height_m < 0.05


def test_land_lands_and_disarms() -> None:
    flight = Flight()
    flight.take_off()
    flight.station.send(LAND, 0.0, 0.0, 0.0, nan, nan, nan, nan)
    assert flight.bus.run_for(20.0, stop=lambda: not flight.armed)
    flight.bus.run_for(1.5)
    assert flight.height_m < 0.1
    assert flight.mode == (4, 3)


def test_reposition_flies_there_and_return_comes_home_higher_up_and_lands() -> None:
    flight = Flight()
    flight.take_off()
    origin = flight.station.newest[dialect.MAVLINK_MSG_ID_HOME_POSITION]
    latitude_deg = origin.latitude * 1e-7 + NORTH_10_M_DEG
    flight.station.send(REPOSITION, -1.0, 1.0, 0.0, nan, latitude_deg, origin.longitude * 1e-7, nan)
    flight.bus.run_for(12.0)
    assert flight.truth is not None
    assert 8.5 < flight.truth.pos_uav_ned_m[0] < 11.5
    highest_m = 0.0
    flight.station.send(RETURN)

    def home() -> bool:
        nonlocal highest_m
        highest_m = max(highest_m, flight.height_m)
        return not flight.armed

    assert flight.bus.run_for(60.0, stop=home)
    assert 8.5 < highest_m < 12.0
    assert horizontal(flight.truth.pos_uav_ned_m) < 1.5
    assert flight.height_m < 0.6
