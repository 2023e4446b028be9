"""The scene for 3D viewers: frames, entities, positions on the earth, and their size."""

import json
import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from jezero.base.codec import encode
from jezero.base.frames import Vec3, enu_from_ned, quat_from_euler, quat_multiply, quat_rotate
from jezero.base.vehicle_config import VehicleConfig
from jezero.recording.channels import json_schema, schema_name
from jezero.recording.thinned_path import POINTS_MAX, ThinnedPath
from jezero.recording.viewer_scene import CALIBRATION, LOCATION, SCENE, TRANSFORMS, ViewerScene
from jezero.schemas import topics
from jezero.schemas.commands import CameraPitch, Phase, Setpoint
from jezero.schemas.estimate import RoverEstimate
from jezero.schemas.rows import Topic
from jezero.schemas.state import Odometry, Truth
from jezero.schemas.struct import Message
from jezero.schemas.units import NS_PER_S
from tests.recording.frames_of_viewers import in_map

VEHICLE = VehicleConfig()
STAND_M = VEHICLE.airframe.height_stand_m
Messages = dict[str, Any]


def odometry(pos_ned_m: Vec3 = (1.0, 2.0, -3.0), **changes: Any) -> Odometry:
    fields = {
        "t_ns": 0,
        "epoch_id": 1,
        "pos_uav_ned_m": pos_ned_m,
        "vel_uav_ned_mps": (0.0, 0.0, 0.0),
        "q_ned_from_frd": quat_from_euler(0.1, -0.2, 2.0),
        "rates_uav_frd_rps": (0.0, 0.0, 0.0),
    }
    return Odometry(**{**fields, **changes})


def rover(**changes: Any) -> RoverEstimate:
    fields = {
        "t_ns": 0,
        "epoch_id": 1,
        "valid": True,
        "pos_rover_ned_m": (5.0, -3.0, -0.5),
        "vel_rover_ned_mps": (0.0, 0.0, 0.0),
        "yaw_rover_rad": 0.5,
        "std_pos_m": 0.1,
    }
    return RoverEstimate(**{**fields, **changes})


def drawn(scene: ViewerScene, t_s: float, *messages: tuple[Topic[Any], Message]) -> Messages:
    """The newest message of each viewer's channel after some messages of one time that arrive at once, decoded."""
    made, t_ns = {}, round(t_s * NS_PER_S)
    for topic, message in messages:
        for channel, data in scene.update(t_ns, topic.name, encode(replace(message, t_ns=t_ns))):
            made[channel] = json.loads(data)
    return made


def entities(update: Messages) -> dict[str, Messages]:
    return {entity["id"]: entity for entity in update["entities"]}


def line(update: Messages, name: str) -> list[tuple[float, float, float]]:
    return [(p["x"], p["y"], p["z"]) for p in entities(update)[name]["lines"][0]["points"]]


def test_the_vehicle_is_at_its_position_in_a_root_frame_of_east_north_and_up() -> None:
    transforms = drawn(ViewerScene(VEHICLE), 1.0, (topics.ODOMETRY, odometry()))[TRANSFORMS]
    assert in_map(transforms, "frd") == pytest.approx((2.0, 1.0, 3.0 + STAND_M))


def test_a_point_ahead_of_the_vehicle_is_where_its_attitude_puts_it() -> None:
    north = drawn(ViewerScene(VEHICLE), 1.0, (topics.ODOMETRY, odometry(q_ned_from_frd=(1.0, 0.0, 0.0, 0.0))))
    assert in_map(north[TRANSFORMS], "frd", (1.0, 0.0, 0.0)) == pytest.approx((2.0, 2.0, 3.0 + STAND_M))
    assert in_map(north[TRANSFORMS], "frd", (0.0, 1.0, 0.0)) == pytest.approx((3.0, 1.0, 3.0 + STAND_M))
    tilted = odometry()
    turned = drawn(ViewerScene(VEHICLE), 1.0, (topics.ODOMETRY, tilted))[TRANSFORMS]
    point_ned_m = quat_rotate(tilted.q_ned_from_frd, (0.3, -0.2, 0.1))
    offset_m = np.subtract(in_map(turned, "frd", (0.3, -0.2, 0.1)), in_map(turned, "frd"))
    assert offset_m == pytest.approx(enu_from_ned(point_ned_m))


