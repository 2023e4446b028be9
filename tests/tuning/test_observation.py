"""Which innovations of a replay count."""

from pathlib import Path

import pytest

from jezero.recording import RecordingError
from jezero.tuning.observation import runs_of_files, settled
from tests.tuning.rig import an_innovation


def test_innovations_count_only_where_the_state_is_as_certain_as_usual() -> None:
    """After the start of the filter, and after a restart, it is not."""
    stds = [4.0, 1.0, 0.2, *[0.03] * 20, 4.0, *[0.03] * 20]
    innovations = [an_innovation(i, [0.0], std_state=std) for i, std in enumerate(stds)]
    kept = settled(innovations)
    assert len(kept) == 40
    assert {each.cov[0, 0] for each in kept} == {innovations[-1].cov[0, 0]}
    assert settled([]) == []


def test_files_of_one_run_count_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A stack's recording goes on in a second file; the flights of the next start are in a third one."""
    first, second, other = Path("1.mcap"), Path("2.mcap"), Path("3.mcap")
    files = {first: [first], second: [first, second], other: [other]}
    monkeypatch.setattr("jezero.tuning.observation.files_with_start", lambda path, service: files[path])
    assert runs_of_files([first, second, other, other], {}) == [second, other]


def test_a_file_without_a_journal_is_left_out_with_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    def files_with_start(path: Path, service: str) -> list[Path]:
        if path == Path("bad.mcap"):
            raise RecordingError(f"{path} has no journal of {service!r}")
        return [path]

    monkeypatch.setattr("jezero.tuning.observation.files_with_start", files_with_start)
    left_out: dict[Path, str] = {}
    assert runs_of_files([Path("bad.mcap"), Path("good.mcap")], left_out) == [Path("good.mcap")]
    assert left_out == {Path("bad.mcap"): "bad.mcap has no journal of 'estimator'"}
