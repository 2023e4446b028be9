"""Messages of ROS as inputs of the estimator: each leads back from what the bridge has published."""

from math import cos, inf, nan, pi, sin
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from jezero.base.frames import quat_from_euler
from jezero.base.vehicle_config import VehicleConfig
from jezero.schemas.sensors import Altimeter, RoverOdometry
from jezero.schemas.state import Odometry
from jezero.services.ros2_bridge import conversions as make
from jezero.services.ros2_bridge import inputs
from jezero.services.ros2_bridge.bag import MessageBuilder
from jezero.services.ros2_bridge.conversions import Context
from jezero.services.ros2_bridge.geometry import RosMessage, header
from jezero.services.ros2_bridge.inputs import INPUTS, NEEDED

CONFIG = VehicleConfig()
BUILDER = MessageBuilder(9)
numbers = st.floats(-100.0, 100.0)
vectors = st.tuples(numbers, numbers, numbers)
tilts = st.floats(-1.5, 1.5)
headings = st.floats(-3.14, 3.14)
times = st.integers(0, 10**18)


def in_ros(message: RosMessage | None) -> Any:
    """A message as a bag gives it."""
    assert message is not None
    return BUILDER.typestore.deserialize_cdr(BUILDER.serialized(message), message.type)


def a_range(range_m: float, frame: str = "anchor_1", least_m: float = 0.0, most_m: float = 100.0) -> Any:
    fields = {"header": header(7, frame), "range": range_m, "min_range": least_m, "max_range": most_m}
    return in_ros(RosMessage("sensor_msgs/msg/Range", fields))


@given(times, vectors, vectors, vectors, tilts, tilts, headings, st.none() | st.floats(0.01, 100.0))
def test_odometry_comes_back_from_nav_msgs(
    t_ns: int, pos: Any, vel: Any, rates: Any, roll: float, pitch: float, yaw: float, std_m: float | None
) -> None:
    flown = Odometry(
        t_ns=t_ns,
        epoch_id=inputs.EPOCH_ID,
        pos_uav_ned_m=pos,
        vel_uav_ned_mps=vel,
        q_ned_from_frd=quat_from_euler(roll, pitch, yaw),
        rates_uav_frd_rps=rates,
        std_pos_m=std_m,
    )
    back = inputs.odometry(in_ros(make.odometry(flown, Context("uav1", CONFIG))), CONFIG)
    assert back.t_ns == t_ns
    assert back.pos_uav_ned_m == pytest.approx(pos, abs=1e-12)
    assert back.vel_uav_ned_mps == pytest.approx(vel, abs=1e-12)
    assert back.rates_uav_frd_rps == pytest.approx(rates, abs=1e-12)
    assert abs(sum(a * b for a, b in zip(back.q_ned_from_frd, flown.q_ned_from_frd, strict=True))) == pytest.approx(1.0)
    assert back.std_pos_m == (None if std_m is None else pytest.approx(std_m))


@given(times, numbers, numbers, headings, numbers, numbers, tilts, tilts)
def test_the_rovers_odometry_comes_back_from_nav_msgs_with_its_tilt(
    t_ns: int, north: float, east: float, yaw: float, speed: float, rate: float, roll: float, pitch: float
) -> None:
    driven = RoverOdometry(
        t_ns=t_ns,
        pos_odom_m=(north, east),
        yaw_rover_rad=yaw,
        speed_rover_body_mps=speed,
        yaw_rate_rover_rps=rate,
        roll_rover_rad=roll,
        pitch_rover_rad=pitch,
    )
    back = inputs.rover_odometry(in_ros(make.rover_odometry(driven, Context("uav1", CONFIG))), CONFIG)
    assert (back.t_ns, back.pos_odom_m, back.speed_rover_body_mps, back.yaw_rate_rover_rps) == (
        t_ns,
        (north, east),
        speed,
        rate,
    )
    angles = (back.yaw_rover_rad, back.roll_rover_rad, back.pitch_rover_rad)
    assert angles == pytest.approx((yaw, roll, pitch), abs=1e-9)


