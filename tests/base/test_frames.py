"""Every rotation, by hand and there and back."""

from itertools import product
from math import acos, pi, radians, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyproj import Proj
from scipy.spatial.transform import Rotation, Slerp

from jezero.base import frames
from jezero.base.frames import Quat, Vec3

angles = st.floats(-3.1, 3.1)
numbers = st.floats(-1e3, 1e3)
vectors = st.tuples(numbers, numbers, numbers)
NORTH: Vec3 = (1.0, 0.0, 0.0)


def near(value: Vec3 | float) -> object:
    return pytest.approx(value, abs=1e-6)


@pytest.mark.parametrize(("enu", "ned"), [((1.0, 2.0, 3.0), (2.0, 1.0, -3.0)), ((0.0, 1.0, 0.0), NORTH)])
def test_east_north_up_becomes_north_east_down_and_back(enu: Vec3, ned: Vec3) -> None:
    assert frames.ned_from_enu(enu) == ned
    assert frames.enu_from_ned(ned) == enu


def test_a_scalar_product_has_all_three_axes() -> None:
    assert frames.dot((1.0, 2.0, 3.0), (4.0, -5.0, 6.0)) == 12.0


def test_up_is_negative_down() -> None:
    assert frames.altitude_m(-4.0) == 4.0
    assert frames.z_ned_m(4.0) == -4.0


@pytest.mark.parametrize(
    ("q_enu_from_flu", "forward_ned"),
    [
        ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0)),  # the engine's zero heading is east
        ((sqrt(0.5), 0.0, 0.0, sqrt(0.5)), NORTH),  # a quarter turn to the left of it is north
    ],
)
def test_a_level_vehicle_of_the_engine_is_level_and_points_there(q_enu_from_flu: Quat, forward_ned: Vec3) -> None:
    q = frames.q_ned_from_frd(q_enu_from_flu)
    assert frames.quat_rotate(q, NORTH) == near(forward_ned)
    assert frames.quat_rotate(q, (0.0, 0.0, 1.0)) == near((0.0, 0.0, 1.0))
    assert frames.tilt_from_quat(q) == pytest.approx(0.0, abs=1e-6)


def test_yaw_turns_north_to_east_and_pitch_lifts_the_nose() -> None:
    assert frames.quat_rotate(frames.quat_from_euler(0.0, 0.0, pi / 2), NORTH) == near((0.0, 1.0, 0.0))
    assert frames.quat_rotate(frames.quat_from_euler(0.0, pi / 6, 0.0), NORTH) == near((sqrt(0.75), 0.0, -0.5))
    assert frames.rotate_yaw(NORTH, pi / 2) == near((0.0, 1.0, 0.0))


@given(angles, st.floats(-1.5, 1.5), angles)
def test_angles_survive_the_quaternion(roll: float, pitch: float, yaw: float) -> None:
    q = frames.quat_from_euler(roll, pitch, yaw)
    assert q[0] >= 0.0
    assert frames.euler_from_quat(q) == pytest.approx((roll, pitch, yaw), abs=1e-4)
    assert frames.yaw_from_quat(q) == pytest.approx(yaw, abs=1e-4)


@given(vectors, vectors)
def test_a_turn_is_undone_by_its_conjugate_and_keeps_lengths(turn: Vec3, vector: Vec3) -> None:
    q = frames.quat_from_rotation_vector(turn)
    there = frames.quat_rotate(q, vector)
    assert frames.norm(there) == pytest.approx(frames.norm(vector), abs=1e-6)
    assert frames.quat_rotate(frames.quat_conjugate(q), there) == pytest.approx(vector, abs=1e-6)


@given(st.tuples(angles, angles, angles), vectors)
def test_the_matrix_of_a_quaternion_turns_a_vector_as_the_quaternion_does(turn: Vec3, vector: Vec3) -> None:
    q = frames.quat_from_rotation_vector(turn)
    matrix = frames.rotation_matrix(q)
    turned = tuple(sum(matrix[3 * row + i] * vector[i] for i in range(3)) for row in range(3))
    assert turned == near(frames.quat_rotate(q, vector))


@given(vectors)
def test_a_local_position_survives_latitude_and_longitude(pos_ned_m: Vec3) -> None:
    origin_deg = (47.4, 8.5, 488.0)
    there = frames.geodetic_from_ned(pos_ned_m, origin_deg)
    assert frames.ned_from_geodetic(there, origin_deg) == pytest.approx(pos_ned_m, abs=1e-5)


