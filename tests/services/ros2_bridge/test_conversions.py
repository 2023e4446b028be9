"""Each conversion, against the same quantity by another way: scipy's rotations, numpy, and back again."""

from math import inf, isnan, pi
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace
from scipy.spatial.transform import Rotation

from jezero.base.frames import quat_normalize
from jezero.base.vehicle_config import VehicleConfig
from jezero.schemas.commands import RoverCommand
from jezero.schemas.estimate import Relative, RoverEstimate
from jezero.schemas.fence import Fence, FenceState, Zone
from jezero.schemas.health import ServiceHealth
from jezero.schemas.sensors import Altimeter, CameraFrame, CameraInfo, CameraPreview, Gnss, Imu, RoverOdometry
from jezero.schemas.state import Battery, Odometry, Status
from jezero.services.ros2_bridge import conversions as make
from jezero.services.ros2_bridge.conversions import Context
from jezero.services.ros2_bridge.geometry import RosMessage
from jezero.services.ros2_bridge.rows import ROWS, sources

ENU_FROM_NED = np.array(((0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0)))
FLU_FROM_FRD = np.diag((1.0, -1.0, -1.0))
T_NS = 12_345_678_901
numbers = st.floats(-50.0, 50.0)
vectors = st.tuples(numbers, numbers, numbers)
angles = st.floats(-pi, pi)
quaternions = (
    st.tuples(*(st.floats(-1.0, 1.0),) * 4).filter(lambda q: sum(each * each for each in q) > 0.1).map(quat_normalize)
)


def context() -> Context:
    return Context("uav1", VehicleConfig())


def odometry_of(pos: Any, vel: Any, q: Any, offset: Any = (0.0, 0.0, 0.0), std_m: float | None = None) -> Odometry:
    return Odometry(
        t_ns=T_NS,
        epoch_id=1,
        pos_uav_ned_m=pos,
        vel_uav_ned_mps=vel,
        q_ned_from_frd=q,
        rates_uav_frd_rps=(0.1, 0.2, 0.3),
        reset_offset_ned_m=offset,
        std_pos_m=std_m,
    )


def at(message: RosMessage, path: str) -> Any:
    """A field of a message, such as "pose.pose.position"."""
    value: Any = message
    for name in path.split("."):
        value = value.fields[name]
    return value


def xyz(message: RosMessage, path: str) -> np.ndarray:
    return np.array([at(message, path).fields[axis] for axis in "xyz"])


def rotation(message: RosMessage, path: str) -> Rotation:
    return Rotation.from_quat([at(message, path).fields[axis] for axis in "xyzw"])


def scipy_of(q: tuple[float, float, float, float]) -> Rotation:
    return Rotation.from_quat((*q[1:], q[0]))


def is_same(a: Rotation, b: Rotation) -> bool:
    return bool((a.inv() * b).magnitude() < 1e-6)


@given(vectors, vectors, quaternions, vectors)
def test_the_odometry_leads_back_to_the_vehicles(pos: Any, vel: Any, q: Any, offset: Any) -> None:
    ros = make.odometry(odometry_of(pos, vel, q, offset), context())
    center = xyz(ros, "pose.pose.position") - (0.0, 0.0, VehicleConfig().airframe.height_stand_m)
    assert ENU_FROM_NED.T @ center + offset == pytest.approx(np.array(pos), abs=1e-6)
    ned_from_frd = scipy_of(q).as_matrix()
    attitude = Rotation.from_matrix(ENU_FROM_NED @ ned_from_frd @ FLU_FROM_FRD.T)
    assert is_same(rotation(ros, "pose.pose.orientation"), attitude)
    assert attitude.apply(xyz(ros, "twist.twist.linear")) == pytest.approx(ENU_FROM_NED @ vel, abs=1e-6)
    assert xyz(ros, "twist.twist.angular") == pytest.approx((0.1, -0.2, -0.3))
    assert (at(ros, "header.stamp.sec"), at(ros, "header.stamp.nanosec")) == (12, 345_678_901)
    assert (at(ros, "header.frame_id"), ros.fields["child_frame_id"]) == ("uav1/odom", "uav1/base_link")


