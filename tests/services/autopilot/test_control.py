"""Mixer and cascade against numbers worked out by hand; the settings file against its structs."""

from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from jezero.base.config import ConfigError, config_directory, load_config
from jezero.base.vehicle_config import AirframeConfig, PlanetConfig, VehicleConfig
from jezero.services.autopilot.config import AutopilotConfig, ControlConfig
from jezero.services.autopilot.control import ControlSetpoint, Kinematics, VelocityLoop, approach_speed_mps
from jezero.services.autopilot.mixer import Mixer

AIRFRAME = AirframeConfig()
HOVER = 0.5
WEIGHT_N = 1.5 * 9.81
REST = Kinematics((0.0, 0.0, -5.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0)
numbers = st.floats(-50.0, 50.0)


def wrench(commands: tuple[float, ...]) -> tuple[float, float, float, float]:
    """Thrust and torques that commands give, from the geometry alone."""
    forces = [command * WEIGHT_N / 0.5 / 4.0 for command in commands]
    rotors, moments_m = AIRFRAME.pos_rotors_frd_m, AIRFRAME.moment_per_thrust_m
    return (
        sum(forces),
        sum(-right_m * f for (_, right_m), f in zip(rotors, forces, strict=True)),
        sum(forward_m * f for (forward_m, _), f in zip(rotors, forces, strict=True)),
        sum(moment_m * f for moment_m, f in zip(moments_m, forces, strict=True)),
    )


def test_the_shipped_settings_are_the_defaults() -> None:
    assert load_config(AutopilotConfig, "autopilot", config_directory()) == AutopilotConfig()


def test_hovering_takes_half_throttle() -> None:
    commands = Mixer(VehicleConfig(), HOVER).commands(WEIGHT_N, (0.0, 0.0, 0.0))
    assert sum(commands) / 4.0 == pytest.approx(0.5)
    assert wrench(commands) == pytest.approx((WEIGHT_N, 0.0, 0.0, 0.0), abs=1e-9)


def test_the_mixer_gives_the_wrench_it_is_asked_for() -> None:
    wanted = (WEIGHT_N, 0.3, -0.2, 0.05)
    assert wrench(Mixer(VehicleConfig(), HOVER).commands(wanted[0], wanted[1:])) == pytest.approx(wanted)


@given(st.floats(0.0, 60.0), numbers, numbers, numbers)
@example(60.0, 0.0, 0.0, 0.0)
@example(14.7, 50.0, -50.0, 0.0)
@example(0.0, 1.0, 1.0, 5e-324)
def test_commands_stay_between_zero_and_one(thrust: float, roll: float, pitch: float, yaw: float) -> None:
    assert all(0.0 <= c <= 1.0 for c in Mixer(VehicleConfig(), HOVER).commands(thrust, (roll, pitch, yaw)))


def test_yaw_gives_way_before_roll_and_pitch() -> None:
    wanted = (WEIGHT_N, 1.0, 0.5, 3.0)
    thrust, roll, pitch, yaw = wrench(Mixer(VehicleConfig(), HOVER).commands(wanted[0], wanted[1:]))
    assert (thrust, roll, pitch) == pytest.approx(wanted[:3])
    assert 0.0 <= yaw < 1.0


def test_thrust_gives_way_before_roll_and_pitch() -> None:
    thrust, roll, pitch, _ = wrench(Mixer(VehicleConfig(), HOVER).commands(2.0 * WEIGHT_N, (1.0, 0.5, 0.0)))
    assert (roll, pitch) == pytest.approx((1.0, 0.5))
    assert WEIGHT_N < thrust < 2.0 * WEIGHT_N


def test_a_vehicle_at_its_setpoint_asks_for_its_weight() -> None:
    loop = VelocityLoop(ControlConfig(), PlanetConfig())
    force = loop.specific_force(0.016, REST, ControlSetpoint(pos_ned_m=(0.0, 0.0, -5.0)))
    assert force == pytest.approx((0.0, 0.0, -9.81))


def test_a_far_setpoint_is_approached_no_faster_than_the_limits() -> None:
    loop = VelocityLoop(ControlConfig(), PlanetConfig())
    assert loop.velocity_setpoint(REST, ControlSetpoint(pos_ned_m=(300.0, 400.0, -100.0))) == pytest.approx(
        (3.0, 4.0, -3.0)
    )
    assert loop.velocity_setpoint(REST, ControlSetpoint(pos_ned_m=(0.0, 0.0, 50.0)))[2] == pytest.approx(1.5)


def test_the_approach_is_proportional_near_the_point_and_brakes_at_a_constant_rate_from_afar() -> None:
    assert approach_speed_mps(0.5, 1.0, 3.0) == 0.5
    assert approach_speed_mps(3.0, 1.0, 3.0) == pytest.approx(3.0)
    assert approach_speed_mps(13.5, 1.0, 3.0) ** 2 - approach_speed_mps(12.5, 1.0, 3.0) ** 2 == pytest.approx(6.0)


@given(numbers, numbers, numbers, numbers, numbers)
def test_thrust_and_tilt_stay_within_their_limits(n: float, e: float, d: float, vn: float, vd: float) -> None:
    config = ControlConfig()
    loop = VelocityLoop(config, PlanetConfig())
    at = Kinematics((n, e, d), (vn, 0.0, vd), (0.0, 0.0, 0.0), 0.0)
    for _ in range(5):
        fn, fe, fd = loop.specific_force(0.016, at, ControlSetpoint(pos_ned_m=(0.0, 0.0, -5.0)))
        size = (fn * fn + fe * fe + fd * fd) ** 0.5
        assert size <= 2.0 * 9.81 + 1e-6
        assert fd < 0.0
        assert (fn * fn + fe * fe) ** 0.5 <= -fd * 0.7005 + 1e-6


def test_a_reset_of_the_position_moves_a_setpoint_along() -> None:
    moved = ControlSetpoint(pos_ned_m=(1.0, None, -5.0)).shifted((0.5, 9.0, 0.0))
    assert moved.pos_ned_m == (1.5, None, -5.0)


@pytest.mark.parametrize("text", ["mpc_xy_p = nan", "mpc_xy_p = -1.0", "mpc_xx_p = 1.0", 'mpc_xy_p = "high"'])
def test_a_wrong_setting_is_refused_by_name(tmp_path: Path, text: str) -> None:
    (tmp_path / "autopilot.toml").write_text(f"[control]\n{text}\n")
    with pytest.raises(ConfigError, match=r"mpc_x[xy]_p"):
        load_config(AutopilotConfig, "autopilot", tmp_path)
