"""The autopilot's end of PX4's simulator interface: receives HIL_SENSOR, HIL_GPS and DISTANCE_SENSOR, sends
HIL_ACTUATOR_CONTROLS.

Source: MAVLink common dialect; PX4 v1.15 `simulator_mavlink`.
"""

from collections.abc import Iterator
from math import radians

import msgspec

from jezero.base.frames import Vec3
from jezero.base.mavlink import FramePacker, MavlinkCodec, MavMessage, dialect, is_finite
from jezero.services.autopilot.alignment import Fix
from jezero.services.autopilot.mixer import Commands

ARMED = 128
DOWN = dialect.MAV_SENSOR_ROTATION_PITCH_270
UPDATED_IMU = 0x3F
UPDATED_MAG = 0x1C0
UPDATED_BARO = 0x800
MIN_SATELLITES = 6
FIX_3D = 3
MAG_FIELDS = ("xmag", "ymag", "zmag")
ACC_MAX_MPS2 = 1000.0
GYRO_MAX_RPS = 100.0
UNUSED = (0.0,) * 12
_HIL_ACTUATOR_CONTROLS = FramePacker(
    dialect.MAVLink_hil_actuator_controls_message, "time_usec", "flags", "controls", "mode"
)


class SensorSample(msgspec.Struct, frozen=True, gc=False):
    """Measurements of one HIL_SENSOR; None for sensors that it does not update.

    Attributes:
        imu: (acc_frd_mps2, gyro_frd_rps), specific force and rate, (3,) each.
        field_frd_gauss: (3,) magnetic field.
        altitude_pressure_m: pressure altitude in the standard atmosphere, positive up.
    """

    t_us: int
    imu: tuple[Vec3, Vec3] | None
    field_frd_gauss: Vec3 | None
    altitude_pressure_m: float | None


class RangeSample(msgspec.Struct, frozen=True, gc=False):
    """One DISTANCE_SENSOR of a rangefinder that points down.

    Attributes:
        t_ms: time of the measurement.
        range_cm: distance; outside of the limits where nothing was met.
        limits_cm: smallest and greatest distance that is measured.
    """

    t_ms: int
    range_cm: int
    limits_cm: tuple[int, int]


class HilLink:
    """One connection to a simulator."""

    def __init__(self, system_id: int) -> None:
        self._codec = MavlinkCodec(system_id, dialect.MAV_COMP_ID_AUTOPILOT1)

    @property
    def malformed(self) -> int:
        """Number of malformed messages, and of those with impossible numbers."""
        return self._codec.malformed

    def receive(self, data: bytes) -> Iterator[SensorSample | Fix | RangeSample]:
        """Parse bytes; yields the measurements in order."""
        for message in self._codec.parse(data):
            kind = message.get_msgId()
            if kind == dialect.MAVLINK_MSG_ID_HIL_SENSOR:
                yield self._sample(message)
            elif kind == dialect.MAVLINK_MSG_ID_HIL_GPS:
                yield _fix(message)
            elif kind == dialect.MAVLINK_MSG_ID_DISTANCE_SENSOR and message.orientation == DOWN:
                limits_cm = (message.min_distance, message.max_distance)
                yield RangeSample(message.time_boot_ms, message.current_distance, limits_cm)

    def _sample(self, message: MavMessage) -> SensorSample:
        """Convert a HIL_SENSOR; measurements that are not updated, or impossible, become None."""
        updated = message.fields_updated
        imu = field = altitude_m = None
        acc = (message.xacc, message.yacc, message.zacc)
        gyro = (message.xgyro, message.ygyro, message.zgyro)
        if updated & UPDATED_IMU == UPDATED_IMU and _is_within(acc, ACC_MAX_MPS2) and _is_within(gyro, GYRO_MAX_RPS):
            imu = (acc, gyro)
        else:
            self._codec.malformed += 1
        if updated & UPDATED_MAG == UPDATED_MAG and is_finite(message, *MAG_FIELDS):
            field = (message.xmag, message.ymag, message.zmag)
        if updated & UPDATED_BARO and is_finite(message, "pressure_alt"):
            altitude_m = message.pressure_alt
        return SensorSample(message.time_usec, imu, field, altitude_m)

    def actuators(self, t_us: int, commands: Commands, *, armed: bool) -> bytes:
        """Pack HIL_ACTUATOR_CONTROLS with (4,) motor commands from 0 to 1."""
        mode = 1 | (ARMED if armed else 0)
        return self._codec.pack_numbers(_HIL_ACTUATOR_CONTROLS, t_us, 0, *commands, *UNUSED, mode)


def _is_within(vector: Vec3, limit: float) -> bool:
    """Whether all components are within the limit; False for NaN."""
    x, y, z = vector
    return abs(x) <= limit and abs(y) <= limit and abs(z) <= limit


def _fix(message: MavMessage) -> Fix:
    return Fix(
        t_us=message.time_usec,
        position_deg=(message.lat * 1e-7, message.lon * 1e-7, message.alt * 1e-3),
        vel_ned_mps=(message.vn * 0.01, message.ve * 0.01, message.vd * 0.01),
        valid=message.fix_type >= FIX_3D and message.satellites_visible >= MIN_SATELLITES,
        satellites=message.satellites_visible,
        yaw_rad=radians(0.01 * message.yaw) if message.yaw else None,
    )
