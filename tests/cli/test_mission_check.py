"""`jezero mission check` without a stack: the plan is made in the command's own process, and judged."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from jezero.cli.main import main

NOBODY = ("--router", "tcp/127.0.0.1:1")
"""Address of a router that doesn't run."""


def check(tmp_path: Path, text: str, *options: str) -> Result:
    file = tmp_path / "mission.yaml"
    file.write_text(text)
    return CliRunner().invoke(main, ["mission", "check", str(file), *options, *NOBODY])


def test_a_mission_that_can_be_flown_is_planned_to_its_landing(tmp_path: Path) -> None:
    done = check(tmp_path, "steps: [{takeoff: {altitude_m: 10}}, {go_to: {target_ned_m: [200, 0, -10]}}, return_home]")
    assert done.exit_code == 0, done.output
    assert "no stack runs: planned for a full battery" in done.stdout
    home = next(line for line in done.stdout.splitlines() if "return home" in line)
    assert " 204 m," in home  # from where the step before ends


UP, AHEAD = "{takeoff: {altitude_m: 3}}", "{go_to: {target_ned_m: [9, 0, -3]}}"


@pytest.mark.parametrize(
    ("steps", "words"),
    [
        (
            f"{UP}, land_on_spot, {{go_to: {{target_ned_m: [9, 0, -3]}}}}",
            "the vehicle stands on the ground after step 2",
        ),
        (f"{UP}, {{repeat: {{times: 9, steps: [{{wait: 120}}]}}}}", "the mission would end in this step"),
    ],
)
def test_a_step_that_would_fail_is_named_and_the_command_fails(tmp_path: Path, steps: str, words: str) -> None:
    done = check(tmp_path, f"steps: [{steps}]")
    assert done.exit_code == 1
    assert f"WRONG: {words}" in done.stdout
    assert "1 of the steps would fail" in done.stderr


def test_a_wind_takes_its_charge_and_a_wrong_one_is_named(tmp_path: Path) -> None:
    text = "steps: [{takeoff: {altitude_m: 5}}, {go_to: {target_ned_m: [200, 0, -5]}}]"
    used = [
        json.loads(check(tmp_path, text, "--json", *wind).stdout)["steps"][1]["charge_used"]
        for wind in ((), ("--wind", "6", "0"))
    ]
    assert used[1] > 1.1 * used[0]
    assert check(tmp_path, text, "--wind", "nan", "0").exit_code == 2