@pytest.mark.parametrize("origin_deg", [(47.4, 8.5, 0.0), (-33.9, 179.999, 0.0), (0.0, -180.0, 0.0)])
@pytest.mark.parametrize(("north_m", "east_m"), [(3.0, -4.0), (-800.0, 1500.0), (20_000.0, 30_000.0)])
def test_latitude_and_longitude_are_those_of_the_azimuthal_equidistant_projection(
    origin_deg: Vec3, north_m: float, east_m: float
) -> None:
    proj = Proj(proj="aeqd", lat_0=origin_deg[0], lon_0=origin_deg[1], R=frames.EARTH_RADIUS_M)
    longitude_deg, latitude_deg = proj(east_m, north_m, inverse=True)
    there = (latitude_deg, longitude_deg, 0.0)
    assert frames.geodetic_from_ned((north_m, east_m, 0.0), origin_deg) == pytest.approx(there, abs=1e-9)
    assert frames.ned_from_geodetic(there, origin_deg) == pytest.approx((north_m, east_m, 0.0), abs=1e-4)


@pytest.mark.parametrize("pole_deg", [90.0, -90.0])
def test_a_pole_is_a_place_like_others_whatever_the_rounding(pole_deg: float) -> None:
    for number in range(1, 200):
        latitude_deg = pole_deg * (1.0 - 1e-4 * number)
        north_m = radians(pole_deg - latitude_deg) * frames.EARTH_RADIUS_M
        there = frames.geodetic_from_ned((north_m, 0.0, -5.0), (latitude_deg, 8.5, 488.0))
        assert (there[0], there[2]) == pytest.approx((pole_deg, 493.0), abs=1e-5)


@given(st.floats(-1e3, 1e3))
def test_a_wrapped_angle_is_within_half_a_turn(angle: float) -> None:
    assert -pi <= frames.wrap_pi(angle) < pi + 1e-9


@pytest.mark.parametrize("q", [(0.0, 0.0, 0.0, 0.0), (float("nan"), 0.0, 0.0, 0.0), (float("inf"), 0.0, 0.0, 0.0)])
def test_what_is_no_rotation_is_refused(q: Quat) -> None:
    with pytest.raises(ValueError, match="not a rotation"):
        frames.quat_normalize(q)


def test_a_camera_that_looks_down_has_the_nose_at_the_top_and_the_right_side_right() -> None:
    down = -pi / 2
    assert frames.frd_from_camera((0.0, 0.0, 1.0), down) == pytest.approx((0.0, 0.0, 1.0))
    assert frames.frd_from_camera((0.0, -1.0, 0.0), down) == pytest.approx((1.0, 0.0, 0.0))
    assert frames.frd_from_camera((1.0, 0.0, 0.0), down) == pytest.approx((0.0, 1.0, 0.0))
    assert frames.frd_from_camera((0.0, 0.0, 1.0), 0.0) == pytest.approx((1.0, 0.0, 0.0))


@given(vectors, st.floats(-pi, pi), st.floats(-pi, pi))
def test_the_cameras_quaternion_is_the_rotation_of_its_vectors(vector: Vec3, pitch_rad: float, roll_rad: float) -> None:
    by_quaternion = frames.quat_rotate(frames.q_frd_from_camera(pitch_rad, roll_rad), vector)
    assert by_quaternion == pytest.approx(frames.frd_from_camera(vector, pitch_rad, roll_rad), abs=1e-9)


rotations = st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1).map(frames.quat_normalize)
ENU, FLU = np.array(((0, 1, 0), (1, 0, 0), (0, 0, -1))), np.diag((1, -1, -1))


def scipys(q: Quat) -> Rotation:
    return Rotation.from_quat(q, scalar_first=True)


def same(q: Quat, expected: Rotation) -> bool:
    return bool((scipys(q) * expected.inv()).magnitude() < 1e-6) and q[0] >= 0.0


@given(rotations, rotations, vectors, st.floats(0.0, 1.0))
def test_rotations_are_those_of_scipy(a: Quat, b: Quat, vector: Vec3, fraction: float) -> None:
    one, other = scipys(a), scipys(b)
    product = frames.quat_normalize(frames.quat_multiply(a, b))
    assert same(product, one * other)
    assert frames.quat_rotate(a, vector) == near(tuple(one.apply(vector)))
    assert frames.rotation_matrix(a) == pytest.approx(one.as_matrix().ravel(), abs=1e-9)
    assert same(frames.quat_from_rotation_vector(tuple(one.as_rotvec())), one)
    down = one.apply((0.0, 0.0, 1.0))[2]
    assert frames.tilt_from_quat(a) == pytest.approx(acos(min(max(down, -1.0), 1.0)), abs=1e-6)
    assert same(frames.q_ned_from_frd(a), Rotation.from_matrix(ENU @ one.as_matrix() @ FLU))
    near_by = one * Rotation.from_rotvec(0.1 * other.as_rotvec() / pi)
    expected = Slerp((0.0, 1.0), Rotation.concatenate((one, near_by)))(fraction)
    between = frames.quat_between(a, tuple(near_by.as_quat(scalar_first=True)), fraction)
    assert (scipys(between) * expected.inv()).magnitude() < 1e-3


