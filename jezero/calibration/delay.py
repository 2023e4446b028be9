"""The delay of a camera: how old its pictures are on arrival, from their rotation and the gyro's.

Source: the time offset at which two signals of one rotation agree best, as in the first step of Kalibr's calibration of
camera and IMU.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from jezero.base.arrays import Array
from jezero.base.lens import undistort
from jezero.schemas.sensors import CameraInfo

SHIFT_MIN_S, SHIFT_MAX_S, SHIFT_STEP_S = -0.6, 0.6, 0.002
POINTS_MAX, POINTS_MIN = 200, 20
RAY_ERROR_MAX = 0.01
"""Distance of a ray from where the rotation puts it, at unit distance, from which on it counts as another motion."""
STEPS_MIN = 60
GAP_MAX_S = 0.4
"""Two pictures further apart than this are not compared."""
RATE_RMS_MIN_RPS = 0.2
CORRELATION_MIN = 0.7
PARTS = 5
"""Parts of the signal that are matched alone, for the spread."""


class DelayError(ValueError):
    """The delay can't be measured; the message says what to do."""


@dataclass(frozen=True)
class TurnStep:
    """The camera's rotation between two pictures.

    Attributes:
        from_s, to_s: times of the two exposures, as the pictures have them.
        angle_frd_rad: rotation vector of the vehicle, in its own axes.
    """

    from_s: float
    to_s: float
    angle_frd_rad: tuple[float, float, float]


@dataclass(frozen=True)
class Delay:
    """The result.

    Attributes:
        shift_s: how much older the pictures are than their time stamps say.
        spread_s: standard deviation of this among the parts of the signal.
        correlation: of the two rotations at that shift; 1 where they are the same.
        steps: number of pairs of pictures.
    """

    shift_s: float
    spread_s: float
    correlation: float
    steps: int


