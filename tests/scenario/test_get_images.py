"""An orbit in wind, in virtual time, with the simulator's own camera: flown, aimed and recorded as required."""

import pytest

from benchmarks.quality.orbit import Orbiting, measure, orbit_goal
from jezero.schemas import topics
from jezero.schemas.images import GetImage


@pytest.mark.long
def test_an_orbit_in_wind_is_flown_aimed_and_recorded_as_required() -> None:
    flight, goal = Orbiting(seed=2), orbit_goal("world")
    result = flight.fly(goal)
    assert result.outcome == "succeeded", result.reason
    assert result.result is not None
    images = result.result.images
    assert [image.index for image in images] == list(range(8))
    figures = measure(flight, goal, images)
    assert figures.radius_m < 0.05
    assert figures.facing_deg < 2.0
    assert figures.aim_px < 15.0
    assert figures.recorded_m < 0.01
    assert all(image.imu and image.gnss and image.range_m and image.position_camera_deg for image in images)
    request = flight.bus.send_request(topics.GET_IMAGES.image, GetImage(goal_id=result.goal_id, index=5))
    flight.bus.run_for(0.1)
    assert len(request.replies[0].pixels) == 3 * 640 * 480


@pytest.mark.long
def test_around_a_driving_rover_the_circle_drives_along() -> None:
    flight, goal = Orbiting(seed=0, rover_mps=0.5), orbit_goal("rover", num_images=4)
    result = flight.fly(goal)
    assert result.outcome == "succeeded", result.reason
    assert result.result is not None
    figures = measure(flight, goal, result.result.images)
    assert figures.radius_m < 0.05
    assert figures.true_radius_m < 0.15
    assert figures.true_aim_px < 30.0
