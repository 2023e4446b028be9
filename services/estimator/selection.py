"""Inputs and parameters of the filter, and the lease by which a goal selects its own inputs. Source: spec §7."""

from collections.abc import Iterator

import msgspec
from msgspec.inspect import FloatType, StructType, type_info

from jezero.base.frames import Vec3
from jezero.schemas.estimate import Lease, LeaseReply, ParametersReply, SetParameters
from jezero.services.estimator.config import Tuning

LEASE_NS = 3_000_000_000


def _declared_limits() -> dict[str, tuple[float, float]]:
    """Range of each numeric parameter, from the fields of `Tuning`."""
    tuning = type_info(Tuning)
    assert isinstance(tuning, StructType)
    kinds = {field.name: field.type for field in tuning.fields}
    return {
        name: (kind.ge, kind.le)
        for name, kind in kinds.items()
        if isinstance(kind, FloatType) and kind.ge is not None and kind.le is not None
    }


LIMITS = _declared_limits()


class InputSelection:
    """Parameters, and the lease of a goal.

    Attributes:
        tuning: the numeric and boolean parameters.
        pos_rover_ned_m: the parameter of the rover's prior position; None until set.
        version: number of parameter changes so far.
    """

    def __init__(self, tuning: Tuning) -> None:
        self.tuning = tuning
        self.pos_rover_ned_m: Vec3 | None = None
        self.version = 0
        self._lease: Lease | None = None
        self._lease_until_ns = 0

    # -- active selection --

    @property
    def goal_id(self) -> str:
        """Goal that holds the lease, "" when there is none."""
        return "" if self._lease is None else self._lease.goal_id

    @property
    def use_uwb(self) -> bool:
        return self.tuning.use_uwb if self._lease is None else self._lease.use_uwb

    @property
    def use_tag(self) -> bool:
        return self.tuning.use_tag if self._lease is None else self._lease.use_tag

    @property
    def prior_pos_rover_ned_m(self) -> Vec3 | None:
        """Prior position of the rover: the lease's, or the parameter's when the lease has none."""
        if self._lease is not None and self._lease.pos_rover_ned_m is not None:
            return self._lease.pos_rover_ned_m
        return self.pos_rover_ned_m

    # -- requests --

    def get(self) -> ParametersReply:
        """All parameters and their version, and the lease."""
        fields = msgspec.structs.asdict(self.tuning)
        parameters = SetParameters(**fields, pos_rover_ned_m=self.pos_rover_ned_m)
        return ParametersReply(accepted=True, version=self.version, parameters=parameters, lease=self._lease)

    def set(self, request: SetParameters) -> ParametersReply:
        """Set the given parameters, or none of them when a value is out of range."""
        given = {name: value for name, value in msgspec.structs.asdict(request).items() if value is not None}
        if rejected := "; ".join(_refusals(given)):
            return ParametersReply(accepted=False, reason=rejected, version=self.version, parameters=None)
        if given:
            self.pos_rover_ned_m = given.pop("pos_rover_ned_m", self.pos_rover_ned_m)
            self.tuning = msgspec.structs.replace(self.tuning, **given)
            self.version += 1
        return self.get()

    def lease(self, t_ns: int, request: Lease) -> LeaseReply:
        """Acquire, renew or release the lease of a goal."""
        held = self._lease
        if held is not None and held.goal_id != request.goal_id:
            if request.release:
                return LeaseReply(accepted=True)
            left_s = max(0.0, (self._lease_until_ns - t_ns) * 1e-9)
            return LeaseReply(accepted=False, reason=f"goal {held.goal_id} holds the lease for {left_s:.1f} s more")
        if request.release:
            self._lease = None
            return LeaseReply(accepted=True)
        if not (request.use_uwb or request.use_tag):
            return LeaseReply(accepted=False, reason="neither use_uwb nor use_tag: there is nothing to lease")
        if held is not None:
            request = msgspec.structs.replace(request, pos_rover_ned_m=held.pos_rover_ned_m)
        self._lease, self._lease_until_ns = request, t_ns + LEASE_NS
        return LeaseReply(accepted=True, until_t_ns=self._lease_until_ns)

    def expire(self, t_ns: int) -> None:
        """End the lease when it was not renewed in time."""
        if self._lease is not None and t_ns >= self._lease_until_ns:
            self._lease = None

    def end_lease(self) -> None:
        self._lease = None


def _refusals(given: dict[str, object]) -> Iterator[str]:
    for name, value in given.items():
        if name in LIMITS and isinstance(value, int | float):
            low, high = LIMITS[name]
            if not low <= value <= high:
                yield f"{name} = {value:g} is not within {low:g} to {high:g}"
