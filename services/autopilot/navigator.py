"""Setpoints of the autopilot's own modes: takeoff, hold, return, land."""

from enum import Enum
from math import hypot, tan

from jezero.frames import Vec3, add, distance, scale
from jezero.services.autopilot.config import ControlConfig, NavigatorConfig
from jezero.services.autopilot.control import Axes, Kinematics, Setpoint
from jezero.services.autopilot.modes import Mode

REACHED_M = 0.3
ASIDE_M = 1.0
ASIDE_UP_M = 0.5
ASIDE_US = 4_000_000
ASIDE_TIMES = 3
"""How far from an edge it tries to land again, how far above it goes there, for how long at most, and how often."""
ASIDE_BLIND_US = 2_500_000
STANDS_MAX_MPS = 1.0
"""Without a position it goes for this long, and stands still for the rest. Who seems to be faster may be sliding."""
BRAKES_US = 4_000_000
MOVES_MPS = 0.3
"""Who loses his position on the move brakes by the velocity that he still knows: long enough to stop and to lean as the
wind wants it. Who hovers leans like that already. Later on that lean is better than what the velocity has gone astray.
"""
LIFT_FOR_M = 0.2
"""Source: PX4's `FlightTask::_checkTakeoff`."""


class Leg(Enum):
    """Of the way home."""

    CLIMB = "climb"
    FLY = "fly"
    LAND = "land"


