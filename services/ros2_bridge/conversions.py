"""The conversions of jezero's messages into ROS's: each gets one message, and gives one or none."""

from array import array
from collections import deque
from collections.abc import Callable, Iterable
from math import inf, nan, sqrt

from msgspec.structs import replace

from jezero.base.frames import (
    Quat,
    Vec3,
    add,
    distance,
    enu_from_ned,
    q_enu_from_flu,
    q_frd_from_camera,
    quat_conjugate,
    quat_from_euler,
    quat_multiply,
    quat_rotate,
    rotate_yaw,
    subtract,
)
from jezero.base.vehicle_config import VehicleConfig
from jezero.schemas.commands import RoverCommand
from jezero.schemas.estimate import Lease, Relative, RoverEstimate
from jezero.schemas.fence import FenceState, Zone
from jezero.schemas.health import ServiceHealth
from jezero.schemas.sensors import (
    Altimeter,
    Barometer,
    CameraFrame,
    CameraInfo,
    CameraPreview,
    Gnss,
    Imu,
    Magnetometer,
    RoverOdometry,
    model_of,
)
from jezero.schemas.state import Odometry, Status
from jezero.schemas.units import NS_PER_S
from jezero.services.ros2_bridge.exact import to_exact
from jezero.services.ros2_bridge.geometry import (
    UPRIGHT,
    RosMessage,
    covariance,
    flu_from_frd,
    header,
    point,
    pose,
    q_enu_from_heading,
    q_flu_from_camera,
    quaternion,
    time,
    transform,
    transforms,
    turned_covariance,
    twist,
    vector,
)

UNKNOWN_M2 = 1e6
"""Variance of what is not known."""
GAUSS_T = 1e-4
FIX, SERVICE_GPS = 0, 1
"""STATUS_FIX and SERVICE_GPS of sensor_msgs/NavSatStatus."""
COVARIANCE_DIAGONAL_KNOWN = 2
INFRARED = 1
FIELD_OF_VIEW_RAD = 0.01
"""Opening angle of the altimeter's beam."""
DISCHARGING, LIPO = 2, 3
"""POWER_SUPPLY_STATUS_DISCHARGING and POWER_SUPPLY_TECHNOLOGY_LIPO of sensor_msgs/BatteryState."""
LEVELS = {"ok": b"\x00", "degraded": b"\x01", "starting": b"\x03"}
"""Level of a DiagnosticStatus: OK, WARN, STALE."""
LINE_STRIP, SPHERE, ADD, DELETE_ALL = 4, 2, 0, 3
"""Kinds and actions of visualization_msgs/Marker."""
SIGMAS = 2.0
"""Half axes of the ellipsoid of the relative position's uncertainty, in standard deviations."""
RGB = "rgb8"


TRAIL_STEP_M, TRAIL_MAX = 0.25, 1000
LEASE_PERIOD_NS = NS_PER_S
"""A lease ends 3 s after its last renewal."""


