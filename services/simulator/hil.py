"""PX4's simulator interface: HIL_SENSOR, HIL_GPS and DISTANCE_SENSOR out, HIL_ACTUATOR_CONTROLS in.

Source: MAVLink common dialect; PX4 v1.15 `simulator_mavlink`, which uses a group of fields only when all its bits of
`fields_updated` are set.
"""

from collections.abc import Sequence
from math import atan2, degrees, hypot, inf, sqrt

from msgspec import UNSET

from jezero.base.frames import Vec3
from jezero.base.mavlink import FramePacker, MavlinkCodec, MavMessage, dialect
from jezero.base.vehicle_config import AltimeterMountConfig
from jezero.schemas.sensors import Altimeter, Barometer, Gnss, Magnetometer

SYSTEM_ID = 1
COMPONENT_ID = 25
ARMED = 128
UPDATED_IMU = 0x3F
UPDATED_MAG = 0x1C0
UPDATED_BARO = 0x1A00
"""Absolute pressure, pressure altitude and temperature; there is no airspeed sensor (0x400)."""
FIX_3D = 3
MOTORS_OFF: Sequence[float] = (0.0, 0.0, 0.0, 0.0)
_HIL_SENSOR = FramePacker(
    dialect.MAVLink_hil_sensor_message,
    *("time_usec", "xacc", "yacc", "zacc", "xgyro", "ygyro", "zgyro", "xmag", "ymag", "zmag"),
    *("abs_pressure", "diff_pressure", "pressure_alt", "temperature", "fields_updated", "id"),
)


class HilPort:
    """The simulator's side of one connection to an autopilot.

    Args:
        boot_ns: vehicle time at which the autopilot's own time is 0.

    Attributes:
        commands_received: number of HIL_ACTUATOR_CONTROLS so far.
        commands: (4,) motor commands in 0..1, in the autopilot's order; zero while it isn't armed.
    """

    def __init__(self, boot_ns: int = 0) -> None:
        self._boot_ns = boot_ns
        self._codec = MavlinkCodec(SYSTEM_ID, COMPONENT_ID)
        self.commands: Sequence[float] = MOTORS_OFF
        self.commands_received = 0

    def receive(self, data: bytes) -> None:
        """Parse bytes from the autopilot; the newest motor command counts, other messages are ignored."""
        for message in self._codec.parse(data):
            if message.get_msgId() == dialect.MAVLINK_MSG_ID_HIL_ACTUATOR_CONTROLS:
                self.commands = _motor_commands(message)
                self.commands_received += 1

    def _controller_ns(self, t_ns: int) -> int:
        """The autopilot's own time at a vehicle time."""
        return max(0, t_ns - self._boot_ns)

    def sensor(
        self, t_ns: int, acc_frd_mps2: Vec3, gyro_frd_rps: Vec3, mag: Magnetometer | None, baro: Barometer | None
    ) -> bytes:
        """HIL_SENSOR: accelerometer and gyroscope always, magnetometer and barometer when they are given."""
        updated = UPDATED_IMU
        field = (0.0, 0.0, 0.0)
        pressure_hpa = altitude_m = temperature_degc = 0.0
        if mag is not None:
            updated |= UPDATED_MAG
            field = mag.field_frd_gauss
        if baro is not None:
            updated |= UPDATED_BARO
            pressure_hpa = 0.01 * baro.pressure_pa
            altitude_m = baro.altitude_pressure_m
            temperature_degc = baro.temperature_degc
        air = (pressure_hpa, 0.0, altitude_m, temperature_degc)
        return self._codec.pack_numbers(
            _HIL_SENSOR, self._controller_ns(t_ns) // 1000, *acc_frd_mps2, *gyro_frd_rps, *field, *air, updated, 0
        )

    def gps(self, fix: Gnss) -> bytes:
        """HIL_GPS; its time is that of the measurement, not that of sending."""
        latitude_deg, longitude_deg, altitude_m = fix.position_deg
        north_mps, east_mps, down_mps = fix.vel_uav_ned_mps
        speed_mps = sqrt(north_mps * north_mps + east_mps * east_mps + down_mps * down_mps)
        course_deg = degrees(atan2(east_mps, north_mps)) % 360.0 if hypot(north_mps, east_mps) > 0.0 else 0.0
        return self._codec.pack(
            dialect.MAVLink_hil_gps_message(
                self._controller_ns(fix.t_ns) // 1000,
                FIX_3D,
                round(latitude_deg * 1e7),
                round(longitude_deg * 1e7),
                round(altitude_m * 1e3),
                round(fix.std_horizontal_m * 100.0),
                round(fix.std_vertical_m * 100.0),
                min(round(speed_mps * 100.0), 65_534),
                _cmps(north_mps),
                _cmps(east_mps),
                _cmps(down_mps),
                round(course_deg * 100.0) % 36_000,
                fix.satellites,
                yaw=0 if fix.yaw_uav_rad is UNSET else _yaw_cdeg(fix.yaw_uav_rad),
            )
        )

    def distance(self, altimeter: Altimeter, mount: AltimeterMountConfig) -> bytes:
        """DISTANCE_SENSOR; a beam that meets nothing has a distance beyond the limits."""
        min_cm, max_cm = round(100.0 * mount.range_min_m), round(100.0 * mount.range_max_m)
        range_cm = max_cm + 1 if altimeter.range_m is None else round(100.0 * altimeter.range_m)
        kind, down = dialect.MAV_DISTANCE_SENSOR_LASER, dialect.MAV_SENSOR_ROTATION_PITCH_270
        t_ms = self._controller_ns(altimeter.t_ns) // 1_000_000 & 0xFFFFFFFF
        return self._codec.pack(
            dialect.MAVLink_distance_sensor_message(t_ms, min_cm, max_cm, range_cm, kind, 0, down, 255)
        )


def _motor_commands(message: MavMessage) -> Sequence[float]:
    """Motor commands, clipped to 0..1; zero for a command that is not finite, and for a disarmed autopilot."""
    if not message.mode & ARMED:
        return MOTORS_OFF
    return tuple(min(value, 1.0) if 0.0 < value < inf else 0.0 for value in message.controls[:4])


def _yaw_cdeg(yaw_rad: float) -> int:
    """Heading in hundredths of a degree; 0 would mean that there is none, so north is 360 degrees."""
    return round(100.0 * degrees(yaw_rad)) % 36_000 or 36_000


def _cmps(speed_mps: float) -> int:
    """Speed in cm/s, clipped to the 16 bits of HIL_GPS."""
    return max(-32_767, min(32_767, round(speed_mps * 100.0)))