@given(times, st.none() | st.floats(CONFIG.altimeter.range_min_m, CONFIG.altimeter.range_max_m))
def test_the_altimeter_comes_back_in_32_bits(t_ns: int, range_m: float | None) -> None:
    ros = in_ros(make.altitude_range(Altimeter(t_ns=t_ns, range_m=range_m), Context("uav1", CONFIG)))
    back = inputs.altimeter(ros, CONFIG)
    assert back.t_ns == t_ns
    at_the_limit = range_m in (CONFIG.altimeter.range_min_m, CONFIG.altimeter.range_max_m)
    assert back.range_m == (None if range_m is None else pytest.approx(range_m, rel=1e-7)) or at_the_limit


@pytest.mark.parametrize("range_m", [inf, -inf, nan, 0.0, -1.0, 150.0])
def test_a_range_beyond_the_sensors_limits_met_nothing(range_m: float) -> None:
    assert inputs.altimeter(a_range(range_m), CONFIG).range_m is None


def test_a_range_of_uwb_has_the_anchor_of_its_frame_and_the_place_of_vehicle_toml() -> None:
    (reading,) = inputs.single_range(a_range(2.5, "uav1/anchor_3"), CONFIG).ranges
    assert (reading.t_ns, reading.anchor, reading.range_m) == (7, 3, 2.5)
    assert reading.pos_anchor_rover_body_m == CONFIG.uwb.pos_anchors_rover_body_m[3]
    assert inputs.single_range(a_range(inf), CONFIG).ranges == ()


@pytest.mark.parametrize("frame", ["uwb", "", "anchor_4", "anchor_99999999999999999999"])
def test_a_range_of_an_anchor_that_there_is_not_is_refused(frame: str) -> None:
    with pytest.raises(ValueError, match=r"vehicle\.toml has the anchors 0 to 3"):
        inputs.single_range(a_range(2.5, frame), CONFIG)


@pytest.mark.parametrize("q", [(0.0, 0.0, 0.0, 0.0), (nan, 0.0, 0.0, 0.0), (3.0, 0.0, 0.0, 0.0)])
def test_an_orientation_that_is_none_is_refused(q: tuple[float, float, float, float]) -> None:
    ros = in_ros(RosMessage("nav_msgs/msg/Odometry", {"header": header(1, "odom")}))
    ros.pose.pose.orientation = SimpleNamespace(**dict(zip("wxyz", q, strict=True)))
    with pytest.raises(ValueError, match="no unit quaternion"):
        inputs.odometry(ros, CONFIG)


def test_a_vehicle_that_looks_and_flies_east_at_5_m() -> None:
    """REP 103: yaw 0 is east, so that the body's x axis is east."""
    fields = {"header": header(1, "odom")}
    ros = in_ros(RosMessage("nav_msgs/msg/Odometry", fields))
    ros.pose.pose.orientation.w = 1.0
    ros.pose.pose.position = SimpleNamespace(x=1.0, y=2.0, z=5.0)
    ros.twist.twist.linear.x = 3.0
    made = inputs.odometry(ros, CONFIG)
    assert made.vel_uav_ned_mps == pytest.approx((0.0, 3.0, 0.0), abs=1e-12)
    assert made.pos_uav_ned_m == pytest.approx((2.0, 1.0, -(5.0 - CONFIG.airframe.height_stand_m)))
    assert made.q_ned_from_frd == pytest.approx((cos(pi / 4), 0.0, 0.0, sin(pi / 4)))
    assert inputs.rover_odometry(ros, CONFIG).yaw_rover_rad == pytest.approx(pi / 2)


def test_what_is_needed_can_be_made_and_whole_messages_come_first() -> None:
    for _, sources in NEEDED:
        assert all(any(each.source is source for each in INPUTS) for source in sources)
    whole = [each.type.startswith("jezero_interfaces/") for each in INPUTS]
    assert whole == sorted(whole, reverse=True)
