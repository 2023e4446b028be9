"""The simulator interface speaks PX4's units and bits."""

from typing import Any

import pytest

from jezero.base.mavlink import MavlinkCodec, dialect
from jezero.base.vehicle_config import AltimeterMountConfig
from jezero.schemas.sensors import Altimeter, Barometer, Gnss, Magnetometer
from jezero.services.simulator.hil import HilPort

T_NS = 1_234_568_000


def decoded(data: bytes) -> Any:
    (message,) = MavlinkCodec(1, 1).parse(data)
    return message


def controls(values: list[float], mode: int = 129) -> bytes:
    message = dialect.MAVLink_hil_actuator_controls_message(5000, values + [0.0] * (16 - len(values)), mode, 1)
    return MavlinkCodec(1, 1).pack(message)


def test_an_imu_sample_updates_six_fields() -> None:
    message = decoded(HilPort().sensor(T_NS, (0.1, 0.2, -9.81), (0.01, -0.02, 0.03), None, None))
    assert message.get_msgId() == dialect.MAVLINK_MSG_ID_HIL_SENSOR
    assert message.time_usec == 1_234_568
    assert (message.xacc, message.yacc, message.zacc) == pytest.approx((0.1, 0.2, -9.81))
    assert (message.xgyro, message.ygyro, message.zgyro) == pytest.approx((0.01, -0.02, 0.03))
    assert message.fields_updated == 0b111111


def test_pressure_is_in_hectopascals_and_the_field_in_gauss() -> None:
    mag = Magnetometer(t_ns=T_NS, field_frd_gauss=(0.21, 0.01, 0.43))
    baro = Barometer(t_ns=T_NS, pressure_pa=95_600.0, altitude_pressure_m=488.0, temperature_degc=20.0)
    message = decoded(HilPort().sensor(T_NS, (0.0, 0.0, -9.81), (0.0, 0.0, 0.0), mag, baro))
    assert message.abs_pressure == pytest.approx(956.0)
    assert message.pressure_alt == pytest.approx(488.0)
    assert message.temperature == pytest.approx(20.0)
    assert (message.xmag, message.ymag, message.zmag) == pytest.approx((0.21, 0.01, 0.43))
    # PX4's groups: accelerometer, gyroscope, magnetometer, barometer
    assert message.fields_updated == 0b111 | 0b111000 | 0b111000000 | 0b1101000000000


def test_a_fix_is_in_centimetres_and_1e7_degrees() -> None:
    fix = Gnss(
        t_ns=T_NS,
        position_deg=(47.3977421, 8.5455939, 488.25),
        vel_uav_ned_mps=(-3.0, 4.0, -12.0),
        std_horizontal_m=0.5,
        std_vertical_m=0.7,
        satellites=14,
    )
    message = decoded(HilPort().gps(fix))
    assert message.time_usec == 1_234_568
    assert (message.lat, message.lon, message.alt) == (473_977_421, 85_455_939, 488_250)
    assert (message.vn, message.ve, message.vd, message.vel) == (-300, 400, -1200, 1300)
    assert (message.eph, message.epv, message.satellites_visible, message.fix_type) == (50, 70, 14, 3)
    # 3 south and 4 east: 126.87 degrees from north
    assert message.cog == 12_687


def test_the_newest_motor_commands_count() -> None:
    port = HilPort()
    port.receive(controls([0.1, 0.1, 0.1, 0.1]) + controls([0.5, 0.6, 0.7, 0.8]))
    assert port.commands == pytest.approx((0.5, 0.6, 0.7, 0.8))
    assert port.commands_received == 2
    port.receive(b"")
    assert port.commands == pytest.approx((0.5, 0.6, 0.7, 0.8))


def test_a_disarmed_autopilot_commands_nothing() -> None:
    port = HilPort()
    port.receive(controls([0.5, 0.5, 0.5, 0.5], mode=1))
    assert tuple(port.commands) == (0.0, 0.0, 0.0, 0.0)


def test_commands_out_of_range_are_clipped_and_those_not_finite_are_none() -> None:
    port = HilPort()
    port.receive(controls([1.5, -0.2, float("nan"), float("inf")]))
    assert tuple(port.commands) == (1.0, 0.0, 0.0, 0.0)


def test_other_messages_and_garbage_change_nothing() -> None:
    port = HilPort()
    port.receive(controls([0.5, 0.5, 0.5, 0.5]))
    heartbeat = MavlinkCodec(1, 1).pack(dialect.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3))
    port.receive(b"\xfd\x01garbage" + heartbeat + b"\x00\xff")
    assert port.commands == pytest.approx((0.5, 0.5, 0.5, 0.5))


def test_a_message_may_come_in_two_pieces() -> None:
    port = HilPort()
    data = controls([0.5, 0.5, 0.5, 0.5])
    port.receive(data[:20])
    assert port.commands_received == 0
    port.receive(data[20:])
    assert port.commands_received == 1


@pytest.mark.parametrize(("range_m", "range_cm"), [(2.347, 235), (None, 1001)])
def test_a_range_is_in_centimetres_and_beyond_the_limits_where_nothing_is_met(
    range_m: float | None, range_cm: int
) -> None:
    mount = AltimeterMountConfig(range_min_m=0.15, range_max_m=10.0)
    message = decoded(HilPort().distance(Altimeter(t_ns=T_NS, range_m=range_m), mount))
    assert message.get_msgId() == dialect.MAVLINK_MSG_ID_DISTANCE_SENSOR
    assert (message.time_boot_ms, message.current_distance) == (1234, range_cm)
    assert (message.min_distance, message.max_distance, message.orientation) == (15, 1000, 25)


def test_the_time_of_a_controller_that_boots_counts_from_its_boot_and_is_never_negative() -> None:
    port = HilPort(boot_ns=T_NS - 2_000_000)
    imu = ((0.0, 0.0, -9.81), (0.0, 0.0, 0.0))
    assert decoded(port.sensor(T_NS, *imu, None, None)).time_usec == 2000
    assert decoded(port.sensor(T_NS - 5_000_000, *imu, None, None)).time_usec == 0
