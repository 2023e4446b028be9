"""The flight as a scene for 3D viewers: frames, vehicle, rover and paths, made from recorded messages.

In Foxglove the z axis points up. So the root frame is `map`: east, north, up, with the origin of the world frame.
Everything else is below it, in jezero's own axes:

    map                         east, north, up
    └── world                   north, east, down
        ├── frd                 vehicle by the autopilot's estimate: forward, right, down of the centre of mass
        │   └── camera          right, down, forward
        ├── rover_body          platform by the estimator: forward, right, down of the middle of its surface
        ├── frd_true            vehicle by the simulator's truth
        └── rover_body_true     platform by the simulator's truth

The truth's origin is where the vehicle first stood; the world frame differs from it by the autopilot's error.

A viewer that jumps to another time gets the last message of each channel only. So each message is complete: the paths
are thinned to a limited number of points and repeated, and a second of a long flight costs no more than one of a short
flight.
"""

from collections.abc import Callable, Iterable, Iterator
from math import sqrt
from typing import Any, TypedDict

import msgspec

from jezero.base.frames import Quat, Vec3, geodetic_from_ned, q_frd_from_camera, quat_from_euler, subtract
from jezero.base.vehicle_config import PLATFORM_THICKNESS_M, AirframeConfig, PlatformConfig, VehicleConfig
from jezero.recording import foxglove as fg
from jezero.recording.images import CAMERA_FRAME, HEADERS
from jezero.recording.thinned_path import ThinnedPath
from jezero.schemas import topics
from jezero.schemas.commands import CameraPitch, Setpoint
from jezero.schemas.estimate import RoverEstimate
from jezero.schemas.sensors import CameraFrame, CameraInfo, DistortionModel, TagCorners, model_of
from jezero.schemas.state import Odometry, Status, Truth
from jezero.schemas.units import NS_PER_S

TRANSFORMS, SCENE = "viewer/transforms", "viewer/scene"
LOCATION, CALIBRATION = "viewer/location", "viewer/calibration"
MESSAGES: dict[str, type[msgspec.Struct]] = {
    TRANSFORMS: fg.FrameTransforms,
    SCENE: fg.SceneUpdate,
    LOCATION: fg.LocationFix,
    CALIBRATION: fg.CameraCalibration,
}
"""Channels that are made for viewers; no topic of the bus begins with `viewer/`."""

PERIOD_NS = NS_PER_S // 10
SCENE_PERIOD_NS = NS_PER_S
LIFETIME = fg.Duration(3)
"""What is not drawn any more, such as a rover whose estimate is invalid, disappears after this duration."""
LATENESS_MAX_NS = NS_PER_S
"""A message that would be older belongs to another epoch, with a vehicle time of its own."""
ANGLES_AGE_MAX_NS = NS_PER_S // 2
"""A camera whose angles are unknown for longer is drawn at rest."""

MAP, WORLD, FRD, ROVER, FRD_TRUE, ROVER_TRUE = "map", "world", "frd", "rover_body", "frd_true", "rover_body_true"
Q_ENU_FROM_NED: Quat = (0.0, sqrt(0.5), sqrt(0.5), 0.0)
ORIGIN: Vec3 = (0.0, 0.0, 0.0)

TAG_THICKNESS_M = 0.004
BLUE, ORANGE, GREEN = fg.Color(0.2, 0.5, 1.0), fg.Color(1.0, 0.55, 0.1), fg.Color(0.3, 0.75, 0.3)
WHITE, BLACK, GHOST = fg.Color(1.0, 1.0, 1.0), fg.Color(0.05, 0.05, 0.05), fg.Color(0.6, 0.6, 0.6, 0.35)

Made = Iterable[tuple[str, bytes]]
"""Messages for viewers, each (channel, encoded message)."""