def test_a_camera_that_points_ahead_and_down_sees_the_ground_there() -> None:
    level = odometry(q_ned_from_frd=(1.0, 0.0, 0.0, 0.0), pos_uav_ned_m=(0.0, 0.0, -10.0))
    pitch = CameraPitch(t_ns=0, pitch_camera_rad=-math.pi / 4)
    scene = ViewerScene(VEHICLE)
    down = drawn(scene, 1.0, (topics.ODOMETRY, level))[TRANSFORMS]
    axis_m = np.subtract(in_map(down, "camera", (0.0, 0.0, 1.0)), in_map(down, "camera"))
    assert axis_m == pytest.approx((0.0, 0.0, -1.0), abs=1e-4)
    drawn(scene, 1.05, (topics.CAMERA_PITCH, pitch))
    ahead = drawn(scene, 1.1, (topics.ODOMETRY, level))[TRANSFORMS]
    axis_m = np.subtract(in_map(ahead, "camera", (0.0, 0.0, 1.0)), in_map(ahead, "camera"))
    assert axis_m == pytest.approx((0.0, math.sqrt(0.5), -math.sqrt(0.5)))
    right_m = np.subtract(in_map(ahead, "camera", (1.0, 0.0, 0.0)), in_map(ahead, "camera"))
    assert right_m == pytest.approx((1.0, 0.0, 0.0), abs=1e-9)
    rest = drawn(scene, 2.0, (topics.ODOMETRY, level))[TRANSFORMS]  # nobody commands it any more
    assert in_map(rest, "camera", (0.0, 0.0, 1.0))[1] == pytest.approx(0.0, abs=1e-4)


def test_rover_and_truth_have_frames_of_their_own() -> None:
    q_rover = quat_multiply(quat_from_euler(0.0, 0.0, 1.0), quat_from_euler(0.1, -0.2, 0.0))
    truth = Truth(
        t_ns=0,
        epoch_id=1,
        pos_uav_ned_m=(1.1, 2.1, -3.1),
        vel_uav_ned_mps=(0.0, 0.0, 0.0),
        q_ned_from_frd=(1.0, 0.0, 0.0, 0.0),
        rates_uav_frd_rps=(0.0, 0.0, 0.0),
        pos_rover_ned_m=(5.1, -3.1, -0.5),
        vel_rover_ned_mps=(0.0, 0.0, 0.0),
        yaw_rover_rad=1.0,
        pitch_rover_rad=-0.2,
        roll_rover_rad=0.1,
        wind_ned_mps=(0.0, 0.0, 0.0),
        contact_force_n=0.0,
        armed_motors=True,
    )
    scene = ViewerScene(VEHICLE)
    drawn(scene, 0.95, (topics.ROVER_ESTIMATE, rover()), (topics.TRUTH, truth), (topics.ODOMETRY, odometry()))
    transforms = drawn(scene, 1.1, (topics.ODOMETRY, odometry()))[TRANSFORMS]
    assert in_map(transforms, "rover_body") == pytest.approx((-3.0, 5.0, 0.5))
    assert in_map(transforms, "frd_true") == pytest.approx((2.1, 1.1, 3.1 + STAND_M))
    point_m = quat_rotate(q_rover, (0.5, 0.5, 0.0))
    offset_m = np.subtract(
        in_map(transforms, "rover_body_true", (0.5, 0.5, 0.0)), in_map(transforms, "rover_body_true")
    )
    assert offset_m == pytest.approx(enu_from_ned(point_m))


def test_an_invalid_estimate_of_the_rover_is_not_drawn() -> None:
    scene = ViewerScene(VEHICLE)
    drawn(scene, 0.0, (topics.ODOMETRY, odometry()))
    drawn(scene, 0.95, (topics.ROVER_ESTIMATE, rover()))
    update = drawn(scene, 1.05, (topics.ODOMETRY, odometry()))[SCENE]
    assert {"frd", "rover_body"} <= entities(update).keys()
    for tenth in range(11, 30):
        made = drawn(scene, tenth / 10, (topics.ROVER_ESTIMATE, rover(valid=False)), (topics.ODOMETRY, odometry()))
        update = made.get(SCENE, update)
    assert "frd" in entities(update) and "rover_body" not in entities(update)


def test_the_path_flown_moves_with_a_position_reset_and_ends_with_the_epoch() -> None:
    scene = ViewerScene(VEHICLE)
    for second in range(3):
        update = drawn(scene, float(second), (topics.ODOMETRY, odometry((float(second), 0.0, -2.0))))[SCENE]
    assert line(update, "path flown") == [(0.0, 0.0, -2.0), (1.0, 0.0, -2.0), (2.0, 0.0, -2.0)]
    moved = odometry((3.0, 0.5, -2.0), reset_counter=1, reset_offset_ned_m=(0.0, 0.5, 0.0))
    update = drawn(scene, 3.0, (topics.ODOMETRY, moved))[SCENE]
    assert line(update, "path flown")[:3] == [(0.0, 0.5, -2.0), (1.0, 0.5, -2.0), (2.0, 0.5, -2.0)]
    update = drawn(scene, 4.0, (topics.ODOMETRY, odometry((0.0, 0.0, 0.0), epoch_id=2)))[SCENE]
    assert set(line(update, "path flown")) == {(0.0, 0.0, 0.0)}


def test_the_path_of_the_setpoints_is_that_of_the_goal_in_charge() -> None:
    scene = ViewerScene(VEHICLE)
    for second, control_id in enumerate(("a", "a", "b", "b")):
        at = Setpoint(t_ns=0, control_id=control_id, sequence=second, phase=Phase.GO_TO, pos_ned_m=(second, 0.0, -2.0))
        update = drawn(scene, float(second), (topics.SETPOINT, at))[SCENE]
    assert {point[0] for point in line(update, "path of the setpoints")} == {2.0, 3.0}


