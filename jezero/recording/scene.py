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

from collections.abc import Iterable, Iterator
from contextlib import suppress
from math import sqrt
from typing import Any

import msgspec

from jezero.frames import Quat, Vec3, geodetic_from_ned, q_frd_from_camera, quat_from_euler, subtract
from jezero.recording import foxglove as fg
from jezero.recording.images import CAMERA_FRAME, HEADERS
from jezero.recording.models import Shapes, rover_shapes, vehicle_shapes
from jezero.recording.thinned_path import ThinnedPath
from jezero.schemas import topics
from jezero.schemas.commands import CameraPitch, Setpoint
from jezero.schemas.estimate import RoverEstimate
from jezero.schemas.sensors import CameraFrame, CameraInfo, TagCorners
from jezero.schemas.state import Odometry, Status, Truth
from jezero.schemas.units import NS_PER_S
from jezero.vehicle_config import VehicleConfig

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
ANGLES_AGE_MAX_NS = NS_PER_S // 2
"""A camera whose angles are unknown for longer is drawn at rest."""

MAP, WORLD, FRD, ROVER, FRD_TRUE, ROVER_TRUE = "map", "world", "frd", "rover_body", "frd_true", "rover_body_true"
Q_ENU_FROM_NED: Quat = (0.0, sqrt(0.5), sqrt(0.5), 0.0)
ORIGIN: Vec3 = (0.0, 0.0, 0.0)

BLUE, ORANGE, GREEN = fg.Color(0.2, 0.5, 1.0), fg.Color(1.0, 0.55, 0.1), fg.Color(0.3, 0.75, 0.3)
WHITE, BLACK, GHOST = fg.Color(1.0, 1.0, 1.0), fg.Color(0.05, 0.05, 0.05), fg.Color(0.6, 0.6, 0.6, 0.35)

_INPUTS: dict[str, Any] = {
    HEADERS: CameraFrame,
    **{
        topic.name: topic.type
        for topic in (
            topics.ODOMETRY, topics.TRUTH, topics.ROVER_ESTIMATE, topics.SETPOINT, topics.STATUS,
            topics.CAMERA_INFO, topics.TAG_CORNERS, topics.CAMERA_PITCH,
        )
    },
}  # fmt: skip


