"""A fence that was set lives as long as the stack, not as the bridge's process."""

from pathlib import Path

import pytest

from jezero.schemas.fence import Fence, SetFence, Zone
from jezero.services.vehicle_bridge.kept_fence import kept_fence_path, load, save

FENCE = Fence(keep_in=Zone(name="field", corners_ned_m=((0.0, 0.0), (9.0, 0.0), (0.0, 9.0))), ceiling_m=10.0)


@pytest.mark.parametrize("fence", [FENCE, None])
def test_a_kept_fence_is_read_again_also_that_there_is_none(tmp_path: Path, fence: Fence | None) -> None:
    path = tmp_path / "fence.json"
    assert load(path) is None
    save(path, fence)
    assert load(path) == SetFence(fence=fence)


@pytest.mark.parametrize(("folder", "name"), [("/tmp/run", "/tmp/run/fence.json"), ("", None)])
def test_the_fence_is_kept_in_the_run_folder(folder: str, name: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("JEZERO_RUN_DIR", folder)
    assert kept_fence_path() == (None if name is None else Path(name))


def test_a_file_that_is_no_fence_is_left_out_with_a_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "fence.json"
    path.write_text("{")
    assert load(path) is None
    assert f"the fence in {path} can't be read and is left out" in capsys.readouterr().err
    save(tmp_path / "missing" / "fence.json", FENCE)
    assert "the fence can't be kept over a restart" in capsys.readouterr().err