def test_positions_on_the_earth_follow_from_the_origin() -> None:
    scene = ViewerScene(VEHICLE)
    assert LOCATION not in drawn(scene, 0.0, (topics.ODOMETRY, odometry()))
    fix = drawn(scene, 1.0, (topics.ODOMETRY, odometry(origin_deg=(45.0, 7.0, 240.0), std_pos_m=0.5)))[LOCATION]
    assert fix["latitude"] == pytest.approx(45.0 + math.degrees(1.0 / 6_371_000.0), abs=1e-9)
    assert fix["longitude"] == pytest.approx(7.0 + math.degrees(2.0 / 6_371_000.0) * math.sqrt(2.0), abs=1e-9)
    assert fix["altitude"] == pytest.approx(243.0)
    assert fix["position_covariance"][0] == 0.25 and fix["position_covariance_type"] == 1


def test_the_calibration_projects_as_the_camera_does() -> None:
    calibration = drawn(ViewerScene(VEHICLE), 1.0, (topics.CAMERA_INFO, VEHICLE.camera.info(0)))[CALIBRATION]
    x, y, z = 0.2, -0.1, 2.0
    u, v, w = np.reshape(calibration["P"], (3, 4)) @ (x, y, z, 1.0)
    focal_px, center_px = VEHICLE.camera.focal_px, VEHICLE.camera.center_px
    assert (u / w, v / w) == pytest.approx((center_px[0] + focal_px * x / z, center_px[1] + focal_px * y / z))


def test_a_message_has_the_time_of_its_content_on_the_clock_of_the_recording() -> None:
    scene = ViewerScene(VEHICLE)
    assert scene.time_of(5, logged_ns=1000) == 1000  # no odometry yet
    at = replace(odometry(), t_ns=3 * NS_PER_S)
    dict(scene.update(100 * NS_PER_S, topics.ODOMETRY.name, encode(at)))
    assert scene.time_of(3 * NS_PER_S + 20, 100 * NS_PER_S + 120) == 100 * NS_PER_S + 20
    assert scene.time_of(9 * NS_PER_S, 100 * NS_PER_S + 120) == 100 * NS_PER_S + 120  # not later than its arrival
    assert scene.time_of(0, 100 * NS_PER_S + 120) == 99 * NS_PER_S + 120  # of another epoch


def test_what_cannot_be_decoded_is_not_drawn() -> None:
    scene = ViewerScene(VEHICLE)
    made = dict(scene.update(0, topics.ODOMETRY.name, b'{"t_ns": "no"}'))
    assert b'"frd"' not in made[SCENE]
    assert "frd" in entities(drawn(scene, 1.0, (topics.ODOMETRY, odometry()))[SCENE])


def test_a_second_of_a_long_flight_costs_no_more_than_one_of_a_short_flight() -> None:
    scene, sizes = ViewerScene(VEHICLE), []
    for second in range(4000):  # at 1 m/s on a spiral, which has no straight parts
        angle_rad = math.sqrt(0.2 * second)
        at = (10.0 * angle_rad * math.cos(angle_rad), 10.0 * angle_rad * math.sin(angle_rad), -5.0)
        sizes.append(sum(len(d) for _, d in scene.update(second * NS_PER_S, "odometry", encode(odometry(at)))))
    assert max(sizes) < 30_000


def test_a_thinned_path_keeps_its_shape() -> None:
    path = ThinnedPath()
    for step in range(5000):
        path.add((0.1 * step, 3.0 * math.sin(0.01 * step), 0.0))
    points = path.points_m
    assert points[0] == (0.0, 0.0, 0.0) and points[-1][0] == pytest.approx(499.9)
    assert POINTS_MAX // 2 <= len(points) <= POINTS_MAX + 1
    assert max(math.dist(a, b) for a, b in pairwise(points)) < 6.0


@pytest.mark.parametrize("channel", [TRANSFORMS, SCENE, LOCATION, CALIBRATION])
def test_a_message_has_the_fields_of_its_schema(channel: str) -> None:
    scene = ViewerScene(VEHICLE)
    at = odometry(origin_deg=(45.0, 7.0, 240.0))
    drawn(scene, 0.95, (topics.CAMERA_INFO, VEHICLE.camera.info(0)), (topics.ROVER_ESTIMATE, rover()))
    made = drawn(scene, 2.0, (topics.CAMERA_INFO, VEHICLE.camera.info(0)), (topics.ODOMETRY, at))
    made |= drawn(scene, 3.1, (topics.ODOMETRY, at))
    assert schema_name(channel).startswith("foxglove.")
    check(made[channel], json.loads(json_schema(channel)))


def check(value: Any, schema: Messages) -> None:
    """Compare a value with a schema, as far as viewers read it."""
    match schema["type"]:
        case "object":
            assert value.keys() == schema["properties"].keys()
            for name, field in schema["properties"].items():
                check(value[name], field)
        case "array":
            for item in value:
                check(item, schema["items"])
        case kind:
            assert isinstance(value, {"number": int | float, "integer": int, "string": str, "boolean": bool}[kind])
