"""Settings from files: what is wrong is named."""

from pathlib import Path

import pytest

from jezero.base.config import Config, ConfigError, chosen_autopilot, load_config
from jezero.services.autopilot.config import AutopilotConfig


class Settings(Config, frozen=True, kw_only=True):
    speed_mps: float = 1.0


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"sped_mps = 1.0", "there is no setting 'sped_mps'; did you mean 'speed_mps'?"),
        (b"speed_mps = 'fast'", "speed_mps: expected a number, not a text"),
        (b"speed_mps = ", "a.toml: "),
        (b"\xff", "a.toml is no text in UTF-8: save it as UTF-8"),
        (None, "a.toml: Is a directory"),
    ],
)
def test_a_file_that_holds_no_settings_is_named(tmp_path: Path, content: bytes | None, reason: str) -> None:
    file = tmp_path / "a.toml"
    if content is None:
        file.mkdir()
    else:
        file.write_bytes(content)
    with pytest.raises(ConfigError, match=str(file)) as caught:
        load_config(Settings, "a", tmp_path)
    assert reason in str(caught.value)


@pytest.mark.parametrize(
    ("variable", "content", "expected"),
    [
        ("", "", AutopilotConfig().autopilot),
        ("", 'autopilot = "px4"\ncharge_at_start = 0.5', "px4"),
        ("embedded", 'autopilot = "px4"', "embedded"),
        ("px4", "", "px4"),
    ],
)
def test_the_autopilot_is_that_of_the_environment_or_else_of_its_settings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, variable: str, content: str, expected: str
) -> None:
    (tmp_path / "autopilot.toml").write_text(content)
    monkeypatch.setenv("JEZERO_CONFIG_DIR", str(tmp_path))
    monkeypatch.setenv("JEZERO_AUTOPILOT", variable)
    assert chosen_autopilot() == expected


def test_an_autopilot_that_does_not_exist_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("JEZERO_AUTOPILOT", "ardupilot")
    with pytest.raises(ConfigError, match='JEZERO_AUTOPILOT is "ardupilot", expected "embedded" or "px4"'):
        chosen_autopilot()