class Shapes(TypedDict, total=False):
    """Primitives of a `SceneEntity`, by the names of its fields."""

    arrows: tuple[fg.ArrowPrimitive, ...]
    cubes: tuple[fg.CubePrimitive, ...]
    cylinders: tuple[fg.CylinderPrimitive, ...]
    lines: tuple[fg.LinePrimitive, ...]
    texts: tuple[fg.TextPrimitive, ...]


class ViewerScene:
    """Collects the newest messages, and makes those for viewers ten times a second.

    Args:
        vehicle: the robot, for the sizes of what is drawn.
    """

    def __init__(self, vehicle: VehicleConfig) -> None:
        self._height_stand_m = vehicle.airframe.height_stand_m
        self._camera = vehicle.camera
        self._shapes: dict[str, Shapes] = {
            FRD: vehicle_shapes(vehicle.airframe, BLUE),
            ROVER: rover_shapes(vehicle.platform, GREEN, BLACK),
            FRD_TRUE: vehicle_shapes(vehicle.airframe, GHOST),
            ROVER_TRUE: rover_shapes(vehicle.platform, GHOST, GHOST),
        }
        self._inputs: dict[str, tuple[msgspec.json.Decoder[Any], Callable[[int, Any], Made]]] = {
            topics.ODOMETRY.name: (msgspec.json.Decoder(Odometry), self._on_odometry),
            topics.TRUTH.name: (msgspec.json.Decoder(Truth), self._on_truth),
            topics.ROVER_ESTIMATE.name: (msgspec.json.Decoder(RoverEstimate), self._on_rover),
            topics.SETPOINT.name: (msgspec.json.Decoder(Setpoint), self._on_setpoint),
            topics.STATUS.name: (msgspec.json.Decoder(Status), self._on_status),
            topics.CAMERA_INFO.name: (msgspec.json.Decoder(CameraInfo), self._on_camera_info),
            topics.TAG_CORNERS.name: (msgspec.json.Decoder(TagCorners), self._on_image),
            HEADERS: (msgspec.json.Decoder(CameraFrame), self._on_image),
            topics.CAMERA_PITCH.name: (msgspec.json.Decoder(CameraPitch), self._on_camera_pitch),
        }
        """Decoder and handler of each input; the odometry first, as the times of the others follow from it."""
        self._new: dict[str, tuple[int, bytes]] = {}
        """Newest message of each input that is not decoded yet, with its time of arrival."""
        self._next_ns, self._next_scene_ns = 0, 0
        self._vehicle_start_ns: int | None = None
        """Time on the recording's clock at which vehicle time was 0, by the newest odometry."""
        self._transforms: dict[str, fg.FrameTransform] = {}
        self._posed_ns: dict[str, int] = {}
        """Time of the newest pose of each frame."""
        self._image_ns = self._pitch_ns = -NS_PER_S
        """Times of the newest angles of the camera, from an image and from a command."""
        self._odometry: Odometry | None = None
        self._control_id = ""
        self._status = ""
        self._flown, self._planned = ThinnedPath(), ThinnedPath()

    def update(self, logged_ns: int, topic: str, data: bytes) -> Made:
        """Take in a message, and return the messages for viewers that are due.

        Args:
            logged_ns: time of arrival; never smaller than before.
            topic: name of the message's channel in a recording.
            data: the encoded message. One that can't be decoded is not drawn.
        """
        if topic in self._inputs:
            self._new[topic] = (logged_ns, data)  # decoded only if it is still the newest one when messages are due
        if logged_ns < self._next_ns:
            return ()
        self._next_ns = logged_ns + PERIOD_NS
        return self._due(logged_ns)

    def time_of(self, t_ns: int, logged_ns: int) -> int:
        """Time on the recording's clock at which the content of a message was true.

        An image arrives a tenth of a second after its exposure, when the vehicle is elsewhere already.

        Args:
            t_ns: the message's vehicle time.
            logged_ns: time of its arrival.
        """
        if self._vehicle_start_ns is None:
            return logged_ns
        return min(max(self._vehicle_start_ns + t_ns, logged_ns - LATENESS_MAX_NS), logged_ns)

    def _due(self, now_ns: int) -> Iterator[tuple[str, bytes]]:
        for topic, (decoder, handle) in self._inputs.items():
            if topic not in self._new:
                continue
            logged_ns, data = self._new.pop(topic)
            try:
                message = decoder.decode(data)
            except (msgspec.DecodeError, UnicodeDecodeError):
                continue
            if topic == topics.ODOMETRY.name:
                self._vehicle_start_ns = logged_ns - message.t_ns
            yield from handle(self.time_of(message.t_ns, logged_ns), message)
        if now_ns - max(self._image_ns, self._pitch_ns) > ANGLES_AGE_MAX_NS:
            self._set_camera(now_ns, self._camera.pitch_rest_rad, self._camera.roll_offset_rad)
        self._set_pose(now_ns, MAP, WORLD, ORIGIN, Q_ENU_FROM_NED)
        yield TRANSFORMS, msgspec.json.encode(fg.FrameTransforms(tuple(self._transforms.values())))
        if now_ns >= self._next_scene_ns:
            self._next_scene_ns = now_ns + SCENE_PERIOD_NS
            yield SCENE, msgspec.json.encode(fg.SceneUpdate(tuple(self._entities(now_ns))))

    # -- messages --

    def _on_odometry(self, t_ns: int, odometry: Odometry) -> Made:
        last, self._odometry = self._odometry, odometry
        if last is not None and last.epoch_id != odometry.epoch_id:
            self._flown.clear()
            self._planned.clear()
        elif last is not None and last.reset_offset_ned_m != odometry.reset_offset_ned_m:
            step_m = subtract(odometry.reset_offset_ned_m, last.reset_offset_ned_m)
            self._flown.shift(step_m)
            self._planned.shift(step_m)
        self._flown.add(odometry.pos_uav_ned_m)
        self._set_pose(t_ns, WORLD, FRD, self._center(odometry.pos_uav_ned_m), odometry.q_ned_from_frd)
        if odometry.origin_deg is not None:
            yield LOCATION, msgspec.json.encode(_location(t_ns, odometry, odometry.origin_deg))

    def _on_truth(self, t_ns: int, truth: Truth) -> Made:
        self._set_pose(t_ns, WORLD, FRD_TRUE, self._center(truth.pos_uav_ned_m), truth.q_ned_from_frd)
        q_rover = quat_from_euler(truth.roll_rover_rad, truth.pitch_rover_rad, truth.yaw_rover_rad)
        self._set_pose(t_ns, WORLD, ROVER_TRUE, truth.pos_rover_ned_m, q_rover)
        return ()

    def _on_rover(self, t_ns: int, rover: RoverEstimate) -> Made:
        if rover.valid:
            self._set_pose(t_ns, WORLD, ROVER, rover.pos_rover_ned_m, quat_from_euler(0.0, 0.0, rover.yaw_rover_rad))
        return ()

    def _on_setpoint(self, t_ns: int, setpoint: Setpoint) -> Made:
        if setpoint.control_id != self._control_id:
            self._control_id = setpoint.control_id
            self._planned.clear()
        if setpoint.pos_ned_m is not None:
            self._planned.add(setpoint.pos_ned_m)
        return ()

    def _on_status(self, t_ns: int, status: Status) -> Made:
        self._status = status.name.replace("_", " ")
        return ()

    def _on_camera_info(self, t_ns: int, camera: CameraInfo) -> Made:
        yield CALIBRATION, msgspec.json.encode(_calibration(t_ns, camera))

    def _on_image(self, t_ns: int, image: CameraFrame | TagCorners) -> Made:
        self._image_ns = t_ns
        self._set_camera(t_ns, image.pitch_camera_rad, image.roll_camera_rad)
        return ()

    def _on_camera_pitch(self, t_ns: int, angles: CameraPitch) -> Made:
        self._pitch_ns = t_ns
        if t_ns - self._image_ns > ANGLES_AGE_MAX_NS:  # an image has the angles that the camera really had
            self._set_camera(t_ns, angles.pitch_camera_rad, angles.roll_camera_rad)
        return ()

    def _center(self, pos_uav_ned_m: Vec3) -> Vec3:
        """Centre of mass from a position as `Odometry` and `Truth` have it, which is lowered."""
        north_m, east_m, down_m = pos_uav_ned_m
        return (north_m, east_m, down_m - self._height_stand_m)

    def _set_camera(self, t_ns: int, pitch_rad: float, roll_rad: float) -> None:
        q_frd = q_frd_from_camera(pitch_rad, roll_rad, self._camera.turn_rad)
        self._set_pose(t_ns, FRD, CAMERA_FRAME, self._camera.pos_camera_frd_m, q_frd)

    def _set_pose(self, t_ns: int, parent: str, child: str, pos_m: Vec3, q_parent_from_child: Quat) -> None:
        w, x, y, z = q_parent_from_child
        self._posed_ns[child] = t_ns
        self._transforms[child] = fg.FrameTransform(
            fg.time_of(t_ns), parent, child, fg.Vector3(*pos_m), fg.Quaternion(x, y, z, w)
        )

    # -- entities --

    def _entities(self, t_ns: int) -> Iterator[fg.SceneEntity]:
        for frame, shapes in self._shapes.items():
            if frame in self._posed_ns and t_ns - self._posed_ns[frame] < SCENE_PERIOD_NS:
                yield _entity(t_ns, frame, frame, shapes)
        yield _entity(t_ns, "path flown", WORLD, _line(self._flown, BLUE))
        yield _entity(t_ns, "path of the setpoints", WORLD, _line(self._planned, ORANGE))
        if self._status and FRD in self._transforms:
            pose = fg.Pose(fg.Vector3(0.0, 0.0, -0.5))
            text = fg.TextPrimitive(pose, self._status, WHITE, font_size=16.0)
            yield _entity(t_ns, "status", FRD, {"texts": (text,)})


