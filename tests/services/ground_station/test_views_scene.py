"""What the views draw: poses, ellipsoids and the ground as plain numbers, and nothing that is not finite."""

from math import inf, nan, pi, sqrt
from typing import Any

import msgspec
import numpy as np
import pytest

from jezero.base.frames import q_frd_from_camera, quat_from_euler, quat_rotate
from jezero.schemas.commands import CameraPitch
from jezero.schemas.estimate import Covariance6
from jezero.schemas.sensors import Altimeter
from jezero.schemas.terrain import Ground, Obstacle, Rock
from jezero.services.ground_station.views import (
    altimeter_range,
    camera_attitude,
    ellipsoid,
    ground_shape,
    relative_ellipsoid,
    rover_pose,
    vehicle_pose,
)
from jezero.services.ground_station.words import wind_words
from tests.services.ground_station.messages import Flight, covariance, relative, rover

replace = msgspec.structs.replace


def test_the_pose_of_the_vehicle_has_its_attitude_in_degrees() -> None:
    status = Flight().status()
    assert status.odometry is not None
    turned = replace(status, odometry=replace(status.odometry, q_ned_from_frd=quat_from_euler(0.1, -0.2, 0.5 * pi)))
    pose = vehicle_pose(turned, 0.2)
    assert pose is not None
    assert (pose["roll"], pose["pitch"], pose["yaw"]) == (5.7, -11.5, 90.0)
    assert not pose["late"]


@pytest.mark.parametrize("field", ["pos_uav_ned_m", "vel_uav_ned_mps", "q_ned_from_frd"])
@pytest.mark.parametrize("bad", [nan, inf])
def test_a_vehicle_with_a_value_that_is_not_finite_is_not_drawn(field: str, bad: float) -> None:
    status = Flight().status()
    whole = getattr(status.odometry, field)
    assert status.odometry is not None
    broken = replace(status, odometry=replace(status.odometry, **{field: (bad, *whole[1:])}))
    assert vehicle_pose(broken, 0.1) is None


def test_a_vehicle_that_is_late_is_drawn_as_late_and_one_that_is_lost_is_not_drawn() -> None:
    pose = vehicle_pose(Flight().status(), 1.1)
    assert pose is not None
    assert pose["late"]
    assert vehicle_pose(Flight().status(), 10.0) is None
    assert vehicle_pose(None, None) is None
    assert vehicle_pose(Flight().status(odometry=None), 0.1) is None


def test_only_a_fresh_range_of_the_altimeter_places_the_ground() -> None:
    assert altimeter_range(Altimeter(t_ns=0, range_m=1.2346), 0.1) == 1.235
    assert altimeter_range(Altimeter(t_ns=0, range_m=1.2), 1.5) is None
    assert altimeter_range(Altimeter(t_ns=0), 0.1) is None
    assert altimeter_range(Altimeter(t_ns=0, range_m=nan), 0.1) is None
    assert altimeter_range(None, None) is None


def test_a_rover_without_a_valid_estimate_is_not_drawn() -> None:
    assert rover_pose(rover(valid=False), 0.1) is None
    assert rover_pose(rover(pos_rover_ned_m=(nan, 0.0, 0.0)), 0.1) is None
    assert rover_pose(rover(), None) is None
    pose = rover_pose(rover(yaw_rover_rad=0.5), 0.1)
    assert pose == {"pos": [5.0, -3.0, -0.5], "yaw": 0.5, "late": False}


def test_the_ellipsoid_has_three_standard_deviations_along_the_axes_of_the_whole_covariance() -> None:
    # North and east correlate fully: standard deviation sqrt(2) m to the north-east, none to the north-west.
    axes = ellipsoid(covariance([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 0.25]]))
    assert axes is not None
    lengths = sorted(float(np.linalg.norm(axis)) for axis in axes)
    assert lengths == pytest.approx([0.0, 1.5, 3.0 * sqrt(2.0)], abs=1e-3)
    longest = max(axes, key=lambda axis: float(np.linalg.norm(axis)))
    assert np.abs(longest) == pytest.approx([3.0, 3.0, 0.0], abs=1e-3)


@pytest.mark.parametrize("cov", [covariance([[-1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]]), (nan,) * 21])
def test_a_covariance_that_is_none_has_no_ellipsoid(cov: Covariance6) -> None:
    assert ellipsoid(cov) is None


def test_an_estimate_that_is_invalid_or_late_has_no_ellipsoid() -> None:
    assert relative_ellipsoid(relative(), 0.5) is not None
    assert relative_ellipsoid(relative(valid=False, reason="no rover"), 0.5) is None
    assert relative_ellipsoid(relative(), 1.5) is None
    assert relative_ellipsoid(None, None) is None


def test_the_camera_looks_where_the_goal_points_it_and_at_rest_without_a_command() -> None:
    attitude: Any = camera_attitude(CameraPitch(t_ns=0, pitch_camera_rad=-0.5 * pi), 0.1)
    assert quat_rotate(attitude, (0.0, 0.0, 1.0)) == pytest.approx((0.0, 0.0, 1.0), abs=1e-3)
    assert attitude == pytest.approx(q_frd_from_camera(-0.5 * pi), abs=1e-3)
    assert camera_attitude(None, None) is None
    assert camera_attitude(CameraPitch(t_ns=0, pitch_camera_rad=-0.3), 1.5) is None


def test_without_a_simulator_there_is_no_ground() -> None:
    assert ground_shape(None) is None
    assert ground_shape(Ground(reason="not understood")) is None


def test_the_ground_is_one_list_of_heights_from_south_to_north() -> None:
    ground = Ground(
        spacing_m=2.0,
        corner_ned_m=(-1.0, -2.0, 0.1),
        heights_mm=((1, 2, 3), (4, 5, 6)),
        rocks=(Rock(pos_rock_ned_m=(1.0, 2.0, 0.0), radius_m=0.3),),
        obstacles=(
            Obstacle(
                name="ramp",
                colour=(1.0, 0.5, 0.0),
                pos_corners_ned_m=((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 2.0, -1.0)),
                triangles=((0, 2, 1),),
            ),
        ),
    )
    shape = ground_shape(ground)
    assert shape is not None
    assert (shape["columns"], shape["heights_mm"]) == (3, [1, 2, 3, 4, 5, 6])
    assert shape["rocks"] == [[1.0, 2.0, 0.0, 0.3]]
    (ramp,) = shape["obstacles"]
    assert ramp == {"colour": [1.0, 0.5, 0.0], "corners": [0, 0, 0, 1, 0, 0, 1, 2, -1], "triangles": [0, 2, 1]}


def test_the_wind_is_named_by_where_it_comes_from() -> None:
    assert wind_words((0.0, 2.0, 0.0), None) == "2.0 m/s from W"
    assert wind_words((-1.0, 0.0, 0.0), 0.5) == "1.0 m/s from N, gusts ±1.0 m/s"
    assert wind_words(None, None) == "unknown"
    assert wind_words((nan, 0.0, 0.0), 0.5) == "unknown"
    assert wind_words((1.0, 0.0, 0.0), nan) == "1.0 m/s from S"
