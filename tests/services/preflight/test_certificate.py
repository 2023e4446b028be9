"""The end of this computer's certificate is said two weeks before."""

from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from jezero.keys.team import Team
from jezero.services.preflight.certificate import certificate_problem
from jezero.services.preflight.checks import check_services
from tests.services.preflight.healthy import readings

NOW = datetime.now(UTC)


@pytest.mark.parametrize(("days", "words"), [(0, ""), (80, ""), (88, "ends on "), (101, "has ended on ")])
def test_a_certificate_that_ends_soon_or_has_ended_is_a_warning(days: int, words: str, tmp_path: Path) -> None:
    team = Team(tmp_path / "team")
    team.found()
    team.add("vehicle", "uav1", hosts=("127.0.0.1",), days=100)
    problem = certificate_problem(str(team.bundle("vehicle-uav1")), NOW + timedelta(days=days))
    assert bool(problem) == bool(words)
    assert words in problem
    if words:
        assert "jezero keys renew vehicle-uav1" in problem
        check = check_services(readings(keys_problem=problem))
        assert check.verdict == "warning" and problem in check.text


def test_without_keys_nothing_ends_and_a_missing_certificate_is_named(tmp_path: Path) -> None:
    assert certificate_problem(None, NOW) == certificate_problem("", NOW) == ""
    assert "certificate.pem" in certificate_problem(str(tmp_path), NOW)
