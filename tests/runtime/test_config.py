"""Identity and settings from the environment: what is wrong is named."""

from pathlib import Path

import pytest

from jezero.runtime.config import Config, ConfigError, chosen_autopilot, instance_from_environment, load_config
from jezero.services.autopilot.config import AutopilotConfig


class Settings(Config, frozen=True, kw_only=True):
    speed_mps: float = 1.0


@pytest.mark.parametrize(
    ("variable", "value", "expected"),
    [
        ("JEZERO_VEHICLE", "a/b", "is 'a/b': expected 1 to 32 letters, digits, '-' and '_'"),
        ("JEZERO_ROUTER", "tcp/here", "'tcp/here' is no address of a router"),
        ("JEZERO_ROUTER", "ws/here:1", "'ws/here:1' is no address of a router"),
        (
            "JEZERO_ROUTER",
            "tls/here:1",
            "tls/here:1 needs keys: name the folder of a bundle with --keys or JEZERO_KEYS",
        ),
        ("JEZERO_ROUTER", "tcp/10.0.0.1:1", "without TLS whoever is on the network of tcp/10.0.0.1:1 could fly"),
        ("JEZERO_INSTANCE", "250", "is '250': expected `int` <= 249"),
        ("JEZERO_INSTANCE", "one", "is 'one': expected `int`"),
        ("JEZERO_GCS_PORT", "0", "is '0': expected `int` >= 1"),
    ],
)
def test_a_wrong_variable_is_named_with_its_value_and_what_is_expected(
    monkeypatch: pytest.MonkeyPatch, variable: str, value: str, expected: str
) -> None:
    monkeypatch.setenv(variable, value)
    with pytest.raises(ConfigError) as caught:
        instance_from_environment()
    assert str(caught.value).startswith(variable) and expected in str(caught.value)


def test_an_address_without_tls_leaves_this_computer_where_a_variable_permits_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("JEZERO_ROUTER", "tcp/10.0.0.1:1")
    monkeypatch.setenv("JEZERO_INSECURE", "1")
    assert instance_from_environment().router == "tcp/10.0.0.1:1"
    monkeypatch.setenv("JEZERO_INSECURE", "0")
    with pytest.raises(ConfigError, match="without TLS"):
        instance_from_environment()


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"sped_mps = 1.0", "unknown field `sped_mps`"),
        (b"speed_mps = 'fast'", "Expected `float`"),
        (b"speed_mps = ", "a.toml: "),
        (b"\xff", "a.toml: "),
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
