"""Ages of measurements at their arrival: those that are too old or from the future are dropped."""

from jezero.schemas.units import NS_PER_S
from jezero.services.estimator.config import ValidityConfig

NAMED_NS = NS_PER_S
"""A late input is named for this time after its last late measurement."""


class Arrivals:
    """Decides which measurements arrive in time.

    Attributes:
        since_ns: older measurements belong to a former epoch.
        dropped: number of measurements dropped so far, for whatever reason.
    """

    def __init__(self, validity: ValidityConfig) -> None:
        self._validity = validity
        self.since_ns = 0
        self.dropped = 0
        self._late: dict[str, tuple[int, float]] = {}
        """By input: time of its last late measurement, and this measurement's age in seconds."""

    def is_timely(self, t_ns: int, measured_ns: int, name: str) -> bool:
        """Whether a measurement may be used; counts it if not.

        Args:
            name: of the input, for people.
        """
        validity = self._validity
        age_s = (t_ns - measured_ns) / NS_PER_S
        if measured_ns >= self.since_ns and -validity.max_lead_s <= age_s <= validity.max_age_s:
            return True
        self.dropped += 1
        if measured_ns >= self.since_ns:
            self._late[name] = (t_ns, age_s)
        return False

    def late_reason(self, t_ns: int, name: str) -> str:
        """What is wrong with the stamps of an input that has been late or early within the last second, or ""."""
        last_ns, age_s = self._late.get(name, (-NAMED_NS, 0.0))
        if t_ns - last_ns >= NAMED_NS:
            return ""
        if age_s < 0.0:
            return (
                f"measurements by {name} are stamped {-age_s:.2f} s in the future, {self._validity.max_lead_s:g} s are "
                "permitted (max_lead_s): check the clock of the sensor"
            )
        return (
            f"measurements by {name} arrive {age_s:.2f} s late, {self._validity.max_age_s:g} s are permitted "
            "(max_age_s): check the load of the machine, and the delay and the clock of the sensor"
        )