class Context:
    """What conversions need beside their message.

    Args:
        vehicle: its name.
        config: the vehicle's dimensions.

    Attributes:
        q_ned_from_frd: newest attitude; upright before the first.
        camera_info: newest intrinsics; None before the first.
        parameters_version: newest version of the estimator's parameters; None before its first estimate.
        lease: the newest lease that was published; None before the first one, and after a release.
        lease_ns: vehicle time of the estimate that it was made from.
        prior_of: asks the estimator for the rover's position, in world NED, with which the lease of a goal began; None
            for a lease without a position.
        trail_ned_m: where the vehicle has been, oldest first.
    """

    def __init__(self, vehicle: str, config: VehicleConfig) -> None:
        self.vehicle = vehicle
        self.config = config
        self.q_ned_from_frd: Quat = UPRIGHT
        self.camera_info: CameraInfo | None = None
        self.parameters_version: int | None = None
        self.lease: Lease | None = None
        self.lease_ns = 0
        self.prior_of: Callable[[str], Vec3 | None] = lambda goal_id: None
        self.trail_ned_m: deque[Vec3] = deque(maxlen=TRAIL_MAX)

    def notice(self, message: object) -> None:
        """Keep what later conversions need."""
        if isinstance(message, Odometry):
            self.q_ned_from_frd = message.q_ned_from_frd
        elif isinstance(message, CameraInfo):
            self.camera_info = message
        elif isinstance(message, Relative):
            self.parameters_version = message.parameters_version

    def extend_trail(self, pos_uav_ned_m: Vec3) -> bool:
        """Add a position to the trail; false while it is near the last one."""
        if self.trail_ned_m and distance(self.trail_ned_m[-1], pos_uav_ned_m) < TRAIL_STEP_M:
            return False
        self.trail_ned_m.append(pos_uav_ned_m)
        return True

    def frame(self, name: str) -> str:
        """Full name of one of the vehicle's frames."""
        return f"{self.vehicle}/{name}"

    def center_enu_m(self, pos_uav_ned_m: Vec3) -> Vec3:
        """Centre of mass, which is the origin of `base_link`, from the position that jezero's messages have."""
        return add(enu_from_ned(pos_uav_ned_m), (0.0, 0.0, self.config.airframe.height_stand_m))


# -- the vehicle -----------------------------------------------------------------------------------------


def odometry(m: Odometry, context: Context) -> RosMessage:
    """A reset of the autopilot's position moves `odom` in `map`, so that this position makes no step."""
    pos_odom_ned_m = subtract(m.pos_uav_ned_m, m.reset_offset_ned_m)
    velocity = flu_from_frd(quat_rotate(quat_conjugate(m.q_ned_from_frd), m.vel_uav_ned_mps))
    variance_m2 = UNKNOWN_M2 if m.std_pos_m is None else m.std_pos_m**2
    at = pose(context.center_enu_m(pos_odom_ned_m), q_enu_from_flu(m.q_ned_from_frd))
    fields = {
        "header": header(m.t_ns, context.frame("odom")),
        "child_frame_id": context.frame("base_link"),
        "pose": _with_covariance("Pose", at, [variance_m2] * 3 + [UNKNOWN_M2] * 3),
        "twist": _with_covariance("Twist", twist(velocity, flu_from_frd(m.rates_uav_frd_rps)), [UNKNOWN_M2] * 6),
    }
    return RosMessage("nav_msgs/msg/Odometry", fields)


def vehicle_transforms(m: Odometry, context: Context) -> RosMessage:
    pos_odom_ned_m = subtract(m.pos_uav_ned_m, m.reset_offset_ned_m)
    map_frame, odom, base = (context.frame(name) for name in ("map", "odom", "base_link"))
    return transforms(
        transform(m.t_ns, map_frame, odom, enu_from_ned(m.reset_offset_ned_m), UPRIGHT),
        transform(m.t_ns, odom, base, context.center_enu_m(pos_odom_ned_m), q_enu_from_flu(m.q_ned_from_frd)),
    )


def imu(m: Imu, context: Context) -> RosMessage:
    fields = {
        "header": header(m.t_ns, context.frame("imu")),
        "orientation": quaternion(UPRIGHT),
        "orientation_covariance": [-1.0] + [0.0] * 8,
        "angular_velocity": vector(flu_from_frd(m.gyro_imu_frd_rps)),
        "linear_acceleration": vector(flu_from_frd(m.acc_imu_frd_mps2)),
    }
    return RosMessage("sensor_msgs/msg/Imu", fields)


def fix(m: Gnss, context: Context) -> RosMessage:
    latitude_deg, longitude_deg, altitude_m = m.position_deg
    horizontal_m2, vertical_m2 = m.std_horizontal_m**2, m.std_vertical_m**2
    fields = {
        "header": header(m.t_ns, context.frame("base_link")),
        "status": RosMessage("sensor_msgs/msg/NavSatStatus", {"status": FIX, "service": SERVICE_GPS}),
        "latitude": latitude_deg,
        "longitude": longitude_deg,
        "altitude": altitude_m,
        "position_covariance": [horizontal_m2, 0.0, 0.0, 0.0, horizontal_m2, 0.0, 0.0, 0.0, vertical_m2],
        "position_covariance_type": COVARIANCE_DIAGONAL_KNOWN,
    }
    return RosMessage("sensor_msgs/msg/NavSatFix", fields)


