"""When the status is published: ten times a second, at once when it changes, and first with the first telemetry."""

from typing import Any

import pytest

from jezero.runtime.service import Publish
from jezero.schemas.commands import Abort, Hover, Phase
from jezero.schemas.topics import ABORT, HOVER, STATUS
from tests.services.vehicle_bridge.rig import MODES, Rig


def published(rig: Rig) -> int:
    """Number of statuses of one step."""
    rig.outputs.clear()
    rig.step()
    return sum(isinstance(output, Publish) and output.topic is STATUS for output in rig.outputs)


def test_an_unchanged_status_is_published_ten_times_a_second() -> None:
    rig = Rig().fly()
    rig.statuses.clear()
    rig.run(2.0)
    assert len(rig.statuses) == 20


@pytest.mark.parametrize(
    ("name", "value"), [("mode", MODES["POSCTL"]), ("landed", True), ("armed", False)], ids=["mode", "landed", "armed"]
)
def test_what_the_autopilot_reports_anew_is_published_at_once(name: str, value: Any) -> None:
    rig = Rig().fly()
    while published(rig):
        pass
    assert published(rig) == 0
    before = rig.status
    setattr(rig.autopilot, name, value)
    assert published(rig) >= 1
    after = rig.status
    assert (after.autopilot_mode, after.landed, after.armed) != (before.autopilot_mode, before.landed, before.armed)
    rig.run(0.04)
    assert published(rig) == 0, "and then again every tenth of a second"


def test_a_new_code_is_published_once_in_its_step() -> None:
    rig = Rig().fly()
    rig.go("go_to", Phase.GO_TO)
    rig.run(0.04)
    rig.post(ABORT, Abort())
    assert published(rig) == 1
    assert rig.status.code == 12
    assert published(rig) == 0


def test_the_first_status_comes_with_the_first_telemetry_and_without_it_after_a_second_and_a_half() -> None:
    rig = Rig()
    rig.box.wall_ns = 3_600_000_000_000
    rig.run(0.06)
    assert rig.statuses
    rig = Rig()
    rig.box.wall_ns = 3_600_000_000_000
    rig.autopilot.silent = True
    rig.run(1.4)
    assert not rig.statuses
    rig.run(0.2)
    assert rig.status.code == 0 and not rig.status.ready


def test_a_status_with_a_long_reason_of_a_client_still_fits() -> None:
    rig = Rig().fly()
    rig.go("go_to", Phase.GO_TO)
    rig.post(ABORT, Abort(reason="x" * 2000))
    rig.step()  # the rig decodes each status
    assert rig.status.text.startswith("the goal go to aborted on request: xxx")
    assert len(rig.status.text) == 2000


def test_vehicle_time_goes_on_by_the_autopilot_when_the_bus_is_cut_off() -> None:
    """The clock on the bus stands still, and time-outs count all the same."""
    rig = Rig().fly()
    rig.go("go_to", Phase.GO_TO)

    def cut_off() -> None:
        rig.ahead_ns -= 20_000_000

    rig.run(1.3, cut_off)
    assert rig.codes[-3:] == [4, 12, 3]
    assert abs(rig.status.t_ns - rig.t_ns) <= 100_000_000
    rig.post(HOVER, Hover())
    rig.run(0.1, cut_off)
    assert rig.status.text == "hovering here"


def test_odometry_and_status_name_the_epoch_of_the_vehicle() -> None:
    rig = Rig().ready()
    rig.run(0.2)
    assert rig.odometry[-1].epoch_id == rig.status.epoch_id == rig.epoch_id
