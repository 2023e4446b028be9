"""Detects a vehicle that runs away from its setpoint, whatever the cause: a wrong heading, the wind, a weak rotor."""

from collections import deque
from typing import Literal, NamedTuple

from jezero.frames import Vec3, distance, horizontal
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.motion.behaviour import Move, VehicleState

DURATION_S = 2.0
"""The error must grow for this time without a break: gusts and overshoots are shorter."""
SAMPLE_NS = 200_000_000
GROWTH_MIN = 1.0
"""Least growth of the error within DURATION_S by the vehicle's own motion in calm air; m of a position, m/s of a
velocity."""
GUST_RATIO = 0.4
"""A gust, or the wind on a vehicle that has just taken off, moves it at this ratio of the wind's speed until its
autopilot has tilted it enough."""
WIND_UNKNOWN_MPS = 12.0
"""Speed of a wind that isn't known yet, as during a takeoff, and of any stronger one."""
Quantity = Literal["position", "velocity"]
_UNITS: dict[Quantity, str] = {"position": "m", "velocity": "m/s"}


class _Sample(NamedTuple):
    """State of the vehicle and its setpoint at one time.

    Attributes:
        quantity: that is commanded.
        setpoint: commanded value.
        actual: value of the vehicle.
        wind_mps: speed of the wind in its gusts.
        leads_back: the command points from the vehicle to the setpoint.
    """

    t_ns: int
    quantity: Quantity
    setpoint: Vec3
    actual: Vec3
    wind_mps: float
    leads_back: bool

    @property
    def error(self) -> float:
        return distance(self.setpoint, self.actual)


class RunawayDetector:
    """Compares a goal's setpoints with what the vehicle makes of them.

    A vehicle runs away when for two seconds its error grows in every sample, by its own motion and not by that of the
    setpoint, although the command leads it back, and not slower at the end than at the beginning. So one that brakes
    after a takeover, or is left behind by a platform, doesn't run away.
    """

    def __init__(self) -> None:
        self._samples: deque[_Sample] = deque()
        self._growths: deque[float] = deque()
        """Growth of the error by the vehicle's own motion up to each sample but the first."""

    def problem(self, t_ns: int, state: VehicleState, move: Move) -> str:
        """Add the newest state and setpoint; returns the reason why the goal must end, or ""."""
        newest = _sample(t_ns, state, move)
        if newest is None or not state.armed or state.landed:
            self._clear()
            return ""
        if self._samples:
            last = self._samples[-1]
            if newest.quantity == last.quantity and t_ns - last.t_ns < SAMPLE_NS:
                return ""
            growth = distance(last.setpoint, newest.actual) - last.error
            grows = growth > 0.0 and newest.error > last.error and newest.leads_back
            if newest.quantity != last.quantity or not grows:
                self._clear()
            else:
                self._growths.append(growth)
        self._samples.append(newest)
        return self._judge()

    def _judge(self) -> str:
        """Judge the samples of the last two seconds, in each of which the error has grown."""
        first, last = self._samples[0], self._samples[-1]
        if last.t_ns - first.t_ns < DURATION_S * NS_PER_S:
            return ""
        growths, error_growth = list(self._growths), last.error - first.error
        half = len(growths) // 2
        self._samples.popleft()
        self._growths.popleft()
        grown, slows_down = min(error_growth, sum(growths)), sum(growths[-half:]) < sum(growths[:half])
        # The wind before the error began to grow: the estimate takes the effects of a wrong heading for wind.
        blown_mps = GUST_RATIO * first.wind_mps
        blown = blown_mps * DURATION_S if last.quantity == "position" else blown_mps
        if grown < GROWTH_MIN + blown or slows_down:
            return ""
        unit, duration_s = _UNITS[last.quantity], (last.t_ns - first.t_ns) / NS_PER_S
        return (
            f"the vehicle runs away from its setpoint: its {last.quantity} is {last.error:.1f} {unit} off, and the "
            f"error grew by {grown:.1f} {unit} in {duration_s:.1f} s against the command; check the compass (iron or "
            "currents nearby, its calibration), then GNSS, the rotors and the wind"
        )

    def _clear(self) -> None:
        self._samples.clear()
        self._growths.clear()


def _sample(t_ns: int, state: VehicleState, move: Move) -> _Sample | None:
    """State and setpoint of the quantity that the move commands; None when it commands nothing."""
    wind_mps = WIND_UNKNOWN_MPS
    if state.wind_ned_mps is not None:
        wind_mps = min(horizontal(state.wind_ned_mps) + (state.std_gust_mps or 0.0), WIND_UNKNOWN_MPS)
    if move.pos_ned_m is not None:
        return _Sample(t_ns, "position", move.pos_ned_m, state.pos_uav_ned_m, wind_mps, leads_back=True)
    if move.vel_ned_mps is None:
        return None
    if move.target_ned_m is None:
        return _Sample(t_ns, "velocity", move.vel_ned_mps, state.vel_uav_ned_mps, wind_mps, leads_back=True)
    # Only horizontally: a landing descends on purpose while it waits beside its target.
    (north_m, east_m, _), (to_north_m, to_east_m, _) = state.pos_uav_ned_m, move.target_ned_m
    north_mps, east_mps, _ = move.vel_ned_mps
    leads_back = (to_north_m - north_m) * north_mps + (to_east_m - east_m) * east_mps > 0.0
    return _Sample(t_ns, "position", (to_north_m, to_east_m, 0.0), (north_m, east_m, 0.0), wind_mps, leads_back)
