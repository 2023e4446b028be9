"""The navigator: setpoints of the modes takeoff, hold, return, land and descend."""

from enum import Enum
from math import hypot, tan

from jezero.base.frames import Vec3, add, distance, scale
from jezero.services.autopilot.config import ControlConfig, NavigatorConfig
from jezero.services.autopilot.control import Axes, ControlSetpoint, Kinematics
from jezero.services.autopilot.modes import Mode

REACHED_RADIUS_M = 0.3
RETRY_OFFSET_M = 1.0
RETRY_CLIMB_M = 0.5
RETRY_TIMEOUT_US = 4_000_000
RETRIES_MAX = 3
"""A landing that meets an edge is retried at a point this far beside and above it. The flight to that point times out,
and the number of retries of one landing is limited.
"""
RETRY_BLIND_US = 2_500_000
SPEED_STANDING_MAX_MPS = 1.0
"""In descend mode, without a position, a retry moves aside for RETRY_BLIND_US and stands still for the rest of the
time-out. A vehicle that seems faster than SPEED_STANDING_MAX_MPS may slide on the edge; it does not retry.
"""
BRAKE_TIME_US = 4_000_000
SPEED_MOVING_MIN_MPS = 0.3
"""A vehicle that enters descend mode faster than SPEED_MOVING_MIN_MPS brakes by its velocity estimate for
BRAKE_TIME_US, until it has stopped and its tilt compensates the wind. A hovering vehicle has that tilt already. Later
the velocity estimate has drifted so much that keeping the tilt is more accurate.
"""
TAKEOFF_CLIMB_MIN_M = 0.2
"""Source: PX4's `FlightTask::_checkTakeoff`."""


class ReturnLeg(Enum):
    """Leg of the return."""

    CLIMB = "climb"
    FLY = "fly"
    LAND = "land"