def measure_delay(steps: Sequence[TurnStep], gyro_s: Array, gyro_frd_rps: Array) -> Delay:
    """Find the shift at which the pictures' rotation is the gyro's.

    Args:
        steps: rotations by the pictures.
        gyro_s: (n,) times of the rates.
        gyro_frd_rps: (n, 3) rates of the body.

    Raises:
        DelayError: there was too little rotation, or the two do not agree at any shift.
    """
    if len(steps) < STEPS_MIN or len(gyro_s) < STEPS_MIN:
        raise DelayError(
            f"{len(steps)} pairs of pictures and {len(gyro_s)} rates are too few, {STEPS_MIN} are the least: turn the "
            "vehicle over ground with many details, in good light, for longer"
        )
    order = np.argsort(gyro_s)
    gyro_s, gyro_frd_rps = gyro_s[order], gyro_frd_rps[order]
    rms_rps = float(np.sqrt(np.mean(np.sum(gyro_frd_rps**2, axis=1))))
    if rms_rps < RATE_RMS_MIN_RPS:
        raise DelayError(f"the vehicle was turned at {rms_rps:.2f} rad/s only: turn it to and fro, faster")
    whole = _Signals(steps, gyro_s, gyro_frd_rps)
    shift_s, correlation = whole.best_shift()
    if correlation < CORRELATION_MIN:
        raise DelayError(
            f"pictures and gyro do not turn alike (correlation {correlation:.2f}): is the camera's mounting in "
            "vehicle.toml right, and did only the vehicle move?"
        )
    if not SHIFT_MIN_S + 0.02 < shift_s < SHIFT_MAX_S - 0.02:
        raise DelayError(f"the delay differs by more than {SHIFT_MAX_S:g} s from the setting exposure_delay_s")
    parts = [
        _Signals(steps[begin : begin + len(steps) // PARTS], gyro_s, gyro_frd_rps).best_shift()[0]
        for begin in range(0, len(steps) // PARTS * PARTS, len(steps) // PARTS)
    ]
    return Delay(shift_s, float(np.std(parts)), correlation, len(steps))


class _Signals:
    """The rotations of pictures and gyro over the same spans."""

    def __init__(self, steps: Sequence[TurnStep], gyro_s: Array, gyro_frd_rps: Array) -> None:
        spans_s = np.diff(gyro_s, prepend=gyro_s[0])
        means = 0.5 * (gyro_frd_rps + np.vstack((gyro_frd_rps[:1], gyro_frd_rps[:-1])))
        self._gyro_s = gyro_s
        self._angles_rad = np.cumsum(means * spans_s[:, None], axis=0)
        self._from_s = np.array([step.from_s for step in steps])
        self._to_s = np.array([step.to_s for step in steps])
        self._seen_rad = np.array([step.angle_frd_rad for step in steps])

    def correlation(self, shift_s: float) -> float:
        """Correlation of the two rotations, if the pictures are older by `shift_s` than they say."""
        from_s, to_s = self._from_s - shift_s, self._to_s - shift_s
        inside = (from_s >= self._gyro_s[0]) & (to_s <= self._gyro_s[-1])
        if inside.sum() < 0.5 * len(inside):
            return 0.0
        turned = np.column_stack(
            [
                np.interp(to_s, self._gyro_s, angles) - np.interp(from_s, self._gyro_s, angles)
                for angles in self._angles_rad.T
            ]
        )[inside]
        seen = self._seen_rad[inside]
        size = float(np.sqrt(np.sum(turned**2) * np.sum(seen**2)))
        return float(np.sum(turned * seen)) / size if size > 0.0 else 0.0

    def best_shift(self) -> tuple[float, float]:
        """The shift of the greatest correlation, between the steps by a parabola, and that correlation."""
        shifts_s = np.arange(SHIFT_MIN_S, SHIFT_MAX_S, SHIFT_STEP_S)
        found = np.array([self.correlation(float(shift_s)) for shift_s in shifts_s])
        best = int(np.argmax(found))
        near = slice(max(0, best - 8), best + 9)  # 16 ms to each side: the top is flat, and its noise finer than that
        bend, slope, _ = np.polyfit(shifts_s[near] - shifts_s[best], found[near], 2)
        shift_s = float(shifts_s[best])
        if bend < 0.0:
            shift_s += float(np.clip(-0.5 * slope / bend, -0.02, 0.02))
        return shift_s, float(found[best])


class TurnTracker:
    """Measures the camera's rotation from picture to picture.

    Args:
        info: the camera's intrinsics.
    """

    def __init__(self, info: CameraInfo) -> None:
        self._info = info
        self._last: tuple[float, npt.NDArray[np.uint8]] | None = None

    def update(self, grey: npt.NDArray[np.uint8], t_s: float, frd_from_camera: Array) -> TurnStep | None:
        """Compare a picture with the one before.

        Args:
            grey: the picture.
            t_s: time of its exposure, as it says.
            frd_from_camera: (3, 3) rotation from the camera's axes right, down, forward.

        Returns:
            None for the first picture, and where too few points are seen in both.
        """
        last, self._last = self._last, (t_s, grey)
        if last is None or not 0.0 < t_s - last[0] <= GAP_MAX_S:
            return None
        rays = self._rays(last[1], grey)
        if rays is None:
            return None
        turn = _rotation(*rays)
        if turn is None:
            return None
        # Rays of fixed points turn against the camera.
        x, y, z = (frd_from_camera @ -np.ravel(cv2.Rodrigues(turn)[0])).tolist()
        return TurnStep(last[0], t_s, (x, y, z))

    def _rays(self, before: npt.NDArray[np.uint8], after: npt.NDArray[np.uint8]) -> tuple[Array, Array] | None:
        """Rays to the same points in two pictures."""
        points = cv2.goodFeaturesToTrack(before, POINTS_MAX, 0.01, 10)
        if points is None or len(points) < POINTS_MIN:
            return None
        track: Any = cv2.calcOpticalFlowPyrLK  # its stubs permit no None for the points that it finds
        moved, found, _ = track(before, after, points, None, winSize=(21, 21), maxLevel=4)
        back, found_back, _ = track(after, before, moved, None, winSize=(21, 21), maxLevel=4)
        returned = np.abs(points - back).reshape(-1, 2).max(axis=1) < 0.5
        kept = (np.ravel(found) == 1) & (np.ravel(found_back) == 1) & returned
        if kept.sum() < POINTS_MIN:
            return None
        return self._ray(points.reshape(-1, 2)[kept]), self._ray(moved.reshape(-1, 2)[kept])

    def _ray(self, points_px: Array) -> Array:
        info = self._info
        ideal = undistort((points_px - np.array(info.center_px)) / info.focal_px, info.distortion, info.aspect)
        rays = np.column_stack((ideal, np.ones(len(ideal))))
        unit: Array = rays / np.linalg.norm(rays, axis=1, keepdims=True)
        return unit


def _rotation(before: Array, after: Array) -> Array | None:
    """The rotation that takes most rays to the others; None where there is no such.

    Source: Kabsch 1976, repeated with the rays that agree.
    """
    kept = np.isfinite(before).all(axis=1) & np.isfinite(after).all(axis=1)
    rotation: Array = np.eye(3)
    for _ in range(4):
        if kept.sum() < POINTS_MIN:
            return None
        u, _, vt = np.linalg.svd(after[kept].T @ before[kept])
        rotation = u @ np.diag((1.0, 1.0, float(np.sign(np.linalg.det(u @ vt))))) @ vt
        errors = np.linalg.norm(after - before @ rotation.T, axis=1)
        limit = max(RAY_ERROR_MAX, 1.5 * float(np.nanmedian(errors)))
        kept = errors < limit
    return rotation
