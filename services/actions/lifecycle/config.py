"""Settings of the lifecycle of goals."""

from jezero.runtime.config import Config
from jezero.services.actions.motion.config import Positive


class LifecycleConfig(Config, frozen=True, kw_only=True):
    """Handling of a goal from its arrival to its result.

    Attributes:
        step_rate_hz: steps of the server per second while no trigger arrives.
    """

    step_rate_hz: Positive = 10.0