def pressure(m: Barometer, context: Context) -> RosMessage:
    fields = {"header": header(m.t_ns, context.frame("base_link")), "fluid_pressure": float(m.pressure_pa)}
    return RosMessage("sensor_msgs/msg/FluidPressure", fields)


def magnetic_field(m: Magnetometer, context: Context) -> RosMessage:
    x, y, z = flu_from_frd(m.field_frd_gauss)
    fields = {
        "header": header(m.t_ns, context.frame("imu")),
        "magnetic_field": vector((x * GAUSS_T, y * GAUSS_T, z * GAUSS_T)),
    }
    return RosMessage("sensor_msgs/msg/MagneticField", fields)


def altitude_range(m: Altimeter, context: Context) -> RosMessage:
    """A beam that meets nothing has an infinite range. Source: REP 117."""
    mount = context.config.altimeter
    fields = {
        "header": header(m.t_ns, context.frame("altimeter")),
        "radiation_type": INFRARED,
        "field_of_view": FIELD_OF_VIEW_RAD,
        "min_range": float(mount.range_min_m),
        "max_range": float(mount.range_max_m),
        "range": inf if m.range_m is None else float(m.range_m),
    }
    return RosMessage("sensor_msgs/msg/Range", fields)


def battery(m: Status, context: Context) -> RosMessage | None:
    if m.battery is None:
        return None
    fields = {
        "header": header(m.t_ns, context.frame("base_link")),
        "voltage": float(m.battery.voltage_v),
        "percentage": nan if m.battery.remaining is None else float(m.battery.remaining),
        "current": nan,
        "charge": nan,
        "capacity": nan,
        "design_capacity": nan,
        "temperature": nan,
        "present": True,
        "power_supply_status": DISCHARGING,
        "power_supply_technology": LIPO,
    }
    return RosMessage("sensor_msgs/msg/BatteryState", fields)


def wind(m: Status, context: Context) -> RosMessage | None:
    if m.wind_ned_mps is None:
        return None
    fields = {"header": header(m.t_ns, context.frame("map")), "vector": vector(enu_from_ned(m.wind_ned_mps))}
    return RosMessage("geometry_msgs/msg/Vector3Stamped", fields)


def status_diagnostics(m: Status, context: Context) -> RosMessage:
    values = {
        "code": f"{m.code} {m.name}",
        "in_charge": m.in_charge,
        "action": m.action,
        "goal_id": m.goal_id,
        "armed": str(m.armed).lower(),
        "landed": str(m.landed).lower(),
        "autopilot_mode": m.autopilot_mode,
        "ready": str(m.ready).lower(),
    }
    return _diagnostics(m.t_ns, f"{context.vehicle}: vehicle", "ok" if m.ready else "degraded", _sentence(m), values)


def service_diagnostics(m: ServiceHealth, context: Context) -> RosMessage:
    values = {"process": m.process, "late_s": f"{m.late_s:.3f}", "failed_steps": str(m.failed_steps)}
    if m.last_error:
        values["last_error"] = m.last_error
    return _diagnostics(m.t_ns, f"{context.vehicle}: {m.service}", m.state, m.text, values)


# -- the rover -------------------------------------------------------------------------------------------


