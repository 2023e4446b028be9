"""Settings of the lifecycle of goals, and of pictures."""

from jezero.runtime.config import Config
from jezero.services.actions.motion.config import Positive


class LifecycleConfig(Config, frozen=True, kw_only=True):
    """Handling of a goal from its arrival to its result.

    Attributes:
        step_rate_hz: of the server's steps while nothing arrives.
    """

    step_rate_hz: Positive = 10.0


class CaptureConfig(Config, frozen=True, kw_only=True):
    """Taking pictures.

    Attributes:
        late_max_s: a goal is aborted when the picture of a planned point comes later than this after the point.
    """

    late_max_s: Positive = 2.0