def test_a_vehicle_whose_nose_points_north_has_a_yaw_of_90_degrees_in_ros() -> None:
    ros = make.odometry(odometry_of((1.0, 2.0, -3.0), (1.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), std_m=0.5), context())
    assert rotation(ros, "pose.pose.orientation").as_euler("xyz", degrees=True) == pytest.approx((0.0, 0.0, 90.0))
    assert xyz(ros, "twist.twist.linear") == pytest.approx((1.0, 0.0, 0.0))
    assert at(ros, "pose.covariance")[0:15:7] == [0.25, 0.25, 0.25]


@given(vectors, quaternions, vectors)
def test_a_reset_moves_odom_in_map_and_the_chain_of_frames_gives_the_position(pos: Any, q: Any, offset: Any) -> None:
    ros = make.vehicle_transforms(odometry_of(pos, (0.0, 0.0, 0.0), q, offset), context())
    map_odom, odom_base = ros.fields["transforms"]
    where = xyz(map_odom, "transform.translation") + xyz(odom_base, "transform.translation")
    expected = ENU_FROM_NED @ pos + (0.0, 0.0, VehicleConfig().airframe.height_stand_m)
    assert where == pytest.approx(expected, abs=1e-6)
    assert is_same(rotation(map_odom, "transform.rotation"), Rotation.identity())


def test_an_imu_at_rest_measures_upwards_and_has_no_orientation() -> None:
    ros = make.imu(Imu(t_ns=T_NS, acc_imu_frd_mps2=(0.1, 0.2, -9.81), gyro_imu_frd_rps=(0.1, 0.2, 0.3)), context())
    assert xyz(ros, "linear_acceleration") == pytest.approx((0.1, -0.2, 9.81))
    assert xyz(ros, "angular_velocity") == pytest.approx((0.1, -0.2, -0.3))
    assert ros.fields["orientation_covariance"][0] == -1.0


def test_a_fix_says_that_it_is_one() -> None:
    fix = Gnss(
        t_ns=T_NS,
        position_deg=(47.0, 8.0, 488.0),
        vel_uav_ned_mps=(0.0, 0.0, 0.0),
        std_horizontal_m=0.5,
        std_vertical_m=0.9,
        satellites=12,
    )
    ros = make.fix(fix, context())
    assert (ros.fields["latitude"], ros.fields["longitude"], ros.fields["altitude"]) == (47.0, 8.0, 488.0)
    assert at(ros, "status.status") == 0
    assert ros.fields["position_covariance"][0:9:4] == pytest.approx([0.25, 0.25, 0.81])


def test_the_selection_of_a_goal_is_the_lease_that_gives_it() -> None:
    seen = context()

    def lease(at_s: float, goal_id: str, use_tag: bool = True) -> Any:
        estimate = replace(
            relative_of((0.0, 0.0, -3.0), 0.0), t_ns=T_NS + int(at_s * 1e9), goal_id=goal_id, use_tag=use_tag
        )
        ros = make.lease(estimate, seen)
        fields = ("goal_id", "use_uwb", "use_tag", "release")
        return None if ros is None else tuple(ros.fields[name] for name in fields)

    assert lease(0.0, "") is None
    assert lease(0.1, "a", use_tag=False) == ("a", True, False, False)
    assert lease(0.9, "a", use_tag=False) is None
    assert lease(1.0, "a") == ("a", True, True, False), "it has changed"
    assert lease(1.9, "a") is None
    assert lease(2.0, "a") == ("a", True, True, False), "it is renewed"
    # The estimator gives a lease to the next goal only after the release.
    assert lease(2.1, "b") == ("a", True, True, True)
    assert lease(2.2, "b") == ("b", True, True, False)
    assert lease(2.3, "") == ("b", True, True, True)
    assert lease(2.4, "") is None
    assert lease(-5.0, "c") == ("c", True, True, False), "vehicle time has begun anew"
    assert lease(-9.0, "c") == ("c", True, True, False)


