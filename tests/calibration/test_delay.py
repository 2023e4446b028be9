"""The delay of a camera, from synthetic rotations and synthetic pictures."""

import cv2
import numpy as np
import pytest

from jezero.base.arrays import Array
from jezero.base.vehicle_config import CameraMountConfig
from jezero.calibration.delay import Delay, DelayError, TurnStep, TurnTracker, measure_delay

DURATION_S = 25.0


def rates_rps(t_s: Array) -> Array:
    """A vehicle that is turned to and fro by hand, about all axes."""
    return np.column_stack(
        (
            1.1 * np.sin(2 * np.pi * 0.7 * t_s) + 0.4 * np.sin(2 * np.pi * 1.9 * t_s),
            0.9 * np.sin(2 * np.pi * 0.9 * t_s + 1.0),
            1.3 * np.sin(2 * np.pi * 0.6 * t_s + 2.0) + 0.3 * np.sin(2 * np.pi * 2.3 * t_s),
        )
    )


def angles_rad(t_s: Array) -> Array:
    fine_s = np.arange(-2.0, DURATION_S + 2.0, 0.001)
    sums = np.cumsum(rates_rps(fine_s), axis=0) * 0.001
    return np.column_stack([np.interp(t_s, fine_s, column) for column in sums.T])


def measured(delay_s: float, set_s: float, seed: int, still: bool = False) -> Delay:
    """The delay that is found with pictures that are `delay_s` old while the setting is `set_s`."""
    rng = np.random.default_rng(seed)
    exposed_s = np.sort(np.arange(0.5, DURATION_S - 0.5, 1 / 15) + rng.normal(0.0, 0.003, 360))
    turned = np.diff(angles_rad(exposed_s), axis=0) * (0.0 if still else 1.0)
    turned += rng.normal(0.0, 0.004, turned.shape)
    stamped_s = exposed_s + delay_s - set_s
    steps = [
        TurnStep(float(a), float(b), (float(x), float(y), float(z)))
        for a, b, (x, y, z) in zip(stamped_s[:-1], stamped_s[1:], turned, strict=True)
    ]
    gyro_s = np.arange(0.0, DURATION_S, 0.02)
    gyro = rates_rps(gyro_s) * (0.0 if still else 1.0) + rng.normal(0.0, 0.01, (len(gyro_s), 3))
    return measure_delay(steps, gyro_s, gyro)


@pytest.mark.parametrize(("delay_s", "set_s"), [(0.05, 0.0), (0.183, 0.05), (0.02, 0.12), (0.4, 0.0)])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_delay_is_found_within_five_milliseconds(delay_s: float, set_s: float, seed: int) -> None:
    found = measured(delay_s, set_s, seed)
    assert set_s + found.shift_s == pytest.approx(delay_s, abs=0.005)
    assert found.spread_s < 0.005 and found.correlation > 0.98


def test_a_vehicle_that_stands_still_is_named() -> None:
    with pytest.raises(DelayError, match="turn it to and fro"):
        measured(0.1, 0.0, 1, still=True)


def test_too_little_and_rotations_that_differ_are_named() -> None:
    gyro_s = np.arange(0.0, DURATION_S, 0.02)
    with pytest.raises(DelayError, match="are too few"):
        measure_delay([], gyro_s, rates_rps(gyro_s))
    rng = np.random.default_rng(1)
    steps = [TurnStep(k / 15, (k + 1) / 15, tuple(rng.normal(0.0, 0.05, 3).tolist())) for k in range(300)]
    with pytest.raises(DelayError, match="do not turn alike"):
        measure_delay(steps, gyro_s, rates_rps(gyro_s))


def test_a_delay_beyond_the_search_is_named() -> None:
    with pytest.raises(DelayError, match=r"do not turn alike|differs by more than 0\.6 s"):
        measured(0.7, 0.0, 1)


@pytest.mark.parametrize("turn_rad", [(0.0, 0.0, 0.06), (0.03, 0.0, 0.0), (-0.02, 0.03, 0.01)])
def test_the_rotation_of_a_picture_is_that_of_the_camera_in_the_vehicles_axes(turn_rad: tuple[float, ...]) -> None:
    mount = CameraMountConfig()
    info = mount.info(0)
    texture = cv2.GaussianBlur(np.random.default_rng(2).integers(0, 255, (480, 640), dtype=np.uint8), (0, 0), 3.0)
    low, high = float(texture.min()), float(texture.max())
    texture = np.asarray((texture - low) * (255.0 / (high - low)), np.uint8)
    # The vehicle turns by a vector in frd; the camera looks straight down with its top ahead: right = frd right, down =
    # frd backward, forward = frd down.
    frd_from_camera = np.array(((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
    turn_camera = cv2.Rodrigues(frd_from_camera.T @ np.array(turn_rad))[0]
    k = np.array(((info.focal_px, 0.0, info.center_px[0]), (0.0, info.focal_px, info.center_px[1]), (0.0, 0.0, 1.0)))
    after = cv2.warpPerspective(texture, k @ turn_camera.T @ np.linalg.inv(k), (640, 480), flags=cv2.INTER_LINEAR)
    tracker = TurnTracker(info)
    assert tracker.update(np.asarray(texture, np.uint8), 1.0, frd_from_camera) is None
    step = tracker.update(np.asarray(after, np.uint8), 1.1, frd_from_camera)
    assert step is not None
    assert step.angle_frd_rad == pytest.approx(turn_rad, abs=0.001)


def test_pictures_without_details_and_after_a_gap_give_nothing() -> None:
    tracker = TurnTracker(CameraMountConfig().info(0))
    grey = np.full((480, 640), 90, np.uint8)
    assert tracker.update(grey, 1.0, np.eye(3)) is None
    assert tracker.update(grey, 1.1, np.eye(3)) is None
    assert tracker.update(grey, 3.0, np.eye(3)) is None