class Navigator:
    """Where to go in the modes that need no one else.

    Attributes:
        home_ned_m: where the vehicle last armed; before that, where its estimator started.
    """

    def __init__(self, config: NavigatorConfig, control: ControlConfig) -> None:
        self.configure(config, control)
        self.home_ned_m: Vec3 = (0.0, 0.0, 0.0)
        self._point_ned_m: Vec3 = (0.0, 0.0, 0.0)
        """To hold, to climb to, to land at, or the present one on the way home."""
        self._yaw_rad = 0.0
        self._leg = Leg.CLIMB
        self._aside_until_us = 0
        self._asides = 0
        self._still_ned_mps: Vec3 = (0.0, 0.0, 0.0)
        self._aside_ned_mps: Vec3 = (0.0, 0.0, 0.0)
        self._brakes_until_us = 0

    def configure(self, config: NavigatorConfig, control: ControlConfig) -> None:
        """New settings."""
        self._config = config
        self._control = control

    def moved(self, step_ned_m: Vec3) -> None:
        """The position estimate was reset by a step."""
        self.home_ned_m = add(self.home_ned_m, step_ned_m)
        self._point_ned_m = add(self._point_ned_m, step_ned_m)

    def enter(self, mode: Mode, at: Kinematics, stop_ned_m: Vec3, t_us: int) -> None:
        """A new mode begins.

        Args:
            stop_ned_m: where the vehicle comes to rest when it brakes now.
        """
        self._yaw_rad = at.yaw_rad
        self._point_ned_m = stop_ned_m
        self._aside_until_us = 0
        self._asides = 0
        self._brakes_until_us = t_us + BRAKES_US if hypot(*at.vel_ned_mps[:2]) > MOVES_MPS else 0
        if mode is Mode.TAKEOFF:
            self.climb_to(at, (None, None, None))
        elif mode is Mode.RETURN:
            self._leg = Leg.CLIMB
            self._point_ned_m = (stop_ned_m[0], stop_ned_m[1], self._return_z_ned_m(at.pos_ned_m))

    def climb_to(self, at: Kinematics, point_ned_m: Axes) -> None:
        """Take off to a point, never downwards; without a height to the usual one above the vehicle.

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
        """Hold at another point; the heading stays when none is given."""
        self._point_ned_m = point_ned_m
        self._yaw_rad = self._yaw_rad if yaw_rad is None else yaw_rad

    def leave(self, mode: Mode, at: Kinematics, lean_ned: tuple[float, float], t_us: int) -> bool:
        """Leave what the vehicle leans over; False when it is to stay there.

        Who lands does so beside it from now on, unless he has tried that often enough; others go on as before. Without
        a position, in descend mode, the velocity is wrong as well, but by how much is known if the vehicle stands.
        """
        if not (mode in {Mode.LAND, Mode.DESCEND} or (mode is Mode.RETURN and self._leg is Leg.LAND)):
            return True
        slides = mode is Mode.DESCEND and hypot(*at.vel_ned_mps[:2]) > STANDS_MAX_MPS
        if slides or t_us < self._aside_until_us or self._asides == ASIDE_TIMES:
            return False
        self._aside_until_us = t_us + ASIDE_US
        self._asides += 1
        share = ASIDE_M / hypot(*lean_ned)
        aside_ned_m = (share * lean_ned[0], share * lean_ned[1], -ASIDE_UP_M)
        self._point_ned_m = add(at.pos_ned_m, aside_ned_m)
        self._still_ned_mps = at.vel_ned_mps
        self._aside_ned_mps = scale(aside_ned_m, 1e6 / ASIDE_BLIND_US)
        return True

    def leads_up(self, at: Kinematics) -> bool:
        """Whether the point is so far above the vehicle that it lifts off for it."""
        return at.pos_ned_m[2] - self._point_ned_m[2] > LIFT_FOR_M

    def finished(self, mode: Mode, at: Kinematics) -> bool:
        """Whether a takeoff is at its height."""
        return mode is Mode.TAKEOFF and abs(at.pos_ned_m[2] - self._point_ned_m[2]) < REACHED_M

    def setpoint(self, mode: Mode, at: Kinematics, t_us: int) -> Setpoint:
        """What to fly now."""
        if mode is Mode.DESCEND:
            return Setpoint(vel_ned_mps=self._descending(at, t_us), yaw_rad=self._yaw_rad)
        if mode is Mode.LAND:
            return self._landing(at, t_us)
        if mode is Mode.TAKEOFF:
            return self._climbing(at)
        if mode is Mode.RETURN:
            self._advance(at)
            if self._leg is Leg.LAND:
                return self._landing(at, t_us)
        return Setpoint(self._point_ned_m, yaw_rad=self._yaw_rad)

    def _climbing(self, at: Kinematics) -> Setpoint:
        """The height that is asked for never is so far above that the climb exceeds its speed."""
        north, east, down = self._point_ned_m
        lead_m = self._control.mpc_tko_speed_mps / self._control.mpc_z_p
        return Setpoint((north, east, max(down, at.pos_ned_m[2] - lead_m)), yaw_rad=self._yaw_rad)

    def _descending(self, at: Kinematics, t_us: int) -> Axes:
        """Velocity of a descent without a position."""
        left_us, down_mps = self._aside_until_us - t_us, self._control.mpc_land_speed_mps
        if left_us > 0:
            north, east, _ = self._still_ned_mps
            aside_ned_mps = self._aside_ned_mps if left_us > ASIDE_US - ASIDE_BLIND_US else (0.0, 0.0, 0.0)
            return add((north, east, 0.0), aside_ned_mps)
        if t_us >= self._brakes_until_us:
            return (None, None, down_mps)
        north, east, _ = at.vel_ned_mps
        less_mps = self._control.mpc_acc_hor_mps2 / self._control.mpc_xy_vel_p_acc
        share = max(0.0, 1.0 - less_mps / max(less_mps, hypot(north, east)))
        return (share * north, share * east, down_mps)

    def _landing(self, at: Kinematics, t_us: int) -> Setpoint:
        if t_us < self._aside_until_us:
            if distance(at.pos_ned_m, self._point_ned_m) > REACHED_M:
                return Setpoint(self._point_ned_m, yaw_rad=self._yaw_rad)
            self._aside_until_us = t_us
        c, (north, east, _) = self._control, self._point_ned_m
        high = self.home_ned_m[2] - at.pos_ned_m[2] > c.mpc_land_alt2_m
        speed_mps = c.mpc_z_vel_max_dn_mps if high else c.mpc_land_speed_mps
        return Setpoint((north, east, None), (None, None, speed_mps), yaw_rad=self._yaw_rad)

    def _advance(self, at: Kinematics) -> None:
        """The next leg of the way home when this one is done."""
        down = self._point_ned_m[2]
        dn, de, dd = (a - b for a, b in zip(at.pos_ned_m, self._point_ned_m, strict=True))
        if self._leg is Leg.CLIMB and dd < REACHED_M:
            self._leg = Leg.FLY
            self._point_ned_m = (self.home_ned_m[0], self.home_ned_m[1], down)
        elif self._leg is Leg.FLY and hypot(dn, de) < REACHED_M and hypot(*at.vel_ned_mps[:2]) < REACHED_M:
            self._leg = Leg.LAND

    def _return_z_ned_m(self, pos_ned_m: Vec3) -> float:
        """Height for the way home. Source: PX4's `calculate_return_alt_from_cone_half_angle`."""
        c, home = self._config, self.home_ned_m
        away_m = hypot(pos_ned_m[0] - home[0], pos_ned_m[1] - home[1])
        height_m = c.rtl_return_alt_m
        if away_m <= c.rtl_min_dist_m:
            height_m = min(height_m, away_m / tan(c.rtl_cone_ang_rad))
        return min(pos_ned_m[2], home[2] - height_m)
