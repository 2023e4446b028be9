"""One edit in `vehicle.toml` reaches every service that simulates, sees, estimates, flies or commands the vehicle."""

from collections.abc import Sequence
from math import radians, tan
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from jezero.base.codec import decode
from jezero.base.config import ConfigError, load_config
from jezero.base.frames import Vec3, add, quat_rotate, subtract
from jezero.base.vehicle_config import (
    AirframeConfig,
    BatteryConfig,
    CameraMountConfig,
    PlatformConfig,
    UwbLayoutConfig,
    VehicleConfig,
    VehicleLimitsConfig,
)
from jezero.runtime.memory_bus import NO_DELAY, MemoryBus
from jezero.runtime.service import Inbox, Output, Publish, Service, Spec
from jezero.schemas import topics
from jezero.schemas.estimate import Relative, TagEstimate
from jezero.schemas.goals import AreaCoverageGoal, Goal, GoToGoal, TakeoffGoal
from jezero.schemas.landing_board import BIG_ID
from jezero.schemas.rows import Action, Topic
from jezero.schemas.sensors import Altimeter, CameraInfo, RoverOdometry, TagCorners, Uwb
from jezero.schemas.state import Clock, Odometry, Scene, Status
from jezero.schemas.struct import Message
from jezero.schemas.topics import GO_TO, TAKEOFF
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.area_coverage.coverage_plan import plan_coverage
from jezero.services.actions.config import ActionsConfig, load_actions_config
from jezero.services.actions.land_on_spot.contact import TouchdownDetector
from jezero.services.actions.land_on_spot.platform import PlatformState
from jezero.services.actions.motion.behaviour import Plan, Refusal
from jezero.services.actions.motion.limits import high_or_far_refusal
from jezero.services.actions.table import PLANNERS
from jezero.services.autopilot.config import AutopilotConfig
from jezero.services.autopilot.mixer import Mixer
from jezero.services.autopilot.parameters import Parameters
from jezero.services.estimator.config import EstimatorConfig
from jezero.services.estimator.service import Estimator
from jezero.services.estimator.tag_detector.config import TagDetectorConfig
from jezero.services.estimator.tag_detector.service import TagDetector
from jezero.services.simulator import sensors
from jezero.services.simulator.body import BodyState, RoverState
from jezero.services.simulator.camera.config import CameraConfig, ProjectionConfig
from jezero.services.simulator.camera.service import CameraSimulator
from jezero.services.simulator.config import SimulatorConfig, UwbConfig
from jezero.services.simulator.service import Simulator
from jezero.services.vehicle_bridge.admission import force_disarm_refusal
from jezero.services.vehicle_bridge.vehicle import VehicleSnapshot

Arrivals = list[tuple[int, Topic[Any], Message]]
MS = 1_000_000
ZERO: Vec3 = (0.0, 0.0, 0.0)
LEVEL = (1.0, 0.0, 0.0, 0.0)
IDLE = Status(t_ns=0, code=0, name="IDLE", armed=False, landed=True, in_charge="none", bridge_boot_id=1, ready=True)
ANCHORS_M = ((0.4, 0.0, 0.0), (-0.3, 0.35, -0.1), (-0.3, -0.35, -0.1))
EXACT = CameraConfig(
    mode="projected",
    projection=ProjectionConfig(size_half_px=1.0, share_in_shadow=1.0, std_corner_px=0.0, std_size_px=0.0),
)
OTHER = VehicleConfig(
    camera=CameraMountConfig(pos_camera_frd_m=(0.1, 0.0, 0.05), pitch_offset_rad=radians(-15.0)),
    uwb=UwbLayoutConfig(pos_tag_frd_m=(-0.1, 0.0, 0.02), pos_anchors_rover_body_m=ANCHORS_M),
    platform=PlatformConfig(side_tag_m=0.4),
)


class Feeder:
    """Publishes messages at their times."""

    def __init__(self, messages: Arrivals) -> None:
        self.spec = Spec(
            name="feeder", outputs=tuple({topic.name: topic for _, topic, _ in messages}.values()), rate_hz=100.0
        )
        self._messages = sorted(messages, key=lambda entry: entry[0])

    def step(self, t_ns: int, inbox: Inbox) -> list[Output]:
        due = [entry for entry in self._messages if entry[0] <= t_ns]
        self._messages = self._messages[len(due) :]
        return [Publish(topic, message) for _, topic, message in due]


