"""The page of topics and frames in ROS 2, from the table that the bridge publishes by."""

from typing import Any

from jezero.cli.reference.words import table
from jezero.services.ros2_bridge import geometry
from jezero.services.ros2_bridge.rows import ROWS

OPENING = """# Topics and frames in ROS 2

`jezero ros2 bridge` publishes these topics in the vehicle's namespace, such as `/uav1/odometry`; a name that begins
with `/` is as it is. Names of frames begin with the vehicle's too, such as `uav1/base_link`. A bag that
`jezero recording export --rosbag2` writes has the same topics. Made by `jezero info page ros2`."""
OWN = (
    ("/clock", "rosgraph_msgs/msg/Clock", "`clock`", "best effort", "vehicle time, 100 times a second"),
    (
        "/tf_static",
        "tf2_msgs/msg/TFMessage",
        "`vehicle.toml`",
        "reliable, latched",
        "`base_link` → `imu`, `altimeter`, `uwb`; `platform` → `anchor_0` and so on",
    ),
    (
        "plan",
        "nav_msgs/msg/Path",
        "the goal in charge",
        "reliable, latched",
        "the goal's way in `map`; empty without a goal",
    ),
)
QUALITY = {"sensor": "best effort", "state": "reliable", "latched": "reliable, latched"}
"""Words for the qualities of service."""
FRAMES = (
    ("map", "the world frame, east, north and up from its origin"),
    ("odom", "in it the vehicle's position makes no step: a reset of the autopilot's position moves `odom` in `map`"),
    ("base_link", "the vehicle's centre of mass: forward, left, up"),
    ("imu", "as `base_link`"),
    ("altimeter", "x along the beam"),
    ("camera_optical", "x right, y down, z along the optical axis; the picture's axes"),
    ("uwb", "the UWB tag's antenna"),
    ("platform", "centre of the platform's surface, with the rover's heading: ahead, left, up"),
    ("rover_odom", "where the rover started, by its own odometry"),
    ("rover", "the rover, in `rover_odom`"),
)


def page() -> str:
    """The page."""
    names = ("topic", "type", "made from", "quality of service", "content")
    rows: list[dict[str, Any]] = [
        dict(zip(names, (f"`{r.name}`", f"`{r.type}`", f"`{r.source.name}`", QUALITY[r.quality], r.about), strict=True))
        for r in ROWS
    ]
    rows += [dict(zip(names, (f"`{o[0]}`", f"`{o[1]}`", *o[2:]), strict=True)) for o in OWN]
    frames = [{"frame": f"`{name}`", "where it is": about} for name, about in FRAMES]
    axes = (geometry.__doc__ or "").partition("\n\n")[2].strip()
    parts = (OPENING, table(rows), "## Frames", table(frames), "## Axes", axes)
    return "\n\n".join(parts) + "\n"