def test_a_lease_has_the_prior_position_once() -> None:
    """The estimator restarts its filter there; a bag that had it in each renewal would be another flight."""
    seen = context()
    seen.prior_of = {"a": (1.0, 2.0, 0.0), "b": None}.get

    def prior(at_s: float, goal_id: str) -> Any:
        at = replace(relative_of((0.0, 0.0, -3.0), 0.0), t_ns=T_NS + int(at_s * 1e9), goal_id=goal_id)
        ros = make.lease(at, seen)
        assert ros is not None
        return ros.fields["pos_rover_ned_m"]

    assert prior(0.0, "a") == [1.0, 2.0, 0.0]
    assert prior(1.0, "a") == [], "a renewal"
    assert prior(1.1, "") == [], "a release"
    assert prior(1.2, "b") == [], "a goal without one"


def test_a_beam_that_meets_nothing_has_an_infinite_range() -> None:
    assert make.altitude_range(Altimeter(t_ns=T_NS), context()).fields["range"] == inf
    assert make.altitude_range(Altimeter(t_ns=T_NS, range_m=2.5), context()).fields["range"] == 2.5


def relative_of(pos: Any, yaw_rad: float, cov: Any = None, valid: bool = True) -> Relative:
    upper = np.triu_indices(6)
    return Relative(
        t_ns=T_NS,
        epoch_id=1,
        valid=valid,
        pos_uav_rel_rover_ned_m=pos,
        vel_uav_rel_rover_ned_mps=(0.0, 0.0, 0.0),
        cov=tuple((np.eye(6) if cov is None else cov)[upper].tolist()),
        vel_rover_ned_mps=(0.0, 0.0, 0.0),
        yaw_rover_rad=yaw_rad,
        yaw_rate_rover_rps=0.0,
        use_uwb=True,
        use_tag=True,
    )


@given(vectors, angles, quaternions, st.integers(0, 2**32 - 1))
def test_the_relative_pose_is_in_the_platforms_axes_with_its_covariance(
    pos: Any, yaw_rad: float, q: Any, seed: int
) -> None:
    root = np.random.default_rng(seed).normal(size=(6, 6))
    cov = root @ root.T
    seen = context()
    seen.notice(odometry_of((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), q))
    ros = make.relative_pose(relative_of(pos, yaw_rad, cov), seen)
    assert ros is not None
    platform_in_enu = Rotation.from_euler("z", pi / 2.0 - yaw_rad)
    in_enu = platform_in_enu.apply(xyz(ros, "pose.pose.position"))
    expected = ENU_FROM_NED @ pos + (0.0, 0.0, VehicleConfig().airframe.height_stand_m)
    assert in_enu == pytest.approx(expected, abs=1e-6)
    attitude = Rotation.from_matrix(ENU_FROM_NED @ scipy_of(q).as_matrix() @ FLU_FROM_FRD.T)
    assert is_same(platform_in_enu * rotation(ros, "pose.pose.orientation"), attitude)
    turned = platform_in_enu.as_matrix().T @ ENU_FROM_NED
    block = np.array(at(ros, "pose.covariance")).reshape(6, 6)[0:3, 0:3]
    assert block == pytest.approx(turned @ cov[0:3, 0:3] @ turned.T, abs=1e-6)


def test_an_estimate_that_is_not_valid_is_not_published() -> None:
    assert make.relative_pose(relative_of((0.0, 0.0, 0.0), 0.0, valid=False), context()) is None
    assert make.uncertainty(relative_of((0.0, 0.0, 0.0), 0.0, valid=False), context()) is None