@given(angles, st.floats(-1.5, 1.5), angles, vectors)
def test_angles_are_those_of_scipy(roll: float, pitch: float, yaw: float, vector: Vec3) -> None:
    expected = Rotation.from_euler("ZYX", (yaw, pitch, roll))
    assert same(frames.quat_from_euler(roll, pitch, yaw), expected)
    assert frames.rotate_yaw(vector, yaw) == near(tuple(Rotation.from_euler("z", yaw).apply(vector)))
    camera = Rotation.from_euler("XY", (roll, pitch)) * Rotation.from_matrix(((0, 0, 1), (1, 0, 0), (0, 1, 0)))
    camera *= Rotation.from_euler("z", yaw)
    assert same(frames.q_frd_from_camera(pitch, roll, yaw), camera)
    assert frames.frd_from_camera(vector, pitch, roll, yaw) == near(tuple(camera.apply(vector)))


@given(vectors, vectors, st.floats(-1e3, 1e3))
def test_vectors_are_those_of_numpy(a: Vec3, b: Vec3, factor: float) -> None:
    one, other = np.array(a), np.array(b)
    assert frames.add(a, b) == near(tuple(one + other)) and frames.subtract(a, b) == near(tuple(one - other))
    assert frames.scale(a, factor) == near(tuple(factor * one)) and frames.dot(a, b) == near(float(one @ other))
    assert frames.cross(a, b) == near(tuple(np.cross(one, other)))
    assert frames.norm(a) == near(float(np.linalg.norm(one)))
    assert frames.distance(a, b) == near(float(np.linalg.norm(one - other)))
    assert frames.horizontal(a) == near(float(np.linalg.norm(one[:2])))
    assert (frames.wrap_pi(factor) - factor) / (2 * pi) == pytest.approx(round((-factor) / (2 * pi)), abs=1e-6)


@given(st.tuples(*[st.floats(-300.0, 300.0)] * 3), st.floats(-60.0, 60.0))
def test_the_origin_of_a_frame_is_where_one_place_has_both_positions(pos_ned_m: Vec3, latitude_deg: float) -> None:
    there = frames.geodetic_from_ned(pos_ned_m, (latitude_deg, 8.5, 488.0))
    assert frames.ned_from_geodetic(there, frames.origin_from(pos_ned_m, there)) == pytest.approx(pos_ned_m, abs=0.05)


@pytest.mark.parametrize("yaw", [-3.0, -1.2, 0.0, 0.4, 2.5])
@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 0.0), (0.3, 0.0), (0.0, -0.5), (-0.7, 1.2), (3.0, 0.2)])
def test_the_level_attitude_has_roll_and_pitch_and_no_heading(roll: float, pitch: float, yaw: float) -> None:
    level = frames.q_level_from_frd(frames.quat_from_euler(roll, pitch, yaw))
    assert frames.euler_from_quat(level) == pytest.approx((roll, pitch, 0.0), abs=1e-4)


@pytest.mark.parametrize("up", [-1.0, 1.0])
def test_a_nose_that_points_straight_up_or_down_has_a_pitch_of_a_quarter_turn_whatever_the_rounding(up: float) -> None:
    for roll, yaw in product(range(-3, 4), range(-3, 4)):
        q = frames.quat_from_euler(roll, up * pi / 2, yaw)
        assert frames.euler_from_quat(q)[1] == pytest.approx(up * pi / 2, abs=1e-6)
        assert frames.tilt_from_quat(q) == pytest.approx(pi / 2, abs=1e-6)


def test_a_vehicle_upside_down_is_tilted_by_half_a_turn_whatever_the_rounding() -> None:
    for yaw in range(-30, 31):
        assert frames.tilt_from_quat(frames.quat_from_euler(pi, 0.0, 0.1 * yaw)) == pytest.approx(pi, abs=1e-6)


@pytest.mark.parametrize("angle_rad", [1e-12, 4e-10, 3e-9, 1e-6])
def test_a_tiny_turn_has_half_its_angle_in_each_axis_of_the_quaternion(angle_rad: float) -> None:
    q = frames.quat_from_rotation_vector((1.0 * angle_rad, -0.5 * angle_rad, 0.8 * angle_rad))
    assert q[0] == pytest.approx(1.0)
    assert [axis / angle_rad for axis in q[1:]] == pytest.approx([0.5, -0.25, 0.4])


@given(st.floats(0.1, 3.0), st.floats(-1.4, 1.4), angles)
def test_the_angles_of_a_gimbal_are_those_of_its_camera_however_it_turns_about_the_optical_axis(
    below_rad: float, roll_rad: float, turn_rad: float
) -> None:
    pitch_rad = -below_rad
    gimbal = frames.q_frd_from_gimbal(pitch_rad, roll_rad)
    axis = frames.quat_rotate(gimbal, (1.0, 0.0, 0.0))
    assert axis == pytest.approx(frames.frd_from_camera((0.0, 0.0, 1.0), pitch_rad, roll_rad))
    turned = frames.quat_multiply(gimbal, frames.quat_from_euler(turn_rad, 0.0, 0.0))
    assert frames.gimbal_angles(turned) == pytest.approx((pitch_rad, roll_rad))
