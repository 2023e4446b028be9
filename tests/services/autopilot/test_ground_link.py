"""The link to ground stations leaves this computer with signatures only, and says what is missing."""

import hashlib

import pytest

from jezero.base.config import ConfigError
from jezero.base.vehicle_config import VehicleConfig
from jezero.keys.bundle import MAVLINK_KEY
from jezero.runtime.instance import Instance
from jezero.runtime.service import Health
from jezero.services.autopilot.__main__ import build
from jezero.services.autopilot.config import AutopilotConfig, SigningConfig
from jezero.services.autopilot.ground_link import ground_host, insecurity, with_signatures
from jezero.services.autopilot.service import Autopilot
from tests.keys.rig import make_team
from tests.services.autopilot.test_service import Box

CONFIG = AutopilotConfig()
FAR = "192.168.1.20"


@pytest.fixture(autouse=True)
def nothing_set(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("JEZERO_GCS_HOST", "JEZERO_KEYS", "JEZERO_INSECURE"):
        monkeypatch.delenv(name, raising=False)


def test_on_the_loopback_nothing_changes() -> None:
    assert ground_host() == "127.0.0.1"
    assert with_signatures(CONFIG, "127.0.0.1") is CONFIG


def test_to_another_computer_the_key_is_that_of_the_bundle(
    tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    bundle = make_team(tmp_path_factory.mktemp("team")).bundle("vehicle-uav1")
    monkeypatch.setenv("JEZERO_KEYS", str(bundle))
    signing = with_signatures(CONFIG, FAR).signing
    assert signing.key == hashlib.sha256((bundle / MAVLINK_KEY).read_bytes().strip()).hexdigest()
    assert signing.links == ("gcs",)


def test_a_key_in_the_settings_goes_first_and_the_ground_link_is_always_signed() -> None:
    given = AutopilotConfig(signing=SigningConfig(key="ab" * 32, links=("offboard",)))
    signing = with_signatures(given, FAR).signing
    assert (signing.key, set(signing.links)) == ("ab" * 32, {"gcs", "offboard"})


def test_without_a_key_it_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigError, match=r"JEZERO_GCS_HOST is 192\.168\.1\.20: without signatures .* JEZERO_KEYS"):
        with_signatures(CONFIG, FAR)
    monkeypatch.setenv("JEZERO_INSECURE", "1")
    assert with_signatures(CONFIG, FAR) is CONFIG


@pytest.mark.parametrize(("host", "key", "shown"), [(FAR, "", True), (FAR, "ab" * 32, False), ("127.0.0.1", "", False)])
def test_the_health_shows_a_link_without_signatures(
    host: str, key: str, shown: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("JEZERO_INSECURE", "1")
    config = with_signatures(AutopilotConfig(signing=SigningConfig(key=key)), host)
    autopilot = Autopilot(config, VehicleConfig(), 1, insecurity=insecurity(config.signing, host))
    (health,) = [output for output in autopilot.step(0, Box()) if isinstance(output, Health)]
    assert (f"the MAVLink link to {host} is insecure" in health.text) is shown


def test_a_damaged_key_is_named(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    bundle = make_team(tmp_path_factory.mktemp("team")).bundle("vehicle-uav1")
    (bundle / MAVLINK_KEY).write_text("12ab\n")
    monkeypatch.setenv("JEZERO_KEYS", str(bundle))
    with pytest.raises(ConfigError, match=r"JEZERO_GCS_HOST: .*mavlink\.key is damaged"):
        with_signatures(CONFIG, FAR)


@pytest.mark.parametrize("given", ["laptop.local", "10.0.0.1:14550", "::1", "300.1.1.1"])
def test_anything_but_an_ipv4_address_is_refused(given: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("JEZERO_GCS_HOST", given)
    with pytest.raises(ConfigError, match="write the IPv4 address of one computer"):
        ground_host()


def test_px4_has_settings_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("JEZERO_GCS_HOST", FAR)
    monkeypatch.setenv("JEZERO_AUTOPILOT", "px4")
    with pytest.raises(ConfigError, match="PX4 has settings of its own"):
        build(Instance(), 1)


def test_the_key_is_not_in_what_recordings_keep() -> None:
    autopilot = Autopilot(AutopilotConfig(signing=SigningConfig(key="ab" * 32)), VehicleConfig(), 1)
    assert "abab" not in repr(autopilot.spec.made_with)
