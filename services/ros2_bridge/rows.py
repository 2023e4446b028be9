"""The table of ROS topics: what each is made from, its type, its frames and its quality of service; and the services.

The bridge, the export of rosbags and the reference page read it. Names of topics and frames are below the vehicle's:
`/uav1/odometry`, `uav1/base_link`.
"""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

from jezero.schemas import topics
from jezero.schemas.health import ServiceHealth
from jezero.schemas.rows import Endpoint, Topic
from jezero.services.ros2_bridge import conversions as make
from jezero.services.ros2_bridge.conversions import Context
from jezero.services.ros2_bridge.exact import to_exact, type_name, with_parts
from jezero.services.ros2_bridge.geometry import RosMessage

Quality = Literal["sensor", "state", "latched"]
"""`sensor`: best effort, for streams of which the next reading replaces a lost one. `state`: reliable. `latched`:
reliable, and who subscribes later gets the last message. Source: REP 2003."""
DEPTH: dict[Quality, int] = {"sensor": 5, "state": 10, "latched": 1}
"""Messages that wait for a subscriber."""
Convert = Callable[[Any, Context], RosMessage | None]


@dataclass(frozen=True)
class RosTopic:
    """One ROS topic.

    Attributes:
        name: below the vehicle's namespace; absolute when it begins with "/".
        type: of its messages.
        source: the topic of jezero.
        convert: makes a message.
        quality: of service.
        about: frames and content, for people.
    """

    name: str
    type: str
    source: Topic[Any]
    convert: Convert
    quality: Quality
    about: str


EVERY_HEALTH: Topic[ServiceHealth] = Topic("health/*", ServiceHealth, 1.0, "every service")
TF = "tf2_msgs/msg/TFMessage"
POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
EXACT = "jezero/"
"""Begins the names of topics with whole messages of jezero."""


def exact_name(source: Topic[Any] | Endpoint[Any, Any]) -> str:
    """Name in ROS of a topic with whole messages of jezero."""
    return EXACT + source.name.removeprefix("@")


def _exact(source: Topic[Any], about: str) -> RosTopic:
    return RosTopic(exact_name(source), type_name(source.struct), source, lambda m, _: to_exact(m), "state", about)


