"""Decides when a flying vehicle must turn home: while the battery still holds the way, or when the ground is silent."""

from collections.abc import Iterator

from jezero.base.vehicle_config import BatteryConfig
from jezero.runtime.service import Call, Inbox, Output
from jezero.schemas.actions import PlanReply
from jezero.schemas.goals import ReturnHomeGoal
from jezero.schemas.state import Battery, Status
from jezero.schemas.struct import RallyPoints
from jezero.schemas.topics import LAND_ON_SPOT, RETURN_HOME, STATUS, health_of
from jezero.schemas.units import NS_PER_S
from jezero.services.mission.battery_use import BatteryUse
from jezero.services.mission.config import MissionConfig

PLAN_PERIOD_NS = NS_PER_S
PLAN_TIMEOUT_S = 3.0
HALF_STEP = 0.005
"""The autopilot reports whole percents, so that half of one may be missing."""
WRONG_MIN = 0.02
"""A gauge that reports more than can be left by this is wrong: it is said."""
GROUND = health_of("ground_station")


class ReturnWatch:
    """Asks for the plan of the way home while the vehicle flies, and compares it with the battery.

    Attributes:
        reason: why the vehicle must turn home now, for people; "" while it need not.
        text: charge that is there, and charge that the way home needs, for people; "" while nobody knows.
    """

    def __init__(self, config: MissionConfig, battery: BatteryConfig) -> None:
        self.reason = ""
        self.text = ""
        self._config = config
        self._battery = battery
        self._use = BatteryUse(battery.used(1.0))
        self._duration_s: float | None = None
        """Planned duration of the way home and of the landing."""
        self._planned_use = 0.0
        """Fraction of the capacity that they take by what is known of the vehicle and of the wind."""
        self._plans = 0
        self._plan_due_ns = 0
        self._ground_ns: int | None = None
        """Time at which the ground station was last heard in this flight."""
        self._overruled = False

    def step(self, t_ns: int, inbox: Inbox, rally_points_ned_m: RallyPoints = ()) -> Iterator[Output]:
        """Ask for the plan when that is due, and judge.

        Args:
            rally_points_ned_m: of the mission that flies; none without one.
        """
        status = inbox.latest(STATUS)
        if status is None or not status.armed or status.landed:
            self._forget_flight()
            return
        if self._config.ground_loss_s and inbox.new(GROUND):
            self._ground_ns = t_ns
        if status.battery is not None and status.battery.remaining is not None:
            self._use.update(t_ns, status.battery.remaining)
        yield from self._plan(t_ns, status, inbox, rally_points_ned_m)
        comes_home = status.action in (RETURN_HOME.name, LAND_ON_SPOT.name)
        stays = comes_home or self._overruled or status.in_charge in ("external", "failsafe")
        low = self._judge_battery(status.battery)
        self.reason = "" if stays else low or self._judge_ground(t_ns)

    def goal(self, rally_points_ned_m: RallyPoints) -> ReturnHomeGoal:
        """The return, with what this flight has shown of the battery."""
        return ReturnHomeGoal(
            charge=self._use.charge, charge_per_s=self._use.per_s, rally_points_ned_m=rally_points_ned_m
        )

    def overrule(self) -> None:
        """Let the vehicle fly on until its landing: a person ended the return."""
        self._overruled = True

    def _forget_flight(self) -> None:
        self.reason = self.text = ""
        self._use.reset()
        self._duration_s = self._ground_ns = None
        self._plan_due_ns = 0  # after a restart of the vehicle its time begins anew
        self._overruled = False

    def _plan(self, t_ns: int, status: Status, inbox: Inbox, rally_points_ned_m: RallyPoints) -> Iterator[Output]:
        """Ask how long the way home takes from here."""
        for response in inbox.responses:
            reply = response.payload
            if response.tag == f"way home/{self._plans}" and isinstance(reply, PlanReply) and reply.duration_s:
                self._duration_s, self._planned_use = reply.duration_s, reply.battery_used or 0.0
        if status.odometry is None or t_ns < self._plan_due_ns or not self._config.return_when_low:
            return
        self._plan_due_ns = t_ns + PLAN_PERIOD_NS
        self._plans += 1
        goal = ReturnHomeGoal(
            issued_t_ns=t_ns, plan_from_ned_m=status.odometry.pos_uav_ned_m, rally_points_ned_m=rally_points_ned_m
        )
        yield Call(RETURN_HOME.plan, goal, f"way home/{self._plans}", PLAN_TIMEOUT_S)

    def _judge_battery(self, battery: Battery | None) -> str:
        """Reason to turn home because of the battery, or ""."""
        charge = self._use.charge
        if battery is None or battery.remaining is None or charge is None or self._duration_s is None:
            return ""
        reserve = self._battery.kept(battery.critical)
        used = max(self._duration_s * self._use.per_s, self._planned_use)
        needed = self._config.way_margin * used + reserve
        doubt = f" at most, though it reports {battery.remaining:.0%}" if battery.remaining - charge > WRONG_MIN else ""
        self.text = f"the battery has {charge:.0%}{doubt}, the way home needs {needed:.0%}"
        if charge - HALF_STEP >= needed:
            return ""
        short = charge - used < reserve
        return f"{self.text}: the vehicle returns" + (f", but less than {reserve:.0%} may be left" if short else "")

    def _judge_ground(self, t_ns: int) -> str:
        """Reason to turn home because of the ground station, or ""."""
        limit_s = self._config.ground_loss_s
        if not limit_s or self._ground_ns is None or t_ns - self._ground_ns < limit_s * NS_PER_S:
            return ""
        return f"the ground station has been silent for {limit_s:g} s: the vehicle returns"
