"""Settings of the lifecycle of goals, and of pictures."""

from jezero.runtime.config import Config
from jezero.services.actions.motion.config import Positive


class LifecycleConfig(Config, frozen=True, kw_only=True):
    """Handling of a goal from its arrival to its result.

    Attributes:
        expiry_s: older goals are refused.
        status_age_max_s: an older status counts as lost.
        odometry_age_max_s: an older odometry counts as lost.
        altimeter_age_max_s: an older altimeter reading counts as lost.
        estimate_age_max_s: older estimates count as lost.
        check_timeout_s: until all inputs have come, for a goal whose inputs are checked before it is accepted.
        prepare_timeout_s: for the preparation of a goal before it is accepted.
        acquire_timeout_s: for the bridge's reply.
        release_hover_timeout_s: for one reply to a release that hovers; the release is sent again after it.
        release_disarm_timeout_s: for one reply to a release that disarms; the release is sent again after it.
        release_give_up_s: after this a goal ends without the bridge's reply.
        step_rate_hz: of the server's steps while nothing arrives.
        setpoint_rate_hz: of setpoints while a goal runs.
        feedback_rate_hz: of feedback while a goal runs.
    """

    expiry_s: Positive = 30.0
    status_age_max_s: Positive = 1.0
    odometry_age_max_s: Positive = 0.5
    altimeter_age_max_s: Positive = 0.3
    estimate_age_max_s: Positive = 0.3
    check_timeout_s: Positive = 1.5
    prepare_timeout_s: Positive = 20.0
    acquire_timeout_s: Positive = 1.0
    release_hover_timeout_s: Positive = 6.0
    release_disarm_timeout_s: Positive = 12.0
    release_give_up_s: Positive = 20.0
    step_rate_hz: Positive = 10.0
    setpoint_rate_hz: Positive = 50.0
    feedback_rate_hz: Positive = 10.0


class CaptureConfig(Config, frozen=True, kw_only=True):
    """Taking pictures.

    Attributes:
        late_max_s: a goal is aborted when the picture of a planned point comes later than this after the point.
        history_s: measurements are kept for this duration, to be there when the picture comes; older pictures are
            dropped.
        sensor_age_max_s: a measurement belongs to a picture when it was made at most this before or after the exposure.
    """

    late_max_s: Positive = 2.0
    history_s: Positive = 2.0
    sensor_age_max_s: Positive = 0.3