def relative_pose(m: Relative, context: Context) -> RosMessage | None:
    """Only while the estimate is valid."""
    if not m.valid:
        return None
    ahead_m, right_m, down_m = rotate_yaw(m.pos_uav_rel_rover_ned_m, -m.yaw_rover_rad)
    height_m = context.config.airframe.height_stand_m
    turned = quat_multiply(quat_conjugate(q_enu_from_heading(m.yaw_rover_rad)), q_enu_from_flu(context.q_ned_from_frd))
    at = pose((ahead_m, -right_m, -down_m + height_m), turned)
    axes = (
        rotate_yaw((1.0, 0.0, 0.0), m.yaw_rover_rad),
        rotate_yaw((0.0, -1.0, 0.0), m.yaw_rover_rad),
        (0.0, 0.0, -1.0),
    )
    block = turned_covariance(_upper_3(m.cov), axes)
    with_covariance = RosMessage(
        "geometry_msgs/msg/PoseWithCovariance", {"pose": at, "covariance": covariance([UNKNOWN_M2] * 6, block)}
    )
    fields = {"header": header(m.t_ns, context.frame("platform")), "pose": with_covariance}
    return RosMessage("geometry_msgs/msg/PoseWithCovarianceStamped", fields)


def lease(m: Relative, context: Context) -> RosMessage | None:
    """The lease in force: when it begins or changes, once a second while it lasts, and its release.

    Only the first one has the prior position: the filter restarts there once, and renewals keep it.
    """
    held = context.lease
    if held is not None and held.goal_id != m.goal_id:
        context.lease = None
        return to_exact(replace(held, release=True))
    if not m.goal_id:
        return None
    seen = Lease(goal_id=m.goal_id, use_uwb=m.use_uwb, use_tag=m.use_tag)
    if seen == held and 0 <= m.t_ns - context.lease_ns < LEASE_PERIOD_NS:
        return None
    context.lease, context.lease_ns = seen, m.t_ns
    return to_exact(seen if held is not None else replace(seen, pos_rover_ned_m=context.prior_of(m.goal_id)))


def rover_odometry(m: RoverOdometry, context: Context) -> RosMessage:
    north_m, east_m = m.pos_odom_m
    moving = twist((m.speed_rover_body_mps, 0.0, 0.0), (0.0, 0.0, -m.yaw_rate_rover_rps))
    attitude = q_enu_from_flu(quat_from_euler(m.roll_rover_rad, m.pitch_rover_rad, m.yaw_rover_rad))
    at = pose((east_m, north_m, 0.0), attitude)
    fields = {
        "header": header(m.t_ns, context.frame("rover_odom")),
        "child_frame_id": context.frame("rover"),
        "pose": _with_covariance("Pose", at, [UNKNOWN_M2] * 6),
        "twist": _with_covariance("Twist", moving, [UNKNOWN_M2] * 6),
    }
    return RosMessage("nav_msgs/msg/Odometry", fields)


def rover_command(m: RoverCommand, context: Context) -> RosMessage:
    return twist((m.speed_rover_body_mps, 0.0, 0.0), (0.0, 0.0, -m.yaw_rate_rover_rps))


def rover_pose(m: RoverEstimate, context: Context) -> RosMessage | None:
    if not m.valid:
        return None
    at = pose(enu_from_ned(m.pos_rover_ned_m), q_enu_from_heading(m.yaw_rover_rad))
    pose_and_covariance = _with_covariance("Pose", at, [m.std_pos_m**2] * 3 + [UNKNOWN_M2] * 3)
    fields = {"header": header(m.t_ns, context.frame("map")), "pose": pose_and_covariance}
    return RosMessage("geometry_msgs/msg/PoseWithCovarianceStamped", fields)


def rover_transform(m: RoverEstimate, context: Context) -> RosMessage | None:
    if not m.valid:
        return None
    rotation = q_enu_from_heading(m.yaw_rover_rad)
    parent, child = context.frame("map"), context.frame("platform")
    return transforms(transform(m.t_ns, parent, child, enu_from_ned(m.pos_rover_ned_m), rotation))


# -- the camera ------------------------------------------------------------------------------------------


def image(m: CameraFrame, context: Context) -> RosMessage:
    fields = {
        "header": header(m.t_ns, context.frame("camera_optical")),
        "height": m.height_px,
        "width": m.width_px,
        "encoding": RGB,
        "is_bigendian": 0,
        "step": 3 * m.width_px,
        "data": array("B", m.pixels),
    }
    return RosMessage("sensor_msgs/msg/Image", fields)


