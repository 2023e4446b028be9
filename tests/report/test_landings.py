"""What a report takes from a log, with logs made by hand."""

from pathlib import Path

import numpy as np
import pytest

from jezero.base.codec import encode
from jezero.cli.demonstration import pointing_to
from jezero.cli.terminal import Printer
from jezero.recording import Entry
from jezero.recording.writer import RECORDING, RecordingWriter
from jezero.report.landings import Series, landings
from jezero.report.report import draw_report
from jezero.schemas import topics
from jezero.schemas.actions import FeedbackMessage
from jezero.schemas.goals import LandFeedback, LandPhase
from jezero.schemas.state import Odometry, Status, StatusCode

S = 1_000_000_000
HERE = (1.0, 2.0, -3.0)


def status(t_s: float, code: StatusCode) -> Entry:
    flies = code not in (StatusCode.IDLE, StatusCode.LANDING_DONE)
    message = Status(
        t_ns=int(t_s * S),
        code=int(code),
        name=code.name,
        armed=flies,
        landed=not flies,
        in_charge="goal",
        bridge_boot_id=1,
        ready=True,
    )
    return Entry(message.t_ns, topics.STATUS.name, message)


def feedback(t_s: float, phase: LandPhase) -> Entry:
    topic = topics.feedback_of(topics.LAND_ON_SPOT)
    content = LandFeedback(pos_uav_ned_m=HERE, phase=phase)
    message = FeedbackMessage(t_ns=int(t_s * S), goal_id="g", action="land_on_spot", code=8, feedback=content)
    return Entry(message.t_ns, topic.name, message)


def odometry(t_s: float) -> Entry:
    message = Odometry(
        t_ns=int(t_s * S),
        epoch_id=1,
        pos_uav_ned_m=HERE,
        vel_uav_ned_mps=(0.0, 0.0, 0.0),
        q_ned_from_frd=(1.0, 0.0, 0.0, 0.0),
        rates_uav_frd_rps=(0.0, 0.0, 0.0),
    )
    return Entry(message.t_ns, topics.ODOMETRY.name, message)


TWO = [
    status(1.0, StatusCode.HOVER),
    status(2.0, StatusCode.LANDING),
    feedback(2.1, "approach"),
    feedback(2.5, "descent"),
    feedback(2.7, "descent"),
    odometry(2.8),
    status(3.0, StatusCode.ABORT),
    status(4.0, StatusCode.HOVER),
    status(5.0, StatusCode.LANDING),
    feedback(5.1, "contact"),
    odometry(5.5),
    odometry(5.6),
    status(6.0, StatusCode.LANDING_DONE),
    status(6.5, StatusCode.IDLE),
]


def test_every_landing_of_a_log_counts_the_aborted_too() -> None:
    aborted, done = landings(TWO)
    assert aborted.disarmed_s is None
    assert aborted.phases == (("approach", 0.0, 0.5), ("descent", 0.5, 1.0))
    assert done.disarmed_s == 1.0
    assert done.phases == (("contact", 0.0, 1.0),)
    assert not done.by_estimate


def test_a_landing_that_the_log_breaks_off_in_ends_with_it() -> None:
    (landing,) = landings([*TWO[:4], status(2.6, StatusCode.LANDING)])
    approach, descent = landing.phases
    assert approach == ("approach", 0.0, 0.5)
    assert descent[:2] == ("descent", 0.5) and descent[2] == pytest.approx(0.6)
    assert landing.end_s == pytest.approx(0.6)
    (landing,) = landings(TWO[:2])
    assert landing.phases == () and landing.end_s == 0.0


def test_the_figures_of_a_second_landing_have_a_name_of_their_own(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / RECORDING, {}) as writer:
        for entry in TWO:
            writer.write(entry.logged_ns, entry.topic, encode(entry.message))
    files = draw_report([tmp_path / RECORDING])
    assert {file.name for file in files} == {
        "position.png", "status.png", "landing_odometry.png", "landing_odometry_2.png",
    }  # fmt: skip


def test_a_demonstration_that_fails_says_where_its_log_is(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    with pytest.raises(SystemExit), pointing_to(Printer(False), tmp_path):
        raise SystemExit(4)
    assert f"`jezero report {tmp_path}` draws the recording" in capsys.readouterr().out


def test_a_descent_goes_down_in_every_figure_of_a_landing() -> None:
    ned_m = Series(np.array([0.0, 1.0]), np.array([[1.0, 2.0, -3.0, 1.0], [1.0, 2.0, -0.5, 0.0]]))
    assert ned_m.upwards().values.tolist() == [[1.0, 2.0, 3.0, 1.0], [1.0, 2.0, 0.5, 0.0]]
    assert ned_m.values[0, 2] == -3.0
