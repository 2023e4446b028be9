"""Telemetry messages of the autopilot, each built from one snapshot, in the units and frames of PX4."""

from collections.abc import Callable
from math import atan2, degrees, hypot, nan, pi

import msgspec

from jezero.base.frames import Quat, Vec3, altitude_m, euler_from_quat, geodetic_from_ned
from jezero.base.mavlink import MavMessage, dialect
from jezero.services.autopilot.alignment import Fix
from jezero.services.autopilot.control import ControlSetpoint
from jezero.services.autopilot.gimbal import LOCKS, GimbalManager
from jezero.services.autopilot.hil import RangeSample

PREARM = dialect.MAV_SYS_STATUS_PREARM_CHECK
SENSORS = (
    dialect.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | dialect.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | dialect.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | dialect.MAV_SYS_STATUS_SENSOR_GPS
    | dialect.MAV_SYS_STATUS_SENSOR_BATTERY
)
UNKNOWN_COVARIANCE = [nan] * 21
UNKNOWN_APPROACH = (nan, nan, nan)
UNKNOWN_CELLS = [0xFFFF] * 9
GIMBAL_ID = 1
PX4_VERSION = 1 << 24 | 15 << 16 | 2 << 8 | 255
"""Version 1.15.2, whose interfaces this autopilot has."""
CAPABILITIES = (
    dialect.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    | dialect.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | dialect.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
    | dialect.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
)


