"""`jezero watch` without a stack."""

import sys

import pytest
from click.testing import CliRunner

from jezero.cli.exit_codes import UNREACHABLE, USAGE
from jezero.cli.main import main
from jezero.router_address import is_loopback


def test_a_viewer_must_be_chosen() -> None:
    result = CliRunner().invoke(main, ["watch"])
    assert result.exit_code == USAGE and "--foxglove" in result.output


def test_a_missing_library_is_named_with_the_command_that_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "foxglove", None)
    result = CliRunner().invoke(main, ["watch", "--foxglove"])
    assert result.exit_code == 1
    assert "pip install 'jezero[foxglove]'" in result.output


def test_without_a_router_it_ends_with_a_sentence() -> None:
    result = CliRunner().invoke(main, ["watch", "--foxglove", "--port", "0", "--router", "tcp/127.0.0.1:1"])
    assert result.exit_code == UNREACHABLE
    assert "is the stack up?" in result.output


@pytest.mark.parametrize(
    ("host", "loopback"), [("127.0.0.1", True), ("::1", True), ("localhost", True), ("0.0.0.0", False), ("pi", False)]
)
def test_only_loopback_needs_no_warning(host: str, loopback: bool) -> None:
    assert is_loopback(host) == loopback