def _entity(t_ns: int, name: str, frame: str, shapes: Shapes) -> fg.SceneEntity:
    return fg.SceneEntity(timestamp=fg.time_of(t_ns), frame_id=frame, id=name, lifetime=LIFETIME, **shapes)


def _line(path: ThinnedPath, color: fg.Color) -> Shapes:
    points = tuple(fg.Vector3(*(round(part_m, 3) for part_m in point_m)) for point_m in path.points_m)
    return {"lines": (fg.LinePrimitive(fg.LINE_STRIP, points, color, thickness=2.0),)}


def _location(t_ns: int, odometry: Odometry, origin_deg: Vec3) -> fg.LocationFix:
    latitude_deg, longitude_deg, altitude_m = geodetic_from_ned(odometry.pos_uav_ned_m, origin_deg)
    known = odometry.std_pos_m is not None
    var_m2 = odometry.std_pos_m**2 if odometry.std_pos_m is not None else 0.0
    return fg.LocationFix(
        timestamp=fg.time_of(t_ns),
        frame_id=FRD,
        latitude=latitude_deg,
        longitude=longitude_deg,
        altitude=altitude_m,
        position_covariance=(var_m2, 0.0, 0.0, 0.0, var_m2, 0.0, 0.0, 0.0, var_m2),
        position_covariance_type=fg.COVARIANCE_APPROXIMATED if known else fg.COVARIANCE_UNKNOWN,
    )


