"""Worlds: files that change settings, and gravity and air of a world in every service that needs them."""

from math import hypot, tan
from pathlib import Path

import pytest

from jezero.base.config import ConfigError, config_directory, find_world, known_worlds, load_config
from jezero.base.frames import quat_from_euler
from jezero.base.vehicle_config import PlanetConfig, VehicleConfig, px4_refusal
from jezero.services.actions.config import load_actions_config
from jezero.services.actions.land_on_spot.contact import TOUCHED_MPS, ContactWatcher
from jezero.services.autopilot.config import AutopilotConfig, ControlConfig
from jezero.services.autopilot.control import ControlSetpoint, Kinematics, VelocityLoop
from jezero.services.autopilot.mixer import Mixer
from jezero.services.simulator.config import SimulatorConfig
from jezero.services.simulator.sensors import altitude_pressure_m, pressure_pa
from jezero.services.table import SERVICES, resolve
from jezero.services.vehicle_bridge.config import VehicleBridgeConfig
from jezero.services.vehicle_bridge.motion_limits import Wall
from jezero.services.vehicle_bridge.wind_estimator import wind_ned_mps

MARS = PlanetConfig(gravity_mps2=3.71, density_air_kgpm3=0.0155, pressure_datum_pa=560.0, scale_height_m=11_100.0)
REST = Kinematics((0.0, 0.0, -5.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0)
STILL = (0.0, 0.0, 0.0)


@pytest.fixture
def settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of settings with two files, which is in force."""
    (tmp_path / "simulator.toml").write_text("[wind]\nmean_mps = 2.0\nfrom_deg = 90.0\n")
    (tmp_path / "vehicle.toml").write_text("[airframe]\nmass_kg = 2.5\n")
    (tmp_path / "worlds").mkdir()
    monkeypatch.setenv("JEZERO_CONFIG_DIR", str(tmp_path))
    return tmp_path


def world(folder: Path, text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    file = folder / "worlds" / "moon.toml"
    file.write_text(text)
    monkeypatch.setenv("JEZERO_WORLD", "moon")


# -- the files -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", sorted(known_worlds()))
def test_a_shipped_world_fits_the_settings_of_every_service(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("JEZERO_WORLD", name)
    for row in SERVICES:
        if row.settings:
            load_config(resolve(row.settings), row.name)
    assert load_actions_config().vehicle == load_config(VehicleConfig, "vehicle")


def test_a_world_changes_what_it_names_and_nothing_else(settings: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    world(settings, "[simulator.wind]\nmean_mps = 0.5\n[vehicle.planet]\ngravity_mps2 = 1.62\n", monkeypatch)
    wind = load_config(SimulatorConfig, "simulator").wind
    assert (wind.mean_mps, wind.from_deg) == (0.5, 90.0)
    vehicle = load_config(VehicleConfig, "vehicle")
    assert (vehicle.airframe.mass_kg, vehicle.planet.gravity_mps2) == (2.5, 1.62)


def test_a_world_may_be_any_file(settings: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = settings / "own.toml"
    file.write_text("[simulator.wind]\nmean_mps = 0.25\n")
    monkeypatch.setenv("JEZERO_WORLD", str(file))
    assert load_config(SimulatorConfig, "simulator").wind.mean_mps == 0.25


def test_a_folder_of_settings_that_is_named_has_no_world(settings: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    world(settings, "[simulator.wind]\nmean_mps = 0.5\n", monkeypatch)
    assert load_config(SimulatorConfig, "simulator", settings).wind.mean_mps == 2.0


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[simulater.wind]\nmean_mps = 0.5", "there is no file of settings 'simulater'; did you mean 'simulator'?"),
        ("simulator = 3", "simulator must be a table"),
        ("[simulator.wind]\nmean_mp = 0.5", "wind: there is no setting 'mean_mp'"),
        ("[simulator.wind]\nmean_mps = -0.5", "wind.mean_mps"),
        ("[simulator", "moon.toml: "),
    ],
)
def test_a_mistake_in_a_world_is_named(settings: Path, monkeypatch: pytest.MonkeyPatch, text: str, reason: str) -> None:
    world(settings, text, monkeypatch)
    with pytest.raises(ConfigError, match=r"moon\.toml") as caught:
        load_config(SimulatorConfig, "simulator")
    assert reason in str(caught.value)


def test_a_world_that_does_not_exist_is_refused_with_the_nearest_name() -> None:
    with pytest.raises(ConfigError, match="there is no world 'mras'; did you mean 'mars'"):
        find_world("mras")
    with pytest.raises(ConfigError, match=r"nowhere.toml is no file.*mars"):
        find_world("nowhere.toml")


# -- Mars ------------------------------------------------------------------------------------------------


def test_px4_is_refused_where_the_gravity_is_another_one() -> None:
    assert px4_refusal(VehicleConfig()) == ""
    assert "here it is 3.71 m/s²" in px4_refusal(VehicleConfig(planet=MARS))


def test_the_thrust_of_the_autopilot_is_that_of_the_simulated_vehicle(monkeypatch: pytest.MonkeyPatch) -> None:
    """Otherwise every change of the thrust would be too large, or too small."""
    for name in ("", *known_worlds()):
        monkeypatch.setenv("JEZERO_WORLD", name)
        control = load_config(AutopilotConfig, "autopilot").control
        uav = load_config(SimulatorConfig, "simulator").uav
        assert control.mpc_thr_hover * uav.thrust_to_weight == pytest.approx(1.0, abs=1e-3)


def test_the_bridge_sets_no_other_gains_than_those_of_the_world(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("JEZERO_WORLD", "mars")
    parameters = load_config(VehicleBridgeConfig, "vehicle_bridge").parameters
    control = load_config(AutopilotConfig, "autopilot").control
    assert parameters["MPC_XY_VEL_P_ACC"] == control.mpc_xy_vel_p_acc
    assert parameters["MPC_XY_VEL_I_ACC"] == control.mpc_xy_vel_i_acc


def test_no_action_accelerates_more_than_the_greatest_tilt_allows(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("JEZERO_WORLD", "mars")
    vehicle, actions = load_config(VehicleConfig, "vehicle"), load_actions_config()
    tilt_rad = load_config(AutopilotConfig, "autopilot").control.mpc_tiltmax_air_rad
    greatest_mps2 = 3.71 * tan(tilt_rad)
    wanted_mps2 = (
        actions.move.accel_mps2,
        actions.tracking.acceleration_max_mps2,
        actions.get_images.acceleration_mps2,
        actions.get_images.inwards_max_mps2,
        actions.area_coverage.acceleration_mps2,
        actions.land_on_spot.rover.platform_control.deceleration_mps2,
        vehicle.limits.braking_mps2,
    )
    assert all(0.0 < wanted < 0.75 * greatest_mps2 for wanted in wanted_mps2)


def test_hovering_takes_the_weight_of_the_planet() -> None:
    force = VelocityLoop(ControlConfig(), MARS).specific_force(0.016, REST, ControlSetpoint((0.0, 0.0, -5.0)))
    assert force == pytest.approx((0.0, 0.0, -3.71))
    vehicle = VehicleConfig(planet=MARS)
    assert Mixer(vehicle, 0.5).thrust_full_n == pytest.approx(2.0 * 1.5 * 3.71)


def test_the_wind_follows_from_drag_in_the_air_of_the_planet() -> None:
    vehicle = VehicleConfig(planet=MARS)
    drag_n = vehicle.drag_n(4.0)
    assert drag_n == pytest.approx(0.45 * 4.0 + 0.5 * 0.0155 * 0.06 * 16.0)
    tilt_sine = drag_n / hypot(drag_n, 1.5 * 3.71)  # a hover that leans north against a wind from there
    q = quat_from_euler(0.0, -tilt_sine, 0.0)
    wind = wind_ned_mps(STILL, STILL, q, vehicle)
    assert wind is not None
    assert abs(wind[0]) == pytest.approx(4.0, rel=0.1)


def test_a_contact_takes_no_more_than_the_share_of_the_thrust_that_it_takes_on_earth() -> None:
    pushes = [ContactWatcher(0.3, planet) for planet in (PlanetConfig(), MARS)]
    for push in pushes:
        push.begin(0, (0.05, 0.0))
    earth, mars = (push.push_acc_ned_mps2(0.5 * TOUCHED_MPS) for push in pushes)
    assert earth[2] == 5.0
    assert mars == pytest.approx([each * 3.71 / 9.81 for each in earth])


def test_a_wall_is_approached_as_fast_as_the_vehicle_can_brake() -> None:
    wall = Wall((1.0, 0.0, 0.0), 8.4, 0.5, "the fence")
    assert wall.speed_max_mps == pytest.approx(2.8284, abs=1e-3)


def test_the_pressure_falls_as_the_scale_height_says() -> None:
    assert pressure_pa(0.0, MARS) == 560.0
    assert pressure_pa(11_100.0, MARS) == pytest.approx(560.0 / 2.718281828)
    assert altitude_pressure_m(pressure_pa(-2570.0, MARS), MARS) == pytest.approx(-2570.0)


def test_settings_without_a_world_are_the_earths() -> None:
    assert load_config(VehicleConfig, "vehicle", config_directory()).planet == PlanetConfig()