ROWS: tuple[RosTopic, ...] = (
    RosTopic(
        "odometry",
        "nav_msgs/msg/Odometry",
        topics.ODOMETRY,
        make.odometry,
        "state",
        "`odom` → `base_link`; the twist is in `base_link`",
    ),
    RosTopic("/tf", TF, topics.ODOMETRY, make.vehicle_transforms, "state", "`map` → `odom` → `base_link`"),
    RosTopic("imu", "sensor_msgs/msg/Imu", topics.IMU, make.imu, "sensor", "in `imu`; without an orientation"),
    RosTopic("fix", "sensor_msgs/msg/NavSatFix", topics.GNSS, make.fix, "sensor", "the receiver's own position"),
    RosTopic("pressure", "sensor_msgs/msg/FluidPressure", topics.BARO, make.pressure, "sensor", "in Pa"),
    RosTopic("mag", "sensor_msgs/msg/MagneticField", topics.MAG, make.magnetic_field, "sensor", "in `imu`, in tesla"),
    RosTopic(
        "altimeter",
        "sensor_msgs/msg/Range",
        topics.ALTIMETER,
        make.altitude_range,
        "sensor",
        "along x of `altimeter`; inf for nothing met",
    ),
    RosTopic(
        "battery",
        "sensor_msgs/msg/BatteryState",
        topics.STATUS,
        make.battery,
        "state",
        "percentage from 0 to 1, NaN for unknown",
    ),
    RosTopic(
        "wind", "geometry_msgs/msg/Vector3Stamped", topics.STATUS, make.wind, "state", "velocity of the air in `map`"
    ),
    RosTopic(
        "/diagnostics",
        "diagnostic_msgs/msg/DiagnosticArray",
        topics.STATUS,
        make.status_diagnostics,
        "state",
        "status of the vehicle",
    ),
    RosTopic(
        "/diagnostics",
        "diagnostic_msgs/msg/DiagnosticArray",
        EVERY_HEALTH,
        make.service_diagnostics,
        "state",
        "health of each service",
    ),
    RosTopic(
        "relative_pose",
        POSE,
        topics.RELATIVE,
        make.relative_pose,
        "state",
        "`base_link` in `platform`, while it is valid",
    ),
    RosTopic(
        "rover/odometry",
        "nav_msgs/msg/Odometry",
        topics.ROVER_ODOMETRY,
        make.rover_odometry,
        "state",
        "`rover_odom` → `rover`, by its wheels and compass",
    ),
    RosTopic(
        "rover/cmd_vel",
        "geometry_msgs/msg/Twist",
        topics.ROVER_COMMAND,
        make.rover_command,
        "state",
        "drive commands of jezero's clients; a rover of ROS must stop when none comes for half a second",
    ),
    RosTopic(
        "rover/pose", POSE, topics.ROVER_ESTIMATE, make.rover_pose, "state", "`platform` in `map`, while it is valid"
    ),
    RosTopic("/tf", TF, topics.ROVER_ESTIMATE, make.rover_transform, "state", "`map` → `platform`"),
    RosTopic(
        "camera/image_raw",
        "sensor_msgs/msg/Image",
        topics.CAMERA,
        make.image,
        "sensor",
        "in `camera_optical`; only while somebody subscribes",
    ),
    RosTopic(
        "camera/camera_info",
        "sensor_msgs/msg/CameraInfo",
        topics.CAMERA,
        make.camera_info,
        "sensor",
        "one for each image",
    ),
    RosTopic(
        "camera/preview/compressed",
        "sensor_msgs/msg/CompressedImage",
        topics.CAMERA_PREVIEW,
        make.compressed_preview,
        "sensor",
        "small pictures, twice a second",
    ),
    RosTopic("/tf", TF, topics.CAMERA_PREVIEW, make.camera_transform, "state", "`base_link` → `camera_optical`"),
    RosTopic(
        "path", "nav_msgs/msg/Path", topics.ODOMETRY, make.flown_path, "latched", "where the vehicle has been, in `map`"
    ),
    RosTopic(
        "markers/uncertainty",
        "visualization_msgs/msg/Marker",
        topics.RELATIVE,
        make.uncertainty,
        "state",
        "of the relative position, two standard deviations",
    ),
    RosTopic(
        "markers/fence",
        "visualization_msgs/msg/MarkerArray",
        topics.FENCE,
        make.fence_markers,
        "latched",
        "green: stay inside; red: stay outside",
    ),
    _exact(topics.CLOCK, "vehicle time, and the id of its epoch"),
    _exact(topics.ODOMETRY, "in NED, with epoch and resets"),
    _exact(topics.UWB, "one round of ranges, each with its time and its anchor's number and position"),
    _exact(topics.ALTIMETER, "its range in 64 bits"),
    _exact(topics.ROVER_ODOMETRY, "in NED, with the tilt of the platform"),
    _exact(topics.ESTIMATE_TAG, "the vehicle's position by the tags of one image, in NED, with its covariance"),
    RosTopic(
        exact_name(topics.LEASE),
        type_name(topics.LEASE.request_type),
        topics.RELATIVE,
        make.lease,
        "state",
        "inputs that a goal has selected: at each change and once a second; the first has the rover's prior position",
    ),
)
"""Every topic that the bridge publishes, beside `/clock` and `/tf_static`."""
EXACT_ROWS = tuple(row for row in ROWS if row.name == exact_name(row.source))
"""Whole messages of jezero: all topics that the estimator reads."""
REQUESTS = (topics.SET_PARAMETERS, topics.LEASE)
"""Requests to the estimator, which a bag has as messages: they decide which inputs are fused. A bag of a recording has
them as they were; the bridge, to which nobody sends them, makes them from what the estimator publishes and replies."""


@dataclass(frozen=True)
class RosService:
    """One service in ROS.

    Attributes:
        name: below the vehicle's namespace.
        type: of its requests and responses.
        about: its effect, for people.
    """

    name: str
    type: str
    about: str


TRIGGER = "std_srvs/srv/Trigger"
HOVER = RosService("hover", TRIGGER, "brake and hover, which ends the goal in charge")
ABORT = RosService("abort", TRIGGER, "end the goal in charge at once: hover, or disarm on the ground")
RETURN_HOME = RosService("return_home", TRIGGER, "fly home and land; it succeeds when the goal is accepted")
KILL = RosService(
    "kill", "jezero_interfaces/srv/Kill", "stop the motors, also in the air, with `confirm` and the vehicle's name"
)
SERVICES = (HOVER, ABORT, RETURN_HOME, KILL)


def exact_structs() -> dict[str, Any]:
    """The structs of all whole messages in ROS and in bags, by their names in ROS."""
    own = [row.source.struct for row in EXACT_ROWS]
    return with_parts([*own, topics.TRUTH.struct, *(request.request_type for request in REQUESTS)])


def sources() -> Iterator[Topic[Any]]:
    """The topics of jezero that rows are made from, each once; that of the intrinsics first."""
    yield topics.CAMERA_INFO
    seen: set[str] = set()
    for row in ROWS:
        if row.source.name not in seen:
            seen.add(row.source.name)
            yield row.source


def ros_name(vehicle: str) -> str:
    """A vehicle's name as a namespace, which has letters, digits and underscores only and begins with no digit."""
    name = re.sub(r"\W", "_", vehicle, flags=re.ASCII)
    return f"_{name}" if name[0].isdigit() else name