def published(topic: Topic[Any], services: Sequence[Service], messages: Arrivals) -> list[Any]:
    """Messages of a topic that the services publish within 4 s when they receive some messages."""
    bus, found = MemoryBus(delay=NO_DELAY), []

    def observe(t_ns: int, name: str, data: bytes) -> None:
        if name == topic.name:
            found.append(decode(topic.type, data))

    bus.observe(observe)
    for service in (*services, Feeder(messages)):
        bus.add(service)
    bus.run_for(4.0)
    return found


def scene(pos_uav_ned_m: Vec3) -> Scene:
    """A level vehicle over a platform in the origin, after one second."""
    return Scene(
        t_ns=NS_PER_S,
        epoch_id=1,
        pos_uav_ned_m=pos_uav_ned_m,
        vel_uav_ned_mps=ZERO,
        q_ned_from_frd=LEVEL,
        rates_uav_frd_rps=ZERO,
        pos_rover_ned_m=ZERO,
        vel_rover_ned_mps=ZERO,
        yaw_rover_rad=0.0,
    )


def odometry(t_ns: int) -> Odometry:
    return Odometry(
        t_ns=t_ns, epoch_id=1, pos_uav_ned_m=ZERO, vel_uav_ned_mps=ZERO, q_ned_from_frd=LEVEL, rates_uav_frd_rps=ZERO
    )


def seen_corners(vehicle: VehicleConfig, pos_uav_ned_m: Vec3) -> TagCorners:
    """Corners in one picture of the projecting camera."""
    camera = CameraSimulator(EXACT, vehicle, None, seed=1)
    corners: list[TagCorners] = published(
        topics.TAG_CORNERS, [camera], [(NS_PER_S, topics.SCENE, scene(pos_uav_ned_m))]
    )
    return corners[0]


def located(vehicle: VehicleConfig, corners: TagCorners, info: CameraInfo) -> TagEstimate:
    """Estimate of a vehicle's tag detector for given corners."""
    messages: Arrivals = [
        (0, topics.CAMERA_INFO, info),
        (NS_PER_S, topics.ODOMETRY, odometry(NS_PER_S)),
        (NS_PER_S + 20 * MS, topics.TAG_CORNERS, corners),
    ]
    estimates: list[TagEstimate] = published(topics.ESTIMATE_TAG, [TagDetector(TagDetectorConfig(), vehicle)], messages)
    return estimates[0]


def test_the_shipped_vehicle_is_the_default() -> None:
    assert load_config(VehicleConfig, "vehicle") == VehicleConfig()


def test_a_camera_pitched_back_sees_the_point_below_it_nearer_to_the_nose() -> None:
    """15° back, 2 m over the tag: its middle is focal length times tan 15° above the picture's middle."""
    vehicle = msgspec.structs.replace(OTHER, platform=PlatformConfig())
    camera = vehicle.camera
    corners = seen_corners(vehicle, (-0.1, 0.0, -2.05))
    assert corners.pitch_camera_rad == pytest.approx(radians(-105.0), abs=1e-5)
    nested = next(tag for tag in corners.tags if tag.tag_id == 1)
    x_px, y_px = np.mean(nested.corners_px, axis=0)
    assert x_px == pytest.approx(camera.center_px[0], abs=0.5)
    assert y_px == pytest.approx(camera.center_px[1] - camera.focal_px * tan(radians(15.0)), abs=0.5)


def test_camera_and_tag_detector_agree_about_mounting_and_board() -> None:
    pos_ned_m: Vec3 = (0.3, -0.2, -2.0)
    found = located(OTHER, seen_corners(OTHER, pos_ned_m), OTHER.camera.info(0))
    assert BIG_ID in found.tag_ids
    assert found.pos_uav_rel_rover_ned_m == pytest.approx(pos_ned_m, abs=1e-3)


def test_a_detector_with_another_tag_size_is_wrong_by_the_ratio() -> None:
    """A camera 2 m over tags of 0.4 m that are taken for tags of 0.6 m seems to be at 3 m."""
    mounted = VehicleConfig(camera=CameraMountConfig(pos_camera_frd_m=ZERO), platform=OTHER.platform)
    corners = seen_corners(mounted, (0.0, 0.0, -2.0))
    found = located(VehicleConfig(), corners, mounted.camera.info(0))
    assert found.pos_uav_rel_rover_ned_m[2] == pytest.approx(-3.0, abs=0.01)


def test_the_simulator_measures_ranges_to_the_given_anchors() -> None:
    rounds: list[Uwb] = published(topics.UWB, [Simulator(SimulatorConfig(), OTHER, seed=1, boot_id=1)], [])
    assert {r.anchor: r.pos_anchor_rover_body_m for r in rounds[-1].ranges} == dict(enumerate(ANCHORS_M))


