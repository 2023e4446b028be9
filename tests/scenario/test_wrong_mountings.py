"""Sensors that are mounted otherwise than declared: no goal succeeds somewhere else than it was asked to.

`pytest -s -m "" tests/scenario/test_wrong_mountings.py` flies five angles of each and prints a row for each flight.
"""

from collections.abc import Callable
from math import cos, hypot, radians, sin

import msgspec
import pytest
from msgspec.structs import replace

from jezero.base.codec import decode, encode
from jezero.base.config import load_config
from jezero.base.frames import subtract
from jezero.base.mavlink import MavMessage
from jezero.base.vehicle_config import VehicleConfig
from jezero.runtime.memory_bus import MemoryBus
from jezero.schemas import topics
from jezero.schemas.goals import LandOnSpotGoal, TakeoffGoal
from jezero.schemas.health import ServiceHealth
from jezero.schemas.preflight import PreflightReport
from jezero.schemas.sensors import Altimeter, CameraInfo, Magnetometer, Uwb
from jezero.trials.stack import boot_id, service_makers, wired_bus
from tests.scenario.rig import Flight, TamperedSimulator, go_to

Tamper = Callable[[str, bytes], bytes]
ANGLES_DEG = {
    "compass": (20, 45, 90, 135, 180),
    "altimeter": (5, 10, 20, 30, 45),
    "camera": (5, 15, 45, 90, 180),
    "anchors": (5, 15, 45, 90, 180),
}
QUICK = (("compass", 90), ("anchors", 45))
CASES = [
    pytest.param(sensor, angle_deg, marks=() if (sensor, angle_deg) in QUICK else pytest.mark.slow)
    for sensor, angles_deg in ANGLES_DEG.items()
    for angle_deg in angles_deg
]
OFF_MAX_M = {"takeoff": 1.5, "go_to": 1.0, "land_on_spot": 0.5}
"""Greatest horizontal distance in truth from where a goal was asked to end, of one that succeeds."""
CAMERA_NAMED_DEG = 45
"""Angle from which a camera that is turned must be named."""
ESTIMATOR = topics.health_of("estimator").name
FAR = (15.0, 0.0, -3.0)


def turned(x: float, y: float, angle_deg: float) -> tuple[float, float]:
    """A vector turned clockwise as seen from above, in axes that point forward and right."""
    angle = radians(angle_deg)
    return cos(angle) * x - sin(angle) * y, sin(angle) * x + cos(angle) * y


def wrong_messages(sensor: str, angle_deg: float, vehicle: VehicleConfig) -> Tamper:
    """What the sensor publishes where it is turned by an angle, by the topic's name and the message."""

    def tamper(name: str, data: bytes) -> bytes:
        if sensor == "compass" and name == topics.MAG.name:
            mag: Magnetometer = decode(Magnetometer, data)
            x, y, z = mag.field_frd_gauss
            return encode(replace(mag, field_frd_gauss=(*turned(x, y, angle_deg), z)))
        if sensor == "camera" and name == topics.CAMERA_INFO.name:
            info: CameraInfo = decode(CameraInfo, data)
            return encode(replace(info, turn_camera_rad=0.0))
        if sensor == "altimeter" and name == topics.ALTIMETER.name:
            altimeter: Altimeter = decode(Altimeter, data)
            if altimeter.range_m is None:
                return data
            range_m = altimeter.range_m / cos(radians(angle_deg))
            seen = range_m <= vehicle.altimeter.range_max_m
            return encode(replace(altimeter, range_m=range_m if seen else None))
        if sensor == "anchors" and name == topics.UWB.name:
            uwb: Uwb = decode(Uwb, data)
            declared = [
                replace(
                    r,
                    pos_anchor_rover_body_m=(
                        *turned(*r.pos_anchor_rover_body_m[:2], -angle_deg), r.pos_anchor_rover_body_m[2],
                    ),
                )
                for r in uwb.ranges
            ]  # fmt: skip
            return encode(replace(uwb, ranges=tuple(declared)))
        return data

    return tamper


