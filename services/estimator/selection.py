"""What the filter is told to use: the parameters, and for a while the lease of a goal. Source: spec §7."""

from collections.abc import Iterator

import msgspec

from jezero.frames import Vec3
from jezero.schemas.estimate import Lease, LeaseReply, ParametersReply, SetParameters
from jezero.services.estimator.config import Tuning

LEASE_NS = 3_000_000_000
LIMITS: dict[str, tuple[float, float]] = {
    "std_rover_m": (0.01, 100.0),
    "std_uwb_m": (0.001, 10.0),
    "scale_std_tag": (0.1, 100.0),
    "std_altimeter_m": (0.001, 10.0),
    "std_yaw_rover_rad": (0.001, 3.0),
    "std_yaw_rate_rover_rps": (0.0001, 10.0),
    "std_speed_rover_mps": (0.001, 10.0),
    "std_tilt_rad": (0.0001, 0.5),
    "std_heading_rad": (0.0001, 1.0),
    "std_vel_uav_mps": (0.001, 5.0),
    "tau_vel_uav_s": (0.1, 1000.0),
    "psd_acc_uav_m2ps3": (0.0001, 1000.0),
    "psd_acc_rover_m2ps3": (0.0001, 1000.0),
    "rate_relative_hz": (1.0, 50.0),
}
"""Smallest and greatest value of each parameter that is a number."""


class Selection:
    """Parameters and lease.

    Attributes:
        tuning: the parameters that are numbers or switches.
        pos_rover_ned_m: the parameter; None until somebody gives it.
        version: grows by one with each change of a parameter.
    """

    def __init__(self, tuning: Tuning) -> None:
        self.tuning = tuning
        self.pos_rover_ned_m: Vec3 | None = None
        self.version = 0
        self._lease: Lease | None = None
        self._until_ns = 0

    # -- what is in force --

    @property
    def goal_id(self) -> str:
        """Of the lease, else ""."""
        return "" if self._lease is None else self._lease.goal_id

    @property
    def use_uwb(self) -> bool:
        return self.tuning.use_uwb if self._lease is None else self._lease.use_uwb

    @property
    def use_tag(self) -> bool:
        return self.tuning.use_tag if self._lease is None else self._lease.use_tag

    @property
    def rough_ned_m(self) -> Vec3 | None:
        """Where the rover roughly is; a lease that says nothing of it leaves what the parameters say."""
        if self._lease is not None and self._lease.pos_rover_ned_m is not None:
            return self._lease.pos_rover_ned_m
        return self.pos_rover_ned_m

    # -- what changes it --

    def get(self) -> ParametersReply:
        """All parameters as they are."""
        fields = msgspec.structs.asdict(self.tuning)
        parameters = SetParameters(**fields, pos_rover_ned_m=self.pos_rover_ned_m)
        return ParametersReply(accepted=True, version=self.version, parameters=parameters)

    def set(self, request: SetParameters) -> ParametersReply:
        """Change what is given, or nothing when one value is out of range."""
        given = {name: value for name, value in msgspec.structs.asdict(request).items() if value is not None}
        if refused := "; ".join(_refusals(given)):
            return ParametersReply(accepted=False, reason=refused, version=self.version, parameters=None)
        if given:
            self.pos_rover_ned_m = given.pop("pos_rover_ned_m", self.pos_rover_ned_m)
            self.tuning = msgspec.structs.replace(self.tuning, **given)
            self.version += 1
        return self.get()

    def lease(self, t_ns: int, request: Lease) -> LeaseReply:
        """Begin, renew or end a goal's own selection."""
        held = self._lease
        if held is not None and held.goal_id != request.goal_id:
            if request.release:
                return LeaseReply(accepted=True)
            left_s = max(0.0, (self._until_ns - t_ns) * 1e-9)
            return LeaseReply(accepted=False, reason=f"goal {held.goal_id} holds the lease for {left_s:.1f} s more")
        if request.release:
            self._lease = None
            return LeaseReply(accepted=True)
        if not (request.use_uwb or request.use_tag):
            return LeaseReply(accepted=False, reason="neither use_uwb nor use_tag: there is nothing to lease")
        if held is not None:
            request = msgspec.structs.replace(request, pos_rover_ned_m=held.pos_rover_ned_m)
        self._lease, self._until_ns = request, t_ns + LEASE_NS
        return LeaseReply(accepted=True, until_t_ns=self._until_ns)

    def expire(self, t_ns: int) -> None:
        """End a lease that nobody renewed."""
        if self._lease is not None and t_ns >= self._until_ns:
            self._lease = None

    def end_lease(self) -> None:
        self._lease = None


def _refusals(given: dict[str, object]) -> Iterator[str]:
    for name, value in given.items():
        if name in LIMITS and isinstance(value, int | float):
            low, high = LIMITS[name]
            if not low <= value <= high:
                yield f"{name} = {value:g} is not within {low:g} to {high:g}"