FOXGLOVE_MODELS: dict[DistortionModel, str] = {
    "plumb_bob": "plumb_bob",
    "rational_polynomial": "rational_polynomial",
    "equidistant": "kannala_brandt",
}
"""Foxglove's names of the models of lenses."""


def _calibration(t_ns: int, camera: CameraInfo) -> fg.CameraCalibration:
    focal_px, (x_px, y_px) = camera.focal_px, camera.center_px
    down_px = focal_px * camera.aspect
    return fg.CameraCalibration(
        timestamp=fg.time_of(t_ns),
        frame_id=CAMERA_FRAME,
        width=camera.width_px,
        height=camera.height_px,
        distortion_model=FOXGLOVE_MODELS[model_of(camera.distortion)],
        D=camera.distortion,
        K=(focal_px, 0.0, x_px, 0.0, down_px, y_px, 0.0, 0.0, 1.0),
        R=(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
        P=(focal_px, 0.0, x_px, 0.0, 0.0, down_px, y_px, 0.0, 0.0, 0.0, 1.0, 0.0),
    )


# -- what vehicle and rover look like, in their own frames -----------------------------------------------


def vehicle_shapes(airframe: AirframeConfig, color: fg.Color) -> Shapes:
    """The vehicle in its frame `frd`: body, rotors, feet, and an arrow that points ahead."""
    rotors_m = [(forward_m, right_m, -0.04) for forward_m, right_m in airframe.pos_rotors_frd_m]
    diameter_m = 2.0 * airframe.radius_rotor_m
    forward_m, right_m = airframe.feet_frd_m
    legs_m: list[Vec3] = []
    for ahead in (1.0, -1.0):
        for side in (1.0, -1.0):
            legs_m.append((0.4 * ahead * forward_m, 0.4 * side * right_m, 0.0))
            legs_m.append((ahead * forward_m, side * right_m, airframe.height_stand_m))
    arms_m = [point_m for rotor_m in rotors_m for point_m in ((0.0, 0.0, -0.02), rotor_m)]
    return {
        "cubes": (_box((0.0, 0.0, 0.0), (0.24, 0.12, 0.08), color),),
        "cylinders": tuple(
            fg.CylinderPrimitive(fg.Pose(fg.Vector3(*rotor_m)), fg.Vector3(diameter_m, diameter_m, 0.01), color)
            for rotor_m in rotors_m
        ),
        "lines": (
            fg.LinePrimitive(fg.LINE_LIST, tuple(fg.Vector3(*point_m) for point_m in (*arms_m, *legs_m)), color, 2.0),
        ),
        "arrows": (_arrow_ahead((0.12, 0.0, 0.0), color),),
    }


def rover_shapes(platform: PlatformConfig, color: fg.Color, color_tag: fg.Color) -> Shapes:
    """The rover in its frame `rover_body`: platform with its biggest tag, body, and an arrow that points ahead."""
    side_m, height_m = platform.side_m, platform.height_m
    body_m = (0.8 * side_m, 0.6 * side_m, 0.7 * height_m)
    tag = max(platform.board, key=lambda tag: tag.side_m)
    return {
        "cubes": (
            _box((0.0, 0.0, 0.5 * PLATFORM_THICKNESS_M), (side_m, side_m, PLATFORM_THICKNESS_M), color),
            _box((0.0, 0.0, 0.5 * body_m[2] + PLATFORM_THICKNESS_M), body_m, color),
            _box(tag.pos_rover_body_m, (tag.side_m, tag.side_m, TAG_THICKNESS_M), color_tag),
        ),
        "arrows": (_arrow_ahead((0.5 * side_m, 0.0, 0.5 * PLATFORM_THICKNESS_M), color),),
    }


def _box(center_m: Vec3, size_m: Vec3, color: fg.Color) -> fg.CubePrimitive:
    return fg.CubePrimitive(fg.Pose(fg.Vector3(*center_m)), fg.Vector3(*size_m), color)


def _arrow_ahead(tail_m: Vec3, color: fg.Color) -> fg.ArrowPrimitive:
    return fg.ArrowPrimitive(fg.Pose(fg.Vector3(*tail_m)), 0.1, 0.03, 0.08, 0.08, color)
