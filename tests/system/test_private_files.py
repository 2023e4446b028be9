"""What a stack and a flight leave is for their user alone."""

import os
import stat
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.system.conftest import new_stack


@pytest.fixture
def open_umask() -> Iterator[None]:
    """A user whose files everybody may read and write, unless they are made otherwise."""
    before = os.umask(0)
    yield
    os.umask(before)


def open_to_others(folder: Path) -> list[str]:
    """Folders and files that others than their user can use, with their modes."""
    found = [folder, *folder.rglob("*")]
    modes = {path: stat.S_IMODE(path.stat().st_mode) for path in found}
    return [f"{path.relative_to(folder)} {mode:o}" for path, mode in modes.items() if mode & 0o077]


@pytest.mark.usefixtures("open_umask")
def test_a_stack_and_a_flight_in_it_leave_nothing_that_others_can_read(tmp_path: Path) -> None:
    with new_stack(tmp_path, whole=True) as stack:
        stack.up()
        (tmp_path / "fence.yaml").write_text("keep_in: [[-50, -50], [50, -50], [50, 50], [-50, 50]]\n")
        stack.jezero("fence", "set", str(tmp_path / "fence.yaml"))
        stack.jezero("takeoff", "2")
        images = tmp_path / "images"
        stack.jezero("getimages", "2", "0", "-2", "1", "2", "--yes", "--out", str(images))
        stack.jezero("land_on_spot", "--yes")
        assert open_to_others(stack.run_dir) == []
        stack.jezero("down")
        assert open_to_others(images) == []
        left = {str(path.relative_to(stack.run_dir)) for path in stack.run_dir.rglob("*")}
    assert open_to_others(stack.run_dir) == []
    assert {"logs", "logs/vehicle_bridge.log", "recordings", "fence.json"} <= left
