"""What the estimator tells an observer about its innovations, in a flight without physics."""

from collections.abc import Iterator

import numpy as np
import pytest

from benchmarks.quality.estimator_flight import Conditions, EstimatorFlight
from jezero.base.vehicle_config import VehicleConfig
from jezero.runtime.node import Mailbox
from jezero.runtime.service import Publish
from jezero.schemas import topics
from jezero.schemas.estimate import Relative
from jezero.services.estimator.config import EstimatorConfig, Tuning
from jezero.services.estimator.innovations import Innovation, Observer, Sensor
from jezero.services.estimator.service import Estimator

END_NS = 10_000_000_000


def estimates(observer: Observer | None, tuning: Tuning) -> Iterator[Relative]:
    """Estimates of a flight over a rover that drives."""
    estimator = Estimator(EstimatorConfig(tuning=tuning), VehicleConfig())
    if observer is not None:
        estimator.observe_innovations(observer)
    inbox = Mailbox(())
    for t_ns, topic, message in EstimatorFlight(1, Conditions(speed_mps=0.5)).arrivals():
        if t_ns > END_NS:
            break
        inbox.add_message(topic.name, message)
        if topic is topics.ODOMETRY:
            for output in estimator.step(t_ns, inbox):
                if isinstance(output, Publish) and isinstance(output.message, Relative):
                    yield output.message
            inbox.clear()


def innovations(tuning: Tuning) -> dict[tuple[Sensor, int], Innovation]:
    """The last innovation of each measurement."""
    found: dict[tuple[Sensor, int], Innovation] = {}

    def keep(each: Innovation) -> None:
        found[each.sensor, each.t_ns] = each

    assert list(estimates(keep, tuning))
    return found


@pytest.fixture(scope="module")
def observed() -> dict[tuple[Sensor, int], Innovation]:
    return innovations(Tuning())


def test_an_observer_changes_no_estimate() -> None:
    seen: list[Innovation] = []
    assert list(estimates(seen.append, Tuning())) == list(estimates(None, Tuning()))
    assert seen


def test_every_sensor_is_observed(observed: dict[tuple[Sensor, int], Innovation]) -> None:
    assert {sensor for sensor, _ in observed} == {
        "uwb", "tag", "tag_yaw", "altimeter", "rover_yaw", "rover_yaw_rate", "rover_speed", "autopilot_position",
        "autopilot_velocity",
    }  # fmt: skip


def test_position_and_velocity_of_the_autopilot_are_observed_apart(
    observed: dict[tuple[Sensor, int], Innovation],
) -> None:
    sizes = {sensor: len(each.residual) for (sensor, _), each in observed.items()}
    assert (sizes["autopilot_position"], sizes["autopilot_velocity"]) == (3, 3)


def test_the_predicted_covariance_is_that_of_the_state_and_of_the_noise(
    observed: dict[tuple[Sensor, int], Innovation],
) -> None:
    for each in observed.values():
        size = len(each.residual)
        assert each.cov.shape == each.cov_noise.shape == (size, size) and each.accepted.shape == (size,)
        assert float(np.linalg.eigvalsh(each.cov - each.cov_noise).min()) > -1e-9
        assert float(np.linalg.eigvalsh(each.cov_noise).min()) > 0.0


@pytest.mark.parametrize(
    ("sensor", "setting", "factor"),
    [
        ("uwb", "std_uwb_m", 3.0),
        ("tag", "scale_std_tag", 3.0),
        ("tag_yaw", "scale_std_tag", 3.0),
        ("altimeter", "std_altimeter_m", 2.0),
        ("rover_yaw", "std_yaw_rover_rad", 2.0),
        ("rover_yaw_rate", "std_yaw_rate_rover_rps", 2.0),
    ],
)
def test_the_noise_is_proportional_to_the_square_of_the_setting(
    sensor: Sensor, setting: str, factor: float, observed: dict[tuple[Sensor, int], Innovation]
) -> None:
    value = factor * getattr(Tuning(), setting)
    changed = innovations(Tuning(**{setting: value}))
    both = [key for key in observed if key[0] == sensor and key in changed]
    assert len(both) > 50
    for key in both:
        before, after = observed[key], changed[key]
        assert before.setting is not None and after.setting is not None
        assert after.setting == pytest.approx(value)
        assert after.cov_noise == pytest.approx((after.setting / before.setting) ** 2 * before.cov_noise)