def arrivals(vehicle: VehicleConfig, pos_uav_ned_m: Vec3) -> Arrivals:
    """Measurements of a vehicle that hovers over a rover in the origin, as exact as a sensor that isn't frozen can be.

    Args:
        pos_uav_ned_m: position of the feet.
    """
    center_ned_m = add(pos_uav_ned_m, (0.0, 0.0, -vehicle.airframe.height_stand_m))
    body, rover = BodyState(center_ned_m, ZERO, LEVEL, ZERO, ZERO), RoverState(ZERO, ZERO, LEVEL, ZERO, 0.0, 0.0, 0.0)
    uwb = sensors.UwbModel(UwbConfig(std_m=0.002, std_bias_m=0.0), vehicle.uwb, seed=1)
    lens_ned_m = add(center_ned_m, quat_rotate(LEVEL, vehicle.altimeter.pos_altimeter_frd_m))
    found: Arrivals = [(0, topics.CLOCK, Clock(t_ns=0, epoch_id=1, wall_ns=0))]
    for t_ns in range(20 * MS, 4 * NS_PER_S, 20 * MS):
        still = RoverOdometry(
            t_ns=t_ns, pos_odom_m=(0.0, 0.0), yaw_rover_rad=0.0, speed_rover_body_mps=0.0, yaw_rate_rover_rps=0.0
        )
        found += [
            (t_ns, topics.ODOMETRY, odometry(t_ns)),
            (t_ns, topics.ROVER_ODOMETRY, still),
            (t_ns + 10 * MS, topics.UWB, uwb.measure(t_ns, body, rover)),
            (t_ns + 10 * MS, topics.ALTIMETER, Altimeter(t_ns=t_ns, range_m=-lens_ned_m[2])),
        ]
    return found


def error_m(vehicle: VehicleConfig, flown: VehicleConfig, pos_uav_ned_m: Vec3) -> Vec3:
    """Error of a vehicle's estimator with the measurements of another vehicle."""
    estimator = Estimator(EstimatorConfig(), vehicle)
    estimates: list[Relative] = published(topics.RELATIVE, [estimator], arrivals(flown, pos_uav_ned_m))
    assert estimates[-1].valid, estimates[-1].reason
    return subtract(estimates[-1].pos_uav_rel_rover_ned_m, pos_uav_ned_m)


def test_the_estimator_finds_the_rover_by_three_anchors() -> None:
    assert error_m(OTHER, OTHER, (0.2, -0.3, -3.0)) == pytest.approx(ZERO, abs=0.02)


def test_the_estimator_takes_the_place_of_the_uwb_tag_and_the_standing_height() -> None:
    tall = msgspec.structs.replace(OTHER, airframe=msgspec.structs.replace(OTHER.airframe, height_stand_m=0.4))
    assert error_m(tall, tall, (0.2, -0.3, -3.0)) == pytest.approx(ZERO, abs=0.02)
    assert error_m(OTHER, tall, (0.2, -0.3, -3.0))[2] == pytest.approx(0.148 - 0.4, abs=0.03)


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("[camera]\nfocal_px = 3.0", "focal_px"),
        ("[airframe]\nmass_kg = nan", "airframe.mass_kg"),
        ("[uwb]\npos_anchors_rover_body_m = [[0.4, 0.4, 0.0], [-0.4, 0.4, 0.0]]", "uwb.pos_anchors_rover_body_m"),
        ("[platform]\nside_tag_m = 0.9", "tag 77 with its margin reaches 0.562 m"),
        ("[platform]\ntags = [{ tag_id = 3, side_m = 0.5, at_m = [0.0, 0.0, 0.0] }]", "platform.tags"),
    ],
)
def test_a_wrong_field_is_named(tmp_path: Path, text: str, names: str) -> None:
    (tmp_path / "vehicle.toml").write_text(text)
    with pytest.raises(ConfigError, match=names):
        load_config(VehicleConfig, "vehicle", tmp_path)


def test_another_board_is_one_line(tmp_path: Path) -> None:
    text = "[platform]\ntags = [{ tag_id = 3, side_m = 0.7, pos_rover_body_m = [0.0, 0.0, 0.0] }]"
    (tmp_path / "vehicle.toml").write_text(text)
    vehicle = load_config(VehicleConfig, "vehicle", tmp_path)
    corners = seen_corners(vehicle, (0.0, 0.0, -2.0))
    assert [tag.tag_id for tag in corners.tags] == [3]
    found = located(vehicle, corners, vehicle.camera.info(0))
    assert found.pos_uav_rel_rover_ned_m == pytest.approx((0.0, 0.0, -2.0), abs=1e-3)


