"""Estimation of the wind from tilt, acceleration and drag, which every autopilot's odometry allows."""

from math import hypot, sqrt

import msgspec

from jezero.base.frames import Quat, Vec3, quat_conjugate, quat_rotate
from jezero.base.vehicle_config import VehicleConfig
from jezero.schemas.state import Odometry
from jezero.schemas.units import NS_PER_S
from jezero.services.vehicle_bridge.vehicle import VehicleSnapshot

SAMPLE_S = 0.4
"""One sample of the wind is made of this time of flight. Shorter differences of the velocity would be mostly noise."""
GAP_MAX_S = 0.2
"""A sample is dropped at a longer gap in the odometry."""
TIME_CONSTANT_S = 5.0
"""Time constant of the mean wind: longer than a gust, shorter than a landing."""
SAMPLES_MIN = 5
"""The wind is unknown before this number of samples."""
HEIGHT_MIN_M = 0.5
"""A lower vehicle may be tilted by what it touches, or be leaving the ground."""
UPRIGHT_MIN = 0.5
"""Least cosine of the tilt: at a larger tilt the horizontal forces can't be separated from the thrust."""


def wind_ned_mps(acc_ned_mps2: Vec3, vel_ned_mps: Vec3, q_ned_from_frd: Quat, robot: VehicleConfig) -> Vec3 | None:
    """(3,) horizontal wind by the balance of forces; None for a vehicle that is far from upright.

    The rotors pull along the body's down axis only. So what remains of the acceleration in the plane of the body's
    forward and right axes, without gravity, is drag. The airspeed follows from the drag, and the wind from the airspeed
    and the velocity over ground. Vertical wind is taken as none.
    """
    down_ned = quat_rotate(q_ned_from_frd, (0.0, 0.0, 1.0))
    if down_ned[2] < UPRIGHT_MIN:
        return None
    frd_from_ned = quat_conjugate(q_ned_from_frd)
    north_mps2, east_mps2, down_mps2 = acc_ned_mps2
    specific_ned_mps2 = (north_mps2, east_mps2, down_mps2 - robot.planet.gravity_mps2)
    forward_mps2, right_mps2, _ = quat_rotate(frd_from_ned, specific_ned_mps2)
    drag_n = robot.airframe.mass_kg * hypot(forward_mps2, right_mps2)
    per_mps = -robot.airspeed_mps(drag_n) / max(drag_n / robot.airframe.mass_kg, 1e-9)
    air_forward_mps, air_right_mps = per_mps * forward_mps2, per_mps * right_mps2
    # The component along the body's down axis is the one that makes the vertical wind zero.
    north_mps, east_mps, down_mps = quat_rotate(q_ned_from_frd, (air_forward_mps, air_right_mps, 0.0))
    along_mps = (vel_ned_mps[2] - down_mps) / down_ned[2]
    return (
        vel_ned_mps[0] - north_mps - along_mps * down_ned[0],
        vel_ned_mps[1] - east_mps - along_mps * down_ned[1],
        0.0,
    )


class EstimatedWind(msgspec.Struct, frozen=True):
    """The wind of the last seconds.

    Attributes:
        mean_ned_mps: horizontal mean.
        std_gust_mps: standard deviation of a horizontal component.
    """

    mean_ned_mps: Vec3
    std_gust_mps: float


class WindEstimator:
    """Mean and gusts of the wind at a flying vehicle.

    Near the ground the estimate stays as it is; a disarmed or landed vehicle has none, and so has one whose airframe is
    configured without drag.
    """

    def __init__(self, robot: VehicleConfig) -> None:
        self._robot = robot
        self._has_drag = robot.airframe.drag_rotors_nspm > 0.0 or robot.airframe.drag_area_side_m2 > 0.0
        self.reset()

    def reset(self) -> None:
        """Forget all samples."""
        self._samples = 0
        self._north_mps = self._east_mps = self._var_m2ps2 = 0.0
        self._last: Odometry | None = None
        self._begin: Odometry | None = None
        self._middle: Odometry | None = None

    @property
    def wind(self) -> EstimatedWind | None:
        """None until enough samples are there."""
        if self._samples < SAMPLES_MIN:
            return None
        return EstimatedWind((self._north_mps, self._east_mps, 0.0), sqrt(self._var_m2ps2))

    def update(self, odometry: Odometry, vehicle: VehicleSnapshot) -> None:
        """Add one odometry of the vehicle, which is in this state."""
        if not vehicle.armed or vehicle.landed or not self._has_drag:
            self.reset()
            return
        low = vehicle.height_m is None or vehicle.height_m < HEIGHT_MIN_M
        last, self._last = self._last, odometry
        if low or last is None or not 0 < odometry.t_ns - last.t_ns <= GAP_MAX_S * NS_PER_S:
            self._begin = self._middle = None
            return
        begin = self._begin = self._begin or odometry
        passed_s = (odometry.t_ns - begin.t_ns) / NS_PER_S
        if self._middle is None and passed_s >= 0.5 * SAMPLE_S:
            self._middle = odometry
        if passed_s >= SAMPLE_S and self._middle is not None:
            self._add_sample(begin, self._middle, odometry, passed_s)
            self._begin, self._middle = odometry, None

    def _add_sample(self, begin: Odometry, middle: Odometry, end: Odometry, passed_s: float) -> None:
        (n0, e0, d0), (n1, e1, d1) = begin.vel_uav_ned_mps, end.vel_uav_ned_mps
        acc_ned_mps2 = ((n1 - n0) / passed_s, (e1 - e0) / passed_s, (d1 - d0) / passed_s)
        sample = wind_ned_mps(acc_ned_mps2, middle.vel_uav_ned_mps, middle.q_ned_from_frd, self._robot)
        if sample is None:
            return
        self._samples += 1
        weight = max(1.0 / self._samples, passed_s / TIME_CONSTANT_S)
        north_mps, east_mps = sample[0] - self._north_mps, sample[1] - self._east_mps
        self._north_mps += weight * north_mps
        self._east_mps += weight * east_mps
        square_m2ps2 = 0.5 * (north_mps * north_mps + east_mps * east_mps)
        self._var_m2ps2 = (1.0 - weight) * (self._var_m2ps2 + weight * square_m2ps2)
