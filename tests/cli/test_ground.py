"""The ground station on the command line."""

import pytest

from jezero.cli import stack
from jezero.cli.stack import GROUND_STATION, _read_services, _shipped_compose_file


def test_a_stack_without_the_extra_starts_without_the_ground_station_and_says_so(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("JEZERO_GROUND", raising=False)
    monkeypatch.setattr(stack, "find_spec", lambda name: None)
    services = _read_services(_shipped_compose_file(), ())
    assert GROUND_STATION not in services
    assert "vehicle_bridge" in services
    expected = "no ground station in the browser, which is an extra: pip install 'jezero[ground]'\n"
    assert capsys.readouterr().err == expected


def test_a_stack_with_the_extra_has_the_ground_station(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("JEZERO_GROUND", raising=False)
    monkeypatch.setattr(stack, "find_spec", lambda name: object())
    assert GROUND_STATION in _read_services(_shipped_compose_file(), ())
    assert GROUND_STATION not in _read_services(_shipped_compose_file(), ("control",))