def compressed_preview(m: CameraPreview, context: Context) -> RosMessage:
    fields = {
        "header": header(m.t_ns, context.frame("camera_optical")),
        "format": "jpeg",
        "data": array("B", m.jpeg),
    }
    return RosMessage("sensor_msgs/msg/CompressedImage", fields)


def camera_info(m: CameraFrame, context: Context) -> RosMessage | None:
    """The intrinsics, with the time of an image: ROS finds the intrinsics of an image by its time."""
    info = context.camera_info
    if info is None:
        return None
    fx, fy = info.focal_px, info.focal_px * info.aspect
    cx, cy = info.center_px
    fields = {
        "header": header(m.t_ns, context.frame("camera_optical")),
        "height": info.height_px,
        "width": info.width_px,
        "distortion_model": model_of(info.distortion),
        "d": [float(each) for each in info.distortion],
        "k": [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        "r": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "p": [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    }
    return RosMessage("sensor_msgs/msg/CameraInfo", fields)


def camera_transform(m: CameraPreview, context: Context) -> RosMessage | None:
    """Pose of the camera, from the previews: they also come while nobody subscribes to the images."""
    info = context.camera_info
    if info is None:
        return None
    rotation = q_flu_from_camera(q_frd_from_camera(m.pitch_camera_rad, m.roll_camera_rad, info.turn_camera_rad))
    parent, child = context.frame("base_link"), context.frame("camera_optical")
    return transforms(transform(m.t_ns, parent, child, flu_from_frd(info.pos_camera_frd_m), rotation))


# -- markers ---------------------------------------------------------------------------------------------


def path(t_ns: int, corners_ned_m: Iterable[Vec3], context: Context) -> RosMessage:
    """A way in `map`."""
    at = header(t_ns, context.frame("map"))
    poses = [
        RosMessage("geometry_msgs/msg/PoseStamped", {"header": at, "pose": pose(context.center_enu_m(corner), UPRIGHT)})
        for corner in corners_ned_m
    ]
    return RosMessage("nav_msgs/msg/Path", {"header": at, "poses": poses})


def flown_path(m: Odometry, context: Context) -> RosMessage | None:
    """Only when the vehicle has moved on."""
    return path(m.t_ns, context.trail_ned_m, context) if context.extend_trail(m.pos_uav_ned_m) else None


def uncertainty(m: Relative, context: Context) -> RosMessage | None:
    """A box-aligned ellipsoid of two standard deviations about the vehicle, in the platform's frame."""
    at = relative_pose(m, context)
    if at is None:
        return None
    values = at.fields["pose"].fields["covariance"]
    stds_m = [sqrt(max(values[7 * i], 0.0)) for i in range(3)]
    fields = {
        "header": at.fields["header"],
        "ns": "uncertainty",
        "type": SPHERE,
        "action": ADD,
        "pose": pose(_xyz(at.fields["pose"].fields["pose"].fields["position"]), UPRIGHT),
        "scale": vector((2.0 * SIGMAS * stds_m[0], 2.0 * SIGMAS * stds_m[1], 2.0 * SIGMAS * stds_m[2])),
        "color": _color(0.2, 0.6, 1.0, 0.4),
    }
    return RosMessage("visualization_msgs/msg/Marker", fields)


def fence_markers(m: FenceState, context: Context) -> RosMessage:
    """A line around each zone, at the ground and at the ceiling; without a fence the old ones are deleted."""
    at = header(m.t_ns, context.frame("map"))
    nowhere = pose((0.0, 0.0, 0.0), UPRIGHT)
    markers = [
        RosMessage(
            "visualization_msgs/msg/Marker", {"header": at, "ns": "fence", "action": DELETE_ALL, "pose": nowhere}
        )
    ]
    fence = m.fence
    if fence is not None:
        heights_m = (0.0,) if fence.ceiling_m is None else (0.0, fence.ceiling_m)
        for zone in fence.zones:
            color = _color(0.1, 0.8, 0.1, 1.0) if zone is fence.keep_in else _color(0.9, 0.1, 0.1, 1.0)
            for height_m in heights_m:
                markers.append(_outline(at, len(markers), zone, height_m, color))
    return RosMessage("visualization_msgs/msg/MarkerArray", {"markers": markers})


def _outline(at: RosMessage, number: int, zone: Zone, height_m: float, color: RosMessage) -> RosMessage:
    corners = [*zone.corners_ned_m, *zone.corners_ned_m[:1]]
    fields = {
        "header": at,
        "ns": "fence",
        "id": number,
        "type": LINE_STRIP,
        "action": ADD,
        "pose": pose((0.0, 0.0, 0.0), UPRIGHT),
        "scale": vector((0.1, 0.0, 0.0)),
        "color": color,
        "points": [point((east_m, north_m, height_m)) for north_m, east_m in corners],
    }
    return RosMessage("visualization_msgs/msg/Marker", fields)


# -- parts -----------------------------------------------------------------------------------------------


def _xyz(position: RosMessage) -> Vec3:
    return (position.fields["x"], position.fields["y"], position.fields["z"])


def _upper_3(upper_6: tuple[float, ...]) -> tuple[float, ...]:
    """Upper triangle of the first three rows and columns, from that of a 6x6 matrix."""
    return (*upper_6[0:3], *upper_6[6:8], upper_6[11])


def _with_covariance(kind: str, value: RosMessage, variances: list[float]) -> RosMessage:
    fields = {kind.lower(): value, "covariance": covariance(variances)}
    return RosMessage(f"geometry_msgs/msg/{kind}WithCovariance", fields)


def _color(red: float, green: float, blue: float, alpha: float) -> RosMessage:
    return RosMessage("std_msgs/msg/ColorRGBA", {"r": red, "g": green, "b": blue, "a": alpha})


def _sentence(m: Status) -> str:
    return m.not_ready_reason or m.text


def _diagnostics(t_ns: int, name: str, state: str, text: str, values: dict[str, str]) -> RosMessage:
    pairs = [RosMessage("diagnostic_msgs/msg/KeyValue", {"key": key, "value": value}) for key, value in values.items()]
    one = {
        "level": LEVELS[state],
        "name": name,
        "message": text,
        "hardware_id": name.partition(":")[0],
        "values": pairs,
    }
    fields = {"header": header(t_ns, ""), "status": [RosMessage("diagnostic_msgs/msg/DiagnosticStatus", one)]}
    return RosMessage("diagnostic_msgs/msg/DiagnosticArray", fields)


# -- frames and time -------------------------------------------------------------------------------------


def static_transforms(context: Context, t_ns: int) -> RosMessage:
    """Frames that never move in their parent frame: the vehicle's sensors, the UWB tag, and the rover's anchors."""
    vehicle, base, platform = context.config, context.frame("base_link"), context.frame("platform")
    down = (sqrt(0.5), 0.0, sqrt(0.5), 0.0)  # x of the frame points down
    found = [
        transform(t_ns, base, context.frame("imu"), (0.0, 0.0, 0.0), UPRIGHT),
        transform(t_ns, base, context.frame("altimeter"), flu_from_frd(vehicle.altimeter.pos_altimeter_frd_m), down),
        transform(t_ns, base, context.frame("uwb"), flu_from_frd(vehicle.uwb.pos_tag_frd_m), UPRIGHT),
    ]
    for i, place_m in enumerate(vehicle.uwb.pos_anchors_rover_body_m):
        found.append(transform(t_ns, platform, context.frame(f"anchor_{i}"), flu_from_frd(place_m), UPRIGHT))
    return transforms(*found)


def clock(t_ns: int) -> RosMessage:
    """Message of `/clock`."""
    return RosMessage("rosgraph_msgs/msg/Clock", {"clock": time(t_ns)})