class WrongFlight(Flight):
    """A flight with one sensor that is turned by an angle against its declaration.

    Attributes:
        doubts: what preflight said of sensors, as warnings and failures.
        left_out: what the estimator left out or corrected, for people.
    """

    def __init__(self, sensor: str, angle_deg: float) -> None:
        self._vehicle = load_config(VehicleConfig, "vehicle")
        self._sensor, self._angle_deg = sensor, angle_deg
        self.doubts: list[str] = []
        self.left_out: list[str] = []
        super().__init__(3, self._make)
        tamper = wrong_messages(sensor, angle_deg, self._vehicle)
        self.bus.tamper = lambda sender, receiver, name, t_ns, data: [(t_ns, tamper(name, data))]
        self.bus.observe(self._keep)

    def _make(self, seed: int) -> MemoryBus:
        bus = wired_bus(seed)
        turn_rad = radians(self._angle_deg) if self._sensor == "camera" else 0.0
        real = replace(self._vehicle, camera=replace(self._vehicle.camera, turn_rad=turn_rad))
        right, wrong = service_makers(seed, vehicle=self._vehicle), service_makers(seed, vehicle=real)
        for name in right:
            service = (wrong if name in ("simulator", "camera") else right)[name](boot_id(seed, name))
            if name == "simulator":
                service = TamperedSimulator(service, self._turn_field)
                service.active = True
            bus.add(service)
        return bus

    def _turn_field(self, message: MavMessage) -> bool:
        if self._sensor == "compass" and message.get_type() == "HIL_SENSOR":
            message.xmag, message.ymag = turned(message.xmag, message.ymag, self._angle_deg)
        return True

    def _keep(self, t_ns: int, topic: str, data: bytes) -> None:
        if topic == ESTIMATOR:
            text = msgspec.json.decode(data, type=ServiceHealth).text
            self.left_out += [part for part in text.split("; ") if "left out" in part or "corrected" in part]
        if topic == topics.PREFLIGHT.name:
            report = msgspec.json.decode(data, type=PreflightReport)
            checks = [each for each in report.checks if each.name in ("sensors", "noise", "gnss", "compass", "rover")]
            self.doubts += [f"{each.name}: {each.text}" for each in checks if each.verdict != "passed"]


@pytest.mark.long
@pytest.mark.parametrize(("sensor", "angle_deg"), CASES)
def test_no_goal_succeeds_somewhere_else_than_it_was_asked_to(sensor: str, angle_deg: float) -> None:
    flight = WrongFlight(sensor, angle_deg)
    flight.wait_ready()
    flight.bus.run_for(5.0)
    ends = []
    goals = ((topics.TAKEOFF, TakeoffGoal(altitude_m=3.0)), (topics.GO_TO, go_to(*FAR)), (topics.LAND_ON_SPOT, None))
    for action, goal in goals:
        if flight.status.name == "IDLE" and action is not topics.TAKEOFF:
            break
        result = flight.finish(flight.send(action, goal or LandOnSpotGoal()), 200.0)
        truth = flight.truth
        asked_ned_m = {"takeoff": (0.0, 0.0, 0.0), "go_to": FAR}.get(action.name, truth.pos_rover_ned_m)
        off_m = hypot(*subtract(truth.pos_uav_ned_m, asked_ned_m)[:2])
        ends.append((action.name, result.outcome, off_m, result.reason))
    print(f"\n{sensor} {angle_deg}°: {'; '.join(sorted(set(flight.doubts))) or 'preflight passes'}")
    for name, outcome, off_m, reason in ends:
        print(f"    {name} {outcome}, {off_m:.2f} m off {reason}")
    for text in dict.fromkeys(flight.left_out):
        print(f"    the estimator: {text}")
    if sensor == "camera" and angle_deg >= CAMERA_NAMED_DEG:
        assert any("the tags are left out" in text and "the turn of the camera" in text for text in flight.left_out)
    assert all(off_m < OFF_MAX_M[name] for name, outcome, off_m, _ in ends if outcome == "succeeded")