class Navigator:
    """Generates the setpoints of the modes that need no external setpoints.

    Attributes:
        home_ned_m: position of the last arming; before that, of the start of the estimator.
    """

    def __init__(self, config: NavigatorConfig, control: ControlConfig) -> None:
        self.configure(config, control)
        self.home_ned_m: Vec3 = (0.0, 0.0, 0.0)
        self._point_ned_m: Vec3 = (0.0, 0.0, 0.0)
        """Point to hold, to climb to or to land at; during a return the end of the present leg."""
        self._yaw_rad = 0.0
        self._leg = ReturnLeg.CLIMB
        self._retry_until_us = 0
        self._retries = 0
        self._vel_before_retry_ned_mps: Vec3 = (0.0, 0.0, 0.0)
        self._retry_vel_ned_mps: Vec3 = (0.0, 0.0, 0.0)
        self._brake_until_us = 0

    def configure(self, config: NavigatorConfig, control: ControlConfig) -> None:
        """Apply new settings at once."""
        self._config = config
        self._control = control

    def on_position_reset(self, step_ned_m: Vec3) -> None:
        """Move all points along with a reset of the position estimate."""
        self.home_ned_m = add(self.home_ned_m, step_ned_m)
        self._point_ned_m = add(self._point_ned_m, step_ned_m)

    def activate(self, mode: Mode, at: Kinematics, stop_ned_m: Vec3, t_us: int) -> None:
        """Start a mode.

        Args:
            stop_ned_m: point where the vehicle comes to rest when it brakes now.
        """
        self._yaw_rad = at.yaw_rad
        self._point_ned_m = stop_ned_m
        self._retry_until_us = 0
        self._retries = 0
        self._brake_until_us = t_us + BRAKE_TIME_US if hypot(*at.vel_ned_mps[:2]) > SPEED_MOVING_MIN_MPS else 0
        if mode is Mode.TAKEOFF:
            self.climb_to(at, (None, None, None))
        elif mode is Mode.RETURN:
            self._leg = ReturnLeg.CLIMB
            self._point_ned_m = (stop_ned_m[0], stop_ned_m[1], self._return_z_ned_m(at.pos_ned_m))

    def climb_to(self, at: Kinematics, point_ned_m: Axes) -> None:
        """Take off to a point. An axis that is None keeps its position; a height that is None is MIS_TAKEOFF_ALT above.

        Source: PX4's `Takeoff::set_takeoff_position`.
        """
        north, east, down = at.pos_ned_m
        point_n, point_e, point_d = point_ned_m
        usual_d = down - self._config.mis_takeoff_alt_m
        self._point_ned_m = (
            north if point_n is None else point_n,
            east if point_e is None else point_e,
            usual_d if point_d is None else min(down, point_d),
        )
        self._yaw_rad = at.yaw_rad

    def go_to(self, point_ned_m: Vec3, yaw_rad: float | None) -> None:
        """Hold at another point; a heading of None stays as it is."""
        self._point_ned_m = point_ned_m
        self._yaw_rad = self._yaw_rad if yaw_rad is None else yaw_rad

    def leave_contact(self, mode: Mode, at: Kinematics, lean_ned: tuple[float, float], t_us: int) -> bool:
        """Decide whether the vehicle leaves the edge that tilts it; returns False if it should stay there.

        A landing is retried beside the edge, at most RETRIES_MAX times; other modes keep their setpoint. In descend
        mode the velocity estimate has an error too, which is known as long as the vehicle stands on the edge: it is the
        estimated velocity itself.

        Args:
            lean_ned: north and east part of the body's up axis.
        """
        if not (mode in {Mode.LAND, Mode.DESCEND} or (mode is Mode.RETURN and self._leg is ReturnLeg.LAND)):
            return True
        may_slide = mode is Mode.DESCEND and hypot(*at.vel_ned_mps[:2]) > SPEED_STANDING_MAX_MPS
        if may_slide or t_us < self._retry_until_us or self._retries == RETRIES_MAX:
            return False
        self._retry_until_us = t_us + RETRY_TIMEOUT_US
        self._retries += 1
        factor = RETRY_OFFSET_M / hypot(*lean_ned)
        offset_ned_m = (factor * lean_ned[0], factor * lean_ned[1], -RETRY_CLIMB_M)
        self._point_ned_m = add(at.pos_ned_m, offset_ned_m)
        self._vel_before_retry_ned_mps = at.vel_ned_mps
        self._retry_vel_ned_mps = scale(offset_ned_m, 1e6 / RETRY_BLIND_US)
        return True

    def requires_takeoff(self, at: Kinematics) -> bool:
        """Whether the point is so far above a landed vehicle that it takes off."""
        return at.pos_ned_m[2] - self._point_ned_m[2] > TAKEOFF_CLIMB_MIN_M

    def is_takeoff_done(self, mode: Mode, at: Kinematics) -> bool:
        """Whether takeoff mode has reached its height."""
        return mode is Mode.TAKEOFF and abs(at.pos_ned_m[2] - self._point_ned_m[2]) < REACHED_RADIUS_M

    def setpoint(self, mode: Mode, at: Kinematics, t_us: int) -> ControlSetpoint:
        """Setpoint of a mode at this time."""
        if mode is Mode.DESCEND:
            return ControlSetpoint(vel_ned_mps=self._descend_velocity(at, t_us), yaw_rad=self._yaw_rad)
        if mode is Mode.LAND:
            return self._land_setpoint(at, t_us)
        if mode is Mode.TAKEOFF:
            return self._takeoff_setpoint(at)
        if mode is Mode.RETURN:
            self._advance_return(at)
            if self._leg is ReturnLeg.LAND:
                return self._land_setpoint(at, t_us)
        return ControlSetpoint(self._point_ned_m, yaw_rad=self._yaw_rad)

    def _takeoff_setpoint(self, at: Kinematics) -> ControlSetpoint:
        """Position setpoint of a takeoff; its height is limited so that the climb is not faster than MPC_TKO_SPEED."""
        north, east, down = self._point_ned_m
        lead_m = self._control.mpc_tko_speed_mps / self._control.mpc_z_p
        return ControlSetpoint((north, east, max(down, at.pos_ned_m[2] - lead_m)), yaw_rad=self._yaw_rad)

    def _descend_velocity(self, at: Kinematics, t_us: int) -> Axes:
        """Velocity setpoint of a descent without a valid position."""
        remaining_us, down_mps = self._retry_until_us - t_us, self._control.mpc_land_speed_mps
        if remaining_us > 0:
            north, east, _ = self._vel_before_retry_ned_mps
            retry_vel_ned_mps = (
                self._retry_vel_ned_mps if remaining_us > RETRY_TIMEOUT_US - RETRY_BLIND_US else (0.0, 0.0, 0.0)
            )
            return add((north, east, 0.0), retry_vel_ned_mps)
        if t_us >= self._brake_until_us:
            return (None, None, down_mps)
        north, east, _ = at.vel_ned_mps
        brake_mps = self._control.mpc_acc_hor_mps2 / self._control.mpc_xy_vel_p_acc
        factor = max(0.0, 1.0 - brake_mps / max(brake_mps, hypot(north, east)))
        return (factor * north, factor * east, down_mps)

    def _land_setpoint(self, at: Kinematics, t_us: int) -> ControlSetpoint:
        if t_us < self._retry_until_us:
            if distance(at.pos_ned_m, self._point_ned_m) > REACHED_RADIUS_M:
                return ControlSetpoint(self._point_ned_m, yaw_rad=self._yaw_rad)
            self._retry_until_us = t_us
        c, (north, east, _) = self._control, self._point_ned_m
        high = self.home_ned_m[2] - at.pos_ned_m[2] > c.mpc_land_alt2_m
        speed_mps = c.mpc_z_vel_max_dn_mps if high else c.mpc_land_speed_mps
        return ControlSetpoint((north, east, None), (None, None, speed_mps), yaw_rad=self._yaw_rad)

    def _advance_return(self, at: Kinematics) -> None:
        """Start the next leg of the return when the present one is done."""
        down = self._point_ned_m[2]
        dn, de, dd = (a - b for a, b in zip(at.pos_ned_m, self._point_ned_m, strict=True))
        if self._leg is ReturnLeg.CLIMB and dd < REACHED_RADIUS_M:
            self._leg = ReturnLeg.FLY
            self._point_ned_m = (self.home_ned_m[0], self.home_ned_m[1], down)
        elif (
            self._leg is ReturnLeg.FLY
            and hypot(dn, de) < REACHED_RADIUS_M
            and hypot(*at.vel_ned_mps[:2]) < REACHED_RADIUS_M
        ):
            self._leg = ReturnLeg.LAND

    def _return_z_ned_m(self, pos_ned_m: Vec3) -> float:
        """Height of the return. Source: PX4's `calculate_return_alt_from_cone_half_angle`."""
        c, home = self._config, self.home_ned_m
        away_m = hypot(pos_ned_m[0] - home[0], pos_ned_m[1] - home[1])
        height_m = c.rtl_return_alt_m
        if away_m <= c.rtl_min_dist_m:
            height_m = min(height_m, away_m / tan(c.rtl_cone_ang_rad))
        return min(pos_ned_m[2], home[2] - height_m)