class Scene:
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
        self._decoders: dict[str, msgspec.json.Decoder[Any]] = {
            name: msgspec.json.Decoder(message) for name, message in _INPUTS.items()
        }
        self._new: dict[str, bytes] = {}
        self._next_ns, self._next_scene_ns = 0, 0
        self._transforms: dict[str, fg.FrameTransform] = {}
        self._posed_ns: dict[str, int] = {}
        """Time of the newest pose of vehicle and rover, by frame."""
        self._angles_ns: int | None = None
        self._odometry: Odometry | None = None
        self._setpoint: Setpoint | None = None
        self._status: Status | None = None
        self._flown, self._planned = ThinnedPath(), ThinnedPath()

    def update(self, logged_ns: int, topic: str, data: bytes) -> Iterable[tuple[str, bytes]]:
        """Take in a message, and return the messages for viewers that are due, each (channel, encoded message).

        Args:
            logged_ns: time of arrival; never smaller than before.
            topic: name of the message's channel in a recording.
            data: the encoded message. One that can't be decoded is not drawn.
        """
        if topic in self._decoders:
            self._new[topic] = data  # decoded only if it is still the newest one when messages are due
        if logged_ns < self._next_ns:
            return ()
        self._next_ns = logged_ns + PERIOD_NS
        return self._due(logged_ns)

    def _due(self, t_ns: int) -> Iterator[tuple[str, bytes]]:
        new = self._decoded()
        self._update_vehicle(t_ns, new.get(topics.ODOMETRY.name), new.get(topics.TRUTH.name))
        self._update_rover(t_ns, new.get(topics.ROVER_ESTIMATE.name))
        angles = new.get(HEADERS) or new.get(topics.TAG_CORNERS.name) or new.get(topics.CAMERA_PITCH.name)
        self._update_camera(t_ns, angles)
        self._update_setpoint(new.get(topics.SETPOINT.name))
        self._status = new.get(topics.STATUS.name, self._status)
        self._set_pose(t_ns, MAP, WORLD, ORIGIN, Q_ENU_FROM_NED)
        yield TRANSFORMS, msgspec.json.encode(fg.FrameTransforms(tuple(self._transforms.values())))
        if topics.ODOMETRY.name in new and self._odometry is not None and self._odometry.origin_deg is not None:
            yield LOCATION, msgspec.json.encode(_location(t_ns, self._odometry, self._odometry.origin_deg))
        if topics.CAMERA_INFO.name in new:
            yield CALIBRATION, msgspec.json.encode(_calibration(t_ns, new[topics.CAMERA_INFO.name]))
        if t_ns >= self._next_scene_ns:
            self._next_scene_ns = t_ns + SCENE_PERIOD_NS
            yield SCENE, msgspec.json.encode(fg.SceneUpdate(tuple(self._entities(t_ns))))

    def _decoded(self) -> dict[str, Any]:
        decoded = {}
        for topic, data in self._new.items():
            with suppress(msgspec.DecodeError, UnicodeDecodeError):
                decoded[topic] = self._decoders[topic].decode(data)
        self._new.clear()
        return decoded

    # -- poses --

    def _update_vehicle(self, t_ns: int, odometry: Odometry | None, truth: Truth | None) -> None:
        if odometry is not None:
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
        if truth is not None:
            self._set_pose(t_ns, WORLD, FRD_TRUE, self._center(truth.pos_uav_ned_m), truth.q_ned_from_frd)
            q_rover = quat_from_euler(truth.roll_rover_rad, truth.pitch_rover_rad, truth.yaw_rover_rad)
            self._set_pose(t_ns, WORLD, ROVER_TRUE, truth.pos_rover_ned_m, q_rover)

    def _center(self, pos_uav_ned_m: Vec3) -> Vec3:
        """Centre of mass from a position as `Odometry` and `Truth` have it, which is lowered."""
        north_m, east_m, down_m = pos_uav_ned_m
        return (north_m, east_m, down_m - self._height_stand_m)

    def _update_rover(self, t_ns: int, rover: RoverEstimate | None) -> None:
        if rover is not None and rover.valid:
            self._set_pose(t_ns, WORLD, ROVER, rover.pos_rover_ned_m, quat_from_euler(0.0, 0.0, rover.yaw_rover_rad))

    def _update_camera(self, t_ns: int, angles: CameraFrame | TagCorners | CameraPitch | None) -> None:
        if angles is not None:
            self._angles_ns = t_ns
            pitch_rad, roll_rad = angles.pitch_camera_rad, angles.roll_camera_rad
        elif self._angles_ns is None or t_ns - self._angles_ns > ANGLES_AGE_MAX_NS:
            pitch_rad, roll_rad = self._camera.pitch_rest_rad, self._camera.roll_offset_rad
        else:
            return
        q_frd = q_frd_from_camera(pitch_rad, roll_rad, self._camera.turn_rad)
        self._set_pose(t_ns, FRD, CAMERA_FRAME, self._camera.pos_camera_frd_m, q_frd)

    def _update_setpoint(self, setpoint: Setpoint | None) -> None:
        if setpoint is None:
            return
        if self._setpoint is None or setpoint.control_id != self._setpoint.control_id:
            self._planned.clear()
        self._setpoint = setpoint
        if setpoint.pos_ned_m is not None:
            self._planned.add(setpoint.pos_ned_m)

    def _set_pose(self, t_ns: int, parent: str, child: str, pos_m: Vec3, q_parent_from_child: Quat) -> None:
        w, x, y, z = q_parent_from_child
        self._posed_ns[child] = t_ns
        self._transforms[child] = fg.FrameTransform(
            fg.time_of(t_ns), parent, child, fg.Vector3(*pos_m), fg.Quaternion(x, y, z, w)
        )

    # -- entities --

    def _entities(self, t_ns: int) -> Iterator[fg.SceneEntity]:
        for frame, shapes in self._shapes.items():
            if t_ns - self._posed_ns.get(frame, -SCENE_PERIOD_NS) < SCENE_PERIOD_NS:
                yield _entity(t_ns, frame, frame, shapes)
        yield _entity(t_ns, "path flown", WORLD, _line(self._flown, BLUE))
        yield _entity(t_ns, "path of the setpoints", WORLD, _line(self._planned, ORANGE))
        if self._status is not None and FRD in self._transforms:
            pose = fg.Pose(fg.Vector3(0.0, 0.0, -0.5))
            text = fg.TextPrimitive(pose, self._status.name.replace("_", " "), WHITE, font_size=16.0)
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


def _calibration(t_ns: int, camera: CameraInfo) -> fg.CameraCalibration:
    focal_px, (x_px, y_px) = camera.focal_px, camera.center_px
    return fg.CameraCalibration(
        timestamp=fg.time_of(t_ns),
        frame_id=CAMERA_FRAME,
        width=camera.width_px,
        height=camera.height_px,
        distortion_model="plumb_bob",
        D=camera.distortion,
        K=(focal_px, 0.0, x_px, 0.0, focal_px, y_px, 0.0, 0.0, 1.0),
        R=(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
        P=(focal_px, 0.0, x_px, 0.0, 0.0, focal_px, y_px, 0.0, 0.0, 0.0, 1.0, 0.0),
    )
