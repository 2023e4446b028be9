"""Vehicle time and epoch are those of one master, whoever else publishes a clock."""

from jezero.codec import encode
from jezero.runtime.epoch_filter import EPOCH_SILENT_NS, EpochFilter
from jezero.schemas.state import Clock

MS = 1_000_000


def clock(epoch_id: int) -> bytes:
    return encode(Clock(t_ns=5, epoch_id=epoch_id, wall_ns=7))


def test_a_stray_clock_and_a_flood_of_them_are_not_followed_while_the_master_is_heard() -> None:
    filtered = EpochFilter()
    for at_ms in range(0, 5000, 10):
        if at_ms % 400 == 0:  # a master at its slowest
            assert filtered.refusal(clock(1), at_ms * MS) == ""
        assert "epoch 2 while the clock of epoch 1 goes on" in filtered.refusal(clock(2), at_ms * MS)


def test_another_epoch_is_followed_as_soon_as_the_old_one_is_silent() -> None:
    filtered = EpochFilter()
    assert filtered.refusal(clock(1), 0) == ""
    assert filtered.refusal(clock(2), EPOCH_SILENT_NS - 1) != ""
    assert filtered.refusal(clock(2), EPOCH_SILENT_NS) == ""
    assert filtered.refusal(clock(1), EPOCH_SILENT_NS + 1) != ""  # a late message of the old one


def test_what_is_no_clock_changes_nothing() -> None:
    filtered = EpochFilter()
    assert filtered.refusal(b"{}", 0) == ""
    assert filtered.refusal(clock(3), 0) == ""