class Snapshot(msgspec.Struct, frozen=True, gc=False):
    """State of the vehicle at one time, for telemetry. Position and velocity are local NED.

    Attributes:
        failsafe: whether a failsafe chose the mode.
        custom_mode: flight mode as in HEARTBEAT.
        armable: whether all arming checks pass.
        estimate_valid: whether position, velocity and attitude are valid.
        var_pos_ned_m2: (3,) variance of the position.
        origin_deg: (latitude_deg, longitude_deg, altitude_m) of the local frame's origin.
        home_ned_m: position of the last arming; before that, of the start of the estimator.
        setpoint: setpoint of the present mode, None on the ground.
        vel_setpoint_ned_mps: (3,) velocity setpoint after position control and limits.
        fix: the newest GNSS fix.
        fix_us: time at which it arrived.
        newest_range: of the rangefinder that points down; this autopilot passes it on and makes no other use of it.
        gimbal: that somebody controls; None while nobody does.
        thrust: collective thrust, 0 to 1.
        battery_remaining: fraction of the capacity, 0 to 1.
        battery_level: 0 normal, 1 low, 2 critical, 3 emergency.
        has_magnetometer: whether a magnetometer measures the heading.
    """

    system_id: int
    t_us: int
    armed: bool
    failsafe: bool
    custom_mode: int
    landed: bool
    armable: bool
    estimate_valid: bool
    pos_ned_m: Vec3
    vel_ned_mps: Vec3
    q_ned_from_frd: Quat
    rates_frd_rps: Vec3
    var_pos_ned_m2: Vec3
    reset_counter: int
    origin_deg: Vec3 | None
    home_ned_m: Vec3
    setpoint: ControlSetpoint | None
    vel_setpoint_ned_mps: Vec3
    fix: Fix | None
    fix_us: int
    newest_range: RangeSample | None
    gimbal: GimbalManager | None
    thrust: float
    battery_v: float
    battery_a: float
    battery_used_mah: float
    battery_remaining: float
    battery_level: int
    has_magnetometer: bool = True

    @property
    def t_ms(self) -> int:
        return (self.t_us // 1000) & 0xFFFFFFFF

    @property
    def heading_deg(self) -> float:
        return degrees(euler_from_quat(self.q_ned_from_frd)[2]) % 360.0


def _heartbeat(now: Snapshot) -> MavMessage:
    base_mode = dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | dialect.MAV_MODE_FLAG_STABILIZE_ENABLED
    base_mode |= dialect.MAV_MODE_FLAG_SAFETY_ARMED if now.armed else 0
    state = dialect.MAV_STATE_ACTIVE if now.armed else dialect.MAV_STATE_STANDBY
    return dialect.MAVLink_heartbeat_message(
        dialect.MAV_TYPE_QUADROTOR,
        dialect.MAV_AUTOPILOT_PX4,
        base_mode,
        now.custom_mode,
        dialect.MAV_STATE_CRITICAL if now.failsafe else state,
        3,
    )


def _odometry(now: Snapshot) -> MavMessage | None:
    if not now.estimate_valid:
        return None
    covariance = list(UNKNOWN_COVARIANCE)
    covariance[0], covariance[6], covariance[11] = now.var_pos_ned_m2
    return dialect.MAVLink_odometry_message(
        now.t_us,
        dialect.MAV_FRAME_LOCAL_NED,
        dialect.MAV_FRAME_LOCAL_NED,
        *now.pos_ned_m,
        now.q_ned_from_frd,
        *now.vel_ned_mps,
        *now.rates_frd_rps,
        covariance,
        UNKNOWN_COVARIANCE,
        now.reset_counter % 256,
        dialect.MAV_ESTIMATOR_TYPE_AUTOPILOT,
        100,
    )


def _local_position(now: Snapshot) -> MavMessage | None:
    if not now.estimate_valid:
        return None
    return dialect.MAVLink_local_position_ned_message(now.t_ms, *now.pos_ned_m, *now.vel_ned_mps)


def _position_target(now: Snapshot) -> MavMessage | None:
    """Position of the setpoint, and velocity after position control and limits, as in PX4; NaN for axes without one."""
    setpoint = now.setpoint
    if setpoint is None:
        return None
    pos = [nan if axis is None else axis for axis in setpoint.pos_ned_m]
    axes = zip(setpoint.pos_ned_m, setpoint.vel_ned_mps, now.vel_setpoint_ned_mps, strict=True)
    vel = [nan if p is None and v is None else result for p, v, result in axes]
    acc = [nan if axis is None else axis for axis in setpoint.acc_ned_mps2]
    yaw_rad = nan if setpoint.yaw_rad is None else setpoint.yaw_rad
    yaw_rate_rps = nan if setpoint.yaw_rate_rps is None else setpoint.yaw_rate_rps
    return dialect.MAVLink_position_target_local_ned_message(
        now.t_ms, dialect.MAV_FRAME_LOCAL_NED, 0, *pos, *vel, *acc, yaw_rad, yaw_rate_rps
    )


def _attitude(now: Snapshot) -> MavMessage:
    return dialect.MAVLink_attitude_message(now.t_ms, *euler_from_quat(now.q_ned_from_frd), *now.rates_frd_rps)


def _attitude_quaternion(now: Snapshot) -> MavMessage:
    return dialect.MAVLink_attitude_quaternion_message(now.t_ms, *now.q_ned_from_frd, *now.rates_frd_rps)


def _extended_sys_state(now: Snapshot) -> MavMessage:
    landed = dialect.MAV_LANDED_STATE_ON_GROUND if now.landed else dialect.MAV_LANDED_STATE_IN_AIR
    return dialect.MAVLink_extended_sys_state_message(dialect.MAV_VTOL_STATE_UNDEFINED, landed)


def _sys_status(now: Snapshot) -> MavMessage:
    present = SENSORS | (dialect.MAV_SYS_STATUS_SENSOR_3D_MAG if now.has_magnetometer else 0)
    healthy = present | (PREARM if now.armable else 0)
    return dialect.MAVLink_sys_status_message(
        present | PREARM,
        present | PREARM,
        healthy,
        0,
        round(now.battery_v * 1e3),
        min(32_767, round(now.battery_a * 100.0)),
        round(now.battery_remaining * 100.0),
        0,
        0,
        0,
        0,
        0,
        0,
    )


def _battery_status(now: Snapshot) -> MavMessage:
    """Like PX4, the voltage of the whole battery is sent as that of the first cell."""
    return dialect.MAVLink_battery_status_message(
        0,
        dialect.MAV_BATTERY_FUNCTION_ALL,
        dialect.MAV_BATTERY_TYPE_LIPO,
        32_767,
        [round(now.battery_v * 1e3), *UNKNOWN_CELLS],
        min(32_767, round(now.battery_a * 100.0)),
        round(now.battery_used_mah),
        -1,
        round(now.battery_remaining * 100.0),
        0,
        dialect.MAV_BATTERY_CHARGE_STATE_OK + now.battery_level,
    )


def _geodetic(pos_ned_m: Vec3, origin_deg: Vec3) -> tuple[int, int, int]:
    """Latitude and longitude in 1e-7 degrees, altitude above sea level in millimetres."""
    latitude_deg, longitude_deg, amsl_m = geodetic_from_ned(pos_ned_m, origin_deg)
    return round(latitude_deg * 1e7), round(longitude_deg * 1e7), round(amsl_m * 1e3)


def _global_position(now: Snapshot) -> MavMessage | None:
    if now.origin_deg is None or not now.estimate_valid:
        return None
    return dialect.MAVLink_global_position_int_message(
        now.t_ms,
        *_geodetic(now.pos_ned_m, now.origin_deg),
        round(altitude_m(now.pos_ned_m[2] - now.home_ned_m[2]) * 1e3),
        *(_clipped(v * 100.0) for v in now.vel_ned_mps),
        round(now.heading_deg * 100.0) % 36_000,
    )


def _gps_raw(now: Snapshot) -> MavMessage | None:
    fix = now.fix
    if fix is None:
        return None
    latitude_deg, longitude_deg, amsl_m = fix.position_deg
    north, east, _ = fix.vel_ned_mps
    course_deg = degrees(_course_rad(north, east))
    return dialect.MAVLink_gps_raw_int_message(
        now.fix_us,
        dialect.GPS_FIX_TYPE_3D_FIX if fix.valid else dialect.GPS_FIX_TYPE_NO_FIX,
        round(latitude_deg * 1e7),
        round(longitude_deg * 1e7),
        round(amsl_m * 1e3),
        0xFFFF,
        0xFFFF,
        min(0xFFFE, round(hypot(north, east) * 100.0)),
        round(course_deg * 100.0) % 36_000,
        fix.satellites,
    )


def _distance_sensor(now: Snapshot) -> MavMessage | None:
    found = now.newest_range
    if found is None:
        return None
    kind, down = dialect.MAV_DISTANCE_SENSOR_LASER, dialect.MAV_SENSOR_ROTATION_PITCH_270
    return dialect.MAVLink_distance_sensor_message(found.t_ms, *found.limits_cm, found.range_cm, kind, 0, down, 255)


def _course_rad(north: float, east: float) -> float:
    return atan2(east, north) % (2.0 * pi)


def _vfr_hud(now: Snapshot) -> MavMessage | None:
    if now.origin_deg is None:
        return None
    speed_mps = hypot(now.vel_ned_mps[0], now.vel_ned_mps[1])
    return dialect.MAVLink_vfr_hud_message(
        speed_mps,
        speed_mps,
        round(now.heading_deg) % 360,
        round(now.thrust * 100.0),
        now.origin_deg[2] + altitude_m(now.pos_ned_m[2]),
        altitude_m(now.vel_ned_mps[2]),
    )


def _altitude(now: Snapshot) -> MavMessage | None:
    if now.origin_deg is None:
        return None
    local_m = altitude_m(now.pos_ned_m[2])
    amsl_m = now.origin_deg[2] + local_m
    above_home_m = altitude_m(now.pos_ned_m[2] - now.home_ned_m[2])
    return dialect.MAVLink_altitude_message(now.t_us, amsl_m, amsl_m, local_m, above_home_m, nan, nan)


def _global_origin(now: Snapshot) -> MavMessage | None:
    if now.origin_deg is None:
        return None
    return dialect.MAVLink_gps_global_origin_message(*_geodetic((0.0, 0.0, 0.0), now.origin_deg), now.t_us)


def _home_position(now: Snapshot) -> MavMessage | None:
    if now.origin_deg is None:
        return None
    return dialect.MAVLink_home_position_message(
        *_geodetic(now.home_ned_m, now.origin_deg), *now.home_ned_m, [nan] * 4, *UNKNOWN_APPROACH, now.t_us
    )


def _autopilot_version(now: Snapshot) -> MavMessage:
    nothing = [0] * 8
    return dialect.MAVLink_autopilot_version_message(
        CAPABILITIES, PX4_VERSION, 0, 0, 0, nothing, nothing, nothing, 0, 0, now.system_id
    )


def _gimbal_manager_status(now: Snapshot) -> MavMessage | None:
    if now.gimbal is None:
        return None
    flags = LOCKS | dialect.GIMBAL_MANAGER_FLAGS_YAW_IN_VEHICLE_FRAME
    return dialect.MAVLink_gimbal_manager_status_message(now.t_ms, flags, GIMBAL_ID, *now.gimbal.controller, 0, 0)


def _gimbal_attitude(now: Snapshot) -> MavMessage | None:
    if now.gimbal is None:
        return None
    flags, q = LOCKS | dialect.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME, now.gimbal.q_level(now.q_ned_from_frd)
    return dialect.MAVLink_gimbal_device_attitude_status_message(0, 0, now.t_ms, flags, list(q), nan, nan, nan, 0)


def _clipped(value: float) -> int:
    return max(-32_768, min(32_767, round(value)))


STREAMS: dict[int, Callable[[Snapshot], MavMessage | None]] = {
    dialect.MAVLINK_MSG_ID_HEARTBEAT: _heartbeat,
    dialect.MAVLINK_MSG_ID_ODOMETRY: _odometry,
    dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: _local_position,
    dialect.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: _position_target,
    dialect.MAVLINK_MSG_ID_ATTITUDE: _attitude,
    dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: _attitude_quaternion,
    dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: _extended_sys_state,
    dialect.MAVLINK_MSG_ID_SYS_STATUS: _sys_status,
    dialect.MAVLINK_MSG_ID_BATTERY_STATUS: _battery_status,
    dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: _global_position,
    dialect.MAVLINK_MSG_ID_GPS_RAW_INT: _gps_raw,
    dialect.MAVLINK_MSG_ID_DISTANCE_SENSOR: _distance_sensor,
    dialect.MAVLINK_MSG_ID_VFR_HUD: _vfr_hud,
    dialect.MAVLINK_MSG_ID_ALTITUDE: _altitude,
    dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: _global_origin,
    dialect.MAVLINK_MSG_ID_HOME_POSITION: _home_position,
    dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION: _autopilot_version,
    dialect.MAVLINK_MSG_ID_GIMBAL_MANAGER_STATUS: _gimbal_manager_status,
    dialect.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS: _gimbal_attitude,
}
"""Builder of each message by its id; it returns None as long as there is no data for the message."""