@given(numbers, numbers, angles, st.floats(-3.0, 3.0), st.floats(-1.0, 1.0))
def test_the_rovers_odometry_turns_anticlockwise_and_drives_along_x(
    north_m: float, east_m: float, yaw_rad: float, speed_mps: float, rate_rps: float
) -> None:
    rover = RoverOdometry(
        t_ns=T_NS,
        pos_odom_m=(north_m, east_m),
        yaw_rover_rad=yaw_rad,
        speed_rover_body_mps=speed_mps,
        yaw_rate_rover_rps=rate_rps,
    )
    ros = make.rover_odometry(rover, context())
    assert xyz(ros, "pose.pose.position") == pytest.approx((east_m, north_m, 0.0))
    ahead = rotation(ros, "pose.pose.orientation").apply((1.0, 0.0, 0.0))
    assert ahead == pytest.approx(ENU_FROM_NED @ (np.cos(yaw_rad), np.sin(yaw_rad), 0.0), abs=1e-6)
    assert xyz(ros, "twist.twist.linear") == pytest.approx((speed_mps, 0.0, 0.0))
    assert xyz(ros, "twist.twist.angular") == pytest.approx((0.0, 0.0, -rate_rps))


@given(vectors, angles)
def test_the_platforms_transform_is_the_rovers_pose(pos: Any, yaw_rad: float) -> None:
    rover = RoverEstimate(
        t_ns=T_NS,
        epoch_id=1,
        valid=True,
        pos_rover_ned_m=pos,
        vel_rover_ned_mps=(0.0, 0.0, 0.0),
        yaw_rover_rad=yaw_rad,
        std_pos_m=0.3,
    )
    ros, moved = make.rover_pose(rover, context()), make.rover_transform(rover, context())
    assert ros is not None and moved is not None
    assert xyz(ros, "pose.pose.position") == pytest.approx(ENU_FROM_NED @ pos)
    (found,) = moved.fields["transforms"]
    assert xyz(found, "transform.translation") == pytest.approx(ENU_FROM_NED @ pos)
    assert is_same(rotation(found, "transform.rotation"), rotation(ros, "pose.pose.orientation"))


INFO = CameraInfo(
    t_ns=T_NS,
    width_px=4,
    height_px=2,
    focal_px=420.0,
    center_px=(1.5, 0.5),
    pos_camera_frd_m=(0.1, 0.0, 0.05),
    rate_hz=10.0,
)


def test_an_image_has_its_rows_and_the_intrinsics_have_its_time() -> None:
    seen = context()
    frame = CameraFrame(
        t_ns=T_NS,
        sequence=1,
        width_px=4,
        height_px=2,
        pitch_camera_rad=-pi / 2,
        exposure_s=0.01,
        pixels=bytes(range(24)),
    )
    assert make.camera_info(frame, seen) is None
    seen.notice(INFO)
    ros, info = make.image(frame, seen), make.camera_info(frame, seen)
    assert info is not None
    assert (ros.fields["step"], ros.fields["encoding"], bytes(ros.fields["data"])) == (12, "rgb8", bytes(range(24)))
    assert info.fields["header"] == ros.fields["header"]
    assert info.fields["k"] == [420.0, 0.0, 1.5, 0.0, 420.0, 0.5, 0.0, 0.0, 1.0]
    assert (info.fields["distortion_model"], len(info.fields["d"])) == ("plumb_bob", 5)


def test_a_camera_that_looks_down_has_its_axis_down_and_the_top_of_its_picture_ahead() -> None:
    seen = context()
    seen.notice(INFO)
    preview = CameraPreview(
        t_ns=T_NS, width_px=4, height_px=2, scale=1.0, pitch_camera_rad=-pi / 2, jpeg=b"\xff\xd8\xff"
    )
    ros = make.camera_transform(preview, seen)
    assert ros is not None
    (found,) = ros.fields["transforms"]
    optical = rotation(found, "transform.rotation")
    assert optical.apply((0.0, 0.0, 1.0)) == pytest.approx((0.0, 0.0, -1.0), abs=1e-9)
    assert optical.apply((0.0, -1.0, 0.0)) == pytest.approx((1.0, 0.0, 0.0), abs=1e-9)
    assert xyz(found, "transform.translation") == pytest.approx((0.1, 0.0, -0.05))


def status_of(**fields: Any) -> Status:
    values = {"code": 3, "name": "HOVER", "armed": True, "landed": False, "in_charge": "hover", "ready": True}
    return Status(t_ns=T_NS, bridge_boot_id=1, **{**values, **fields})


