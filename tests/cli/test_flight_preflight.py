"""`jezero preflight` against a server that replies as the preflight service."""

import json

import pytest
from click.testing import CliRunner, Result

from jezero import Vehicle
from jezero.cli.main import main
from jezero.schemas.preflight import Check, PreflightReply, PreflightReport
from jezero.schemas.topics import CHECK_PREFLIGHT
from tests.client.rig import Server, endpoint, server, vehicle

__all__ = ["endpoint", "server", "vehicle"]
PASSED = Check(name="autopilot", verdict="passed", text="its arming checks pass in mode AUTO.LOITER")
WARNING = Check(name="storage", verdict="warning", text="no recorder runs: this flight is not recorded")
FAILED = Check(name="battery", verdict="failed", text="5 %, 14.0 V; the autopilot ends a flight at 7 %: charge it")
NOT_READY = Check(name="autopilot", verdict="failed", text="no position")


def checked(server: Server, endpoint: str, *checks: Check, words: str = "") -> Result:
    report = PreflightReport(t_ns=5, epoch_id=1, checks=checks)
    server.serve(CHECK_PREFLIGHT.name, PreflightReply(report=report))
    return CliRunner().invoke(main, ["preflight", *words.split(), "--vehicle", "v", "--router", endpoint])


@pytest.mark.usefixtures("vehicle")
def test_each_check_is_a_line_and_the_last_one_says_that_the_vehicle_is_ready(server: Server, endpoint: str) -> None:
    done = checked(server, endpoint, PASSED, WARNING)
    assert done.exit_code == 0, done.output
    assert done.stdout.splitlines() == [
        "autopilot  passed   its arming checks pass in mode AUTO.LOITER",
        "storage    warning  no recorder runs: this flight is not recorded",
        "ready for a takeoff; warnings: storage",
    ]


@pytest.mark.usefixtures("vehicle")
def test_a_failed_check_exits_with_3_and_names_the_override(server: Server, endpoint: str) -> None:
    done = checked(server, endpoint, PASSED, FAILED)
    assert done.exit_code == 3
    assert done.stdout.splitlines()[-2:] == [
        "a takeoff would be refused: battery",
        "to take off all the same: jezero takeoff --override battery",
    ]


@pytest.mark.usefixtures("vehicle")
def test_no_override_is_offered_for_an_autopilot_that_would_not_arm(server: Server, endpoint: str) -> None:
    done = checked(server, endpoint, NOT_READY, FAILED)
    assert done.stdout.splitlines()[-1] == "a takeoff would be refused: autopilot, battery"


@pytest.mark.usefixtures("vehicle")
def test_with_json_the_report_is_one_line(server: Server, endpoint: str) -> None:
    done = checked(server, endpoint, PASSED, FAILED, words="--json")
    assert done.exit_code == 3
    report = json.loads(done.stdout)
    assert report["checks"][1] == {"name": "battery", "verdict": "failed", "text": FAILED.text}


def test_a_stack_without_the_service_says_so(server: Server, endpoint: str, vehicle: Vehicle) -> None:
    done = CliRunner().invoke(main, ["preflight", "--vehicle", "v", "--router", endpoint])
    assert done.exit_code == 5
    assert CHECK_PREFLIGHT.name in done.stderr
