"""`jezero uwb`: its arguments, and a survey from ranges between anchors, which needs no vehicle."""

import json
from math import dist
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from jezero.cli.main import main
from jezero.cli.uwb import test as uwb_test
from jezero.services.uwb.statistics import statistics_of

PLACES = [(0.5, 0.5, 0.0), (0.5, -0.5, 0.0), (-0.5, -0.5, 0.6), (-0.5, 0.5, 0.0), (0.1, 0.2, -1.2)]


def run(*words: str) -> Result:
    return CliRunner().invoke(main, ["uwb", *words])


@pytest.fixture(autouse=True)
def settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    rough = [list(place) for place in PLACES[:4]] + [[0.0, 0.0, -0.8]]
    (tmp_path / "vehicle.toml").write_text(f"[uwb]\npos_anchors_rover_body_m = {rough}\n")
    monkeypatch.setenv("JEZERO_CONFIG_DIR", str(tmp_path))
    return tmp_path


def file_of(folder: Path, text: str) -> str:
    path = folder / "between.csv"
    path.write_text(text)
    return str(path)


def test_ranges_between_anchors_give_the_place_of_the_unknown_one(settings: Path) -> None:
    lines = [f"{a},{b},{dist(PLACES[a], PLACES[b]):.4f}" for a in range(5) for b in range(a)]
    between = file_of(settings, "# anchor, anchor, metres\n" + "\n".join(lines))
    known = [word for anchor in range(4) for word in ("--known", str(anchor))]
    done = run("survey", "--between", between, *known, "--json")
    assert done.exit_code == 0, done.output
    result = json.loads(done.output.splitlines()[-1])
    assert result["pos_anchors_rover_body_m"][4] == pytest.approx(PLACES[4], abs=1e-3)
    assert "pos_anchors_rover_body_m = [[0.500, 0.500, 0.000]" in run("survey", "--between", between, *known).output


@pytest.mark.parametrize("words", [(), ("--place", "1", "0", "0"), ("--known", "0", "--known", "1", "--known", "2")])
def test_a_survey_without_enough_places_that_were_measured_by_hand_says_what_it_needs(words: tuple[str, ...]) -> None:
    done = run("survey", *words)
    assert done.exit_code == 2
    assert "give 4 or more --place" in done.output


@pytest.mark.parametrize("line", ["0,0,1.0", "0,9,1.0", "0,1", "0,1,far", "0,1,-2", "0,1,nan"])
def test_a_wrong_line_of_ranges_is_named(settings: Path, line: str) -> None:
    known = ["--known", "0", "--known", "1", "--known", "2"]
    done = run("survey", "--between", file_of(settings, f"0,1,0.9\n{line}\n"), *known)
    assert done.exit_code == 2
    assert "line 2: expected two different anchors from 0 to 4" in done.output


def test_an_anchor_that_is_not_there_is_refused() -> None:
    done = run("survey", "--known", "7")
    assert done.exit_code == 2
    assert "no anchor 7" in done.output


def test_the_table_has_a_row_for_each_anchor_and_the_bias_at_a_known_place(monkeypatch: pytest.MonkeyPatch) -> None:
    at = (0.5, 0.5, -2.0)
    found = {0: statistics_of([2.1] * 50, 10_000_000_000), 4: statistics_of([1.0, 1.0, 1.5], 10_000_000_000)}
    monkeypatch.setattr("jezero.cli.uwb._measured", lambda uav, seconds: found)
    monkeypatch.setattr("jezero.cli.uwb.connected", lambda *_: _Nobody())
    done = run("test", "--at", *map(str, at))
    rows = [line.split() for line in done.output.splitlines()]
    assert rows[1] == ["0", "5.0", "2.100", "0.000", "0", "of", "50", "+0.100"]
    assert rows[2][:2] == ["1", "none"]
    assert len(rows) == 6
    assert uwb_test.name == "test"


class _Nobody:
    def __enter__(self) -> None: ...
    def __exit__(self, *_: object) -> None: ...