def test_the_actions_read_the_vehicles_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("JEZERO_CONFIG_DIR", str(tmp_path))
    (tmp_path / "vehicle.toml").write_text("[limits]\naltitude_max_m = 10.0")
    (tmp_path / "actions.toml").write_text("")
    config = load_actions_config()
    assert "limit of 10 m" in high_or_far_refusal((0.0, 0.0, -11.0), config.vehicle.limits)
    (tmp_path / "actions.toml").write_text("[vehicle.limits]\naltitude_max_m = 20.0")
    with pytest.raises(ConfigError, match=r"belongs in vehicle\.toml"):
        load_actions_config()


@pytest.mark.parametrize("goal", [TakeoffGoal(altitude_m=6.0), GoToGoal(target_ned_m=(0.0, 0.0, -6.0))])
def test_every_action_keeps_to_the_vehicles_limits(goal: Goal) -> None:
    action: Action[Any] = TAKEOFF if isinstance(goal, TakeoffGoal) else GO_TO
    low = ActionsConfig(vehicle=VehicleConfig(limits=VehicleLimitsConfig(altitude_max_m=5.0)))
    assert isinstance(PLANNERS[action.name](ActionsConfig()).plan(goal, IDLE), Plan)
    refusal = PLANNERS[action.name](low).plan(goal, IDLE)
    assert isinstance(refusal, Refusal)
    assert "5 m" in refusal.reason


def test_a_coverage_spaces_its_lines_by_the_vehicles_camera() -> None:
    """From 9 m without overlap the lines are as far apart as a picture is wide: 2 * 9 m * tan(half the angle)."""
    goal = AreaCoverageGoal(
        polygon_ned_m=((0.0, 0.0), (60.0, 0.0), (60.0, 60.0), (0.0, 60.0)), z_ned_m=-9.0, overlap=0.0, force=True
    )
    narrow = VehicleConfig(camera=CameraMountConfig(width_px=320, height_px=320, field_of_view_deg=60.0))
    plan = plan_coverage(goal, ActionsConfig(vehicle=narrow))
    assert plan.line_distance_m == pytest.approx(18.0 * tan(radians(30.0)))
    assert plan_coverage(goal, ActionsConfig()).line_distance_m == pytest.approx(18.0 * tan(radians(40.0)))


def test_on_a_larger_platform_the_vehicle_may_stand_farther_from_its_middle() -> None:
    beside = PlatformState((0.7, 0.0, -0.02), ZERO, ZERO, 0.0)

    def touches_down(vehicle: VehicleConfig) -> bool:
        detector = TouchdownDetector(vehicle)
        return any(detector.update(t_ns, beside, None) for t_ns in range(0, 5 * NS_PER_S, 20 * MS))

    assert not touches_down(VehicleConfig())
    assert touches_down(VehicleConfig(platform=PlatformConfig(side_m=1.6)))


def test_the_bridge_stops_the_motors_by_force_on_taller_legs_too() -> None:
    """With legs that are 0.252 m longer, the altimeter on the ground measures 0.35 m."""
    tall = VehicleConfig(airframe=AirframeConfig(height_stand_m=0.4))
    standing = VehicleSnapshot(t_ns=0, timer_ns=0, range_m=0.35)
    assert force_disarm_refusal(standing, tall) == ""
    assert force_disarm_refusal(standing, VehicleConfig())


def test_the_autopilot_mixes_for_the_vehicles_rotors_and_knows_its_battery() -> None:
    """On arms that are twice as long, the same torque takes half the difference between the rotors."""
    short = AirframeConfig()
    forward_right_m: Any = tuple((2.0 * forward_m, 2.0 * right_m) for forward_m, right_m in short.pos_rotors_frd_m)
    long = msgspec.structs.replace(short, pos_rotors_frd_m=forward_right_m)
    differences = []
    for airframe in (short, long):
        front_right, rear_left, front_left, rear_right = Mixer(VehicleConfig(airframe=airframe), 0.5).commands(
            14.7, (0.0, 0.4, 0.0)
        )
        differences.append(front_right + front_left - rear_left - rear_right)
    assert differences[1] == pytest.approx(0.5 * differences[0])
    parameters = Parameters(AutopilotConfig(), BatteryConfig(cells=6, capacity_mah=9000.0), 1)
    assert (parameters.get("BAT1_N_CELLS"), parameters.get("BAT1_CAPACITY")) == (6, 9000.0)


def test_a_flight_uses_the_current_in_hover_of_its_battery() -> None:
    """18 min of 15.5 A are 4650 of 5000 mAh."""
    assert BatteryConfig().used(18 * 60.0) == pytest.approx(0.93)
    assert BatteryConfig(capacity_mah=10_000.0, hover_a=30.0, electronics_a=1.0).used(18 * 60.0) == pytest.approx(0.93)
