"""The page of topics, frames, actions and services in ROS 2, from the tables that the bridge works by."""

from typing import Any

from jezero.cli.reference.words import fields_of, summary_of, table
from jezero.schemas.estimate import SetParameters
from jezero.schemas.topics import SET_PARAMETERS
from jezero.services.ros2_bridge import geometry
from jezero.services.ros2_bridge.exact import type_name
from jezero.services.ros2_bridge.fields import AS_JSON, LEFT_OUT, ROS_ACTIONS, RULES, Rule, interface_name, ros_fields
from jezero.services.ros2_bridge.inputs import INPUTS
from jezero.services.ros2_bridge.rows import ROWS, SERVICES, exact_name

OPENING = """# Topics, frames, actions and services in ROS 2

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
    (
        exact_name(SET_PARAMETERS),
        type_name(SetParameters),
        "the estimator's parameters",
        "reliable, latched",
        "all of them, at the start and when they have changed; the rover's prior position only when it is another one",
    ),
    (
        "refusals",
        "std_msgs/msg/String",
        "goals of ROS that were refused",
        "reliable",
        "name of the action, and the reason: ROS itself rejects a goal without one",
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

ACTIONS_TEXT = """## Actions

The types are in the package `jezero_interfaces` (`deploy/ros2`), whose definitions explain each field. Their fields
are those of the [actions](actions.md) by the rules below. A goal flies by the same rules as every client's:
`on_client_loss` is the reaction to a bridge that disappears. What the vehicle refuses is rejected in ROS, and the
reason is published on `refusals`. A goal that another client ends is aborted in ROS, and its `outcome` says more.
`fly_velocity` is none of them: `cmd_vel` flies by velocity."""
FLY_ACTION_TEXT = "any action, also one that a package adds: its name, and its fields as JSON"
RULES_TEXT = f"""### Fields

The first line that fits a field applies. {", ".join(f"`{name}`" for name in LEFT_OUT)} are left out. A list becomes a
sequence. A field that may be none becomes a sequence of at most one, such as `float64[<=1]`, that is empty for none.
A position in the frame `world` is one in `map`, but it has a height of 0 for a vehicle that stands on the ground, where
`base_link`, its centre of mass, is already above it."""
PARAMETERS_TEXT = """## Parameters

The node `jezero_bridge` has the estimator's parameters, which follow within two seconds what others change; it has none
where the estimator did not reply at its start. To set one sets it in the estimator, for all its users; a value out of
range is refused with a reason."""
SUBSCRIBED_TEXT = """## Topics that the bridge reads

Only with `--commands`: a `geometry_msgs/msg/PoseStamped` on `goal_pose` in the frame `map` of the vehicle, such as
`uav1/map`, flies `base_link` there. A height of exactly 0, as RViz draws poses, keeps the present height. The
orientation's heading is that at the target; a quaternion of zeros keeps the heading. A pose that arrives during the
flight to the last one changes its target.

Only with `--commands`, too: a `geometry_msgs/msg/Twist` or `TwistStamped` on `cmd_vel` (the type that somebody
publishes there) flies the vehicle by [fly_velocity](actions.md#fly_velocity): x forward, y left, z up in m/s,
relative to the heading, and `angular.z` anticlockwise in rad/s. The frame of a stamped one is `base_link` or empty,
and its stamp vehicle time or zero. The first message starts the goal while the vehicle hovers and nothing else flies
it, half a second without one stops the vehicle, and a second ends the goal. A stream that was refused, or that a
`hover`, an abort or a pilot has ended, has no effect until it pauses for a second or sends a zero. `refusals` has the
reasons.

With `--rover-odometry TOPIC`: a `nav_msgs/msg/Odometry` of the rover goes to the service
[rover_driver](../how-to/use-a-real-rover.md). Its orientation gives the heading, in a frame whose x axis points where
`--rover-heading` says, and roll and pitch; its twist speed and yaw rate. It is refused, with the reason on
`refusals`, when a number is NaN or infinite, when its stamp is 0.3 s off both vehicle time and the computer's clock,
when its covariance says that the heading is known within 0.5 rad only or the speed within 1 m/s (zeros are a
covariance that is not given), or when it drives sideways.

With `--rover-cmd-vel TOPIC` the bridge publishes the drive commands of jezero's clients there, as on `rover/cmd_vel`,
and after the last one three stops."""

EXACT_TEXT = """Topics below `jezero/` carry whole messages of jezero, with its names, axes and units: nothing is lost.
Those below `jezero/estimator/` are requests that would bring the estimator to the selection and parameters that it has.
Their types are in the package `jezero_interfaces`; a bridge whose environment lacks it leaves them out."""
BAGS_TEXT = """## Topics that are read from a bag

`jezero recording import` makes a recording of a rosbag2 by running the estimator on these topics. Of several that are
made into one topic of jezero it takes the first in this table that the bag has; `--topic ROS=JEZERO` names others. The
estimator can't do without odometry of vehicle and rover, and UWB ranges or positions by the tags. Whole messages give
the very estimates of the flight. Messages of ROS in 64 bits change them by rounding only, but have no epoch and no
resets; a range in 32 bits is rounded to a ten-millionth of its value."""


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
    services = [{"service": f"`{each.name}`", "type": f"`{each.type}`", "effect": each.about} for each in SERVICES]
    parts = (
        *(OPENING, table(rows), EXACT_TEXT, "## Frames", table(frames), "## Axes", axes),
        *(ACTIONS_TEXT, table(_actions()), RULES_TEXT, table([_rule_row(rule) for rule in (*RULES, AS_JSON)])),
        *("## Services", table(services), PARAMETERS_TEXT, table(_parameters()), SUBSCRIBED_TEXT),
        *(BAGS_TEXT, table(_inputs())),
    )
    return "\n\n".join(parts) + "\n"


def _inputs() -> list[dict[str, str]]:
    names = ("topic in the bag", "type", "jezero's topic or request", "content")
    return [
        dict(
            zip(names, (f"`{i.name}`" if i.name else "any", f"`{i.type}`", f"`{i.source.name}`", i.about), strict=True)
        )
        for i in INPUTS
    ]


def _actions() -> list[dict[str, str]]:
    found = [(name, summary_of(action.goal_type)) for name, action in ROS_ACTIONS.items()]
    return [
        {"action": f"`{name}`", "type": f"`jezero_interfaces/action/{interface_name(name)}`", "goal": about}
        for name, about in (*found, ("fly_action", FLY_ACTION_TEXT))
    ]


def _rule_row(rule: Rule) -> dict[str, str]:
    ned, ros = rule.suffix
    renamed = f"`..{ned}` → `..{ros}`" if ned else f"`..{ros}`" if ros else "the same"
    return {"jezero": rule.jezero, "ROS": f"`{rule.type}`", "name": renamed, "value": rule.about or "the same"}


def _parameters() -> list[dict[str, str]]:
    meanings = {field.name: field.meaning for field in fields_of(SetParameters)}
    return [
        {
            "parameter": f"`estimator.{field.name}`",
            "value": f"3 numbers: east, north, up of `{field.source}`" if field.rule.about else field.rule.type,
            "meaning": meanings[field.source],
        }
        for field in ros_fields(SetParameters)
    ]