def test_the_battery_is_a_fraction_and_nan_where_it_is_unknown() -> None:
    assert make.battery(status_of(), context()) is None
    known = make.battery(status_of(battery=Battery(voltage_v=15.2, remaining=0.8)), context())
    unknown = make.battery(status_of(battery=Battery(voltage_v=15.2)), context())
    assert known is not None and unknown is not None
    assert (known.fields["voltage"], known.fields["percentage"]) == (15.2, 0.8)
    assert isnan(unknown.fields["percentage"])


def test_the_wind_is_in_the_map() -> None:
    assert make.wind(status_of(), context()) is None
    ros = make.wind(status_of(wind_ned_mps=(1.0, 2.0, 0.0)), context())
    assert ros is not None
    assert xyz(ros, "vector") == pytest.approx((2.0, 1.0, 0.0))


@pytest.mark.parametrize(("state", "level"), [("ok", b"\x00"), ("degraded", b"\x01"), ("starting", b"\x03")])
def test_health_has_the_level_of_its_state(state: Any, level: bytes) -> None:
    health = ServiceHealth(t_ns=T_NS, service="estimator", boot_id=1, state=state, text="the rover is found")
    (one,) = make.service_diagnostics(health, context()).fields["status"]
    assert (one.fields["level"], one.fields["name"], one.fields["message"]) == (
        level,
        "uav1: estimator",
        "the rover is found",
    )


def test_a_fence_is_drawn_at_the_ground_and_at_its_ceiling_and_deleted_when_it_is_gone() -> None:
    zone = Zone(name="field", corners_ned_m=((0.0, 0.0), (10.0, 0.0), (10.0, 5.0)))
    state = FenceState(t_ns=T_NS, fence=Fence(keep_in=zone, ceiling_m=20.0))
    deleted, ground, ceiling = make.fence_markers(state, context()).fields["markers"]
    assert deleted.fields["action"] == 3
    assert [(p.fields["x"], p.fields["y"]) for p in ground.fields["points"]] == [
        (0.0, 0.0),
        (0.0, 10.0),
        (5.0, 10.0),
        (0.0, 0.0),
    ]
    assert {p.fields["z"] for p in ceiling.fields["points"]} == {20.0}
    assert len(make.fence_markers(FenceState(t_ns=T_NS), context()).fields["markers"]) == 1


def test_the_flown_path_grows_only_when_the_vehicle_has_moved() -> None:
    seen = context()
    still = odometry_of((0.0, 0.0, -2.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    assert make.flown_path(still, seen) is not None
    assert make.flown_path(still, seen) is None
    moved = make.flown_path(odometry_of((1.0, 0.0, -2.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)), seen)
    assert moved is not None
    assert len(moved.fields["poses"]) == 2


def test_the_altimeters_frame_points_its_x_down_and_anchors_are_on_the_platform() -> None:
    found = {t.fields["child_frame_id"]: t for t in make.static_transforms(context(), 0).fields["transforms"]}
    beam = rotation(found["uav1/altimeter"], "transform.rotation").apply((1.0, 0.0, 0.0))
    assert beam == pytest.approx((0.0, 0.0, -1.0), abs=1e-9)
    assert at(found["uav1/anchor_1"], "header.frame_id") == "uav1/platform"
    assert xyz(found["uav1/anchor_1"], "transform.translation") == pytest.approx((0.45, 0.45, 0.0))


def test_each_source_is_followed_once_and_has_a_row() -> None:
    names = [source.name for source in sources()]
    assert len(names) == len(set(names))
    assert {row.source.name for row in ROWS} <= set(names)


def test_a_drive_command_turns_anticlockwise_in_ros() -> None:
    made = make.rover_command(RoverCommand(t_ns=T_NS, speed_rover_body_mps=0.5, yaw_rate_rover_rps=0.2), context())
    assert at(made, "linear.x") == 0.5
    assert at(made, "angular.z") == -0.2
