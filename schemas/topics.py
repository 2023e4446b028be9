"""The table of all keys: name, message type, rate and writer. Keys are `jezero/<vehicle>/<name>`.

Every endpoint that has an effect is behind an `@` chunk, which the wildcards `*` and `**` never match.
"""

from dataclasses import replace
from typing import Any, Literal

from jezero.schemas import (
    actions,
    commands,
    estimate,
    fence,
    goals,
    health,
    journal,
    mission,
    preflight,
    sensors,
    simulator,
    state,
    terrain,
)
from jezero.schemas.rows import CLIENTS, EVERY_ACTION, GOAL_IN_CHARGE, Action, Endpoint, Topic, refusing

CLOCK = Topic("clock", state.Clock, 10.0, "simulator", urgent=True, driver="vehicle_bridge")
IMU = Topic("sensor/imu", sensors.Imu, 50.0, "simulator", link_hz=5.0)
GNSS = Topic("sensor/gnss", sensors.Gnss, 10.0, "simulator", link_hz=2.0)
BARO = Topic("sensor/baro", sensors.Barometer, 10.0, "simulator", link_hz=1.0)
MAG = Topic("sensor/mag", sensors.Magnetometer, 10.0, "simulator", link_hz=1.0)
ALTIMETER = Topic("sensor/altimeter", sensors.Altimeter, 25.0, "simulator", link_hz=5.0, driver="vehicle_bridge")
UWB = Topic("sensor/uwb", sensors.Uwb, 20.0, "simulator", link_hz=5.0, driver="uwb")
ROVER_ODOMETRY = Topic(
    "rover/odometry", sensors.RoverOdometry, 25.0, "simulator", host="rover", urgent=True, driver="rover_driver"
)
TRUTH = Topic("truth", state.Truth, 50.0, "simulator", link_hz=5.0)
ODOMETRY = Topic("odometry", state.Odometry, 50.0, "vehicle_bridge", link_hz=10.0)
STATUS = Topic("status", state.Status, 10.0, "vehicle_bridge", urgent=True)
SETPOINT = Topic("command/setpoint", commands.Setpoint, 50.0, GOAL_IN_CHARGE, link_hz=0.0)
SCENE = Topic("simulator/scene", state.Scene, 15.0, "simulator", link_hz=5.0)
SIMULATED_GIMBAL = Topic("simulator/gimbal", commands.CameraPitch, 20.0, "autopilot", link_hz=0.0)
CAMERA = Topic("sensor/camera", sensors.CameraFrame, 15.0, "camera", link_hz=0.0, driver="camera_driver")
CAMERA_INFO = Topic("camera/info", sensors.CameraInfo, 1.0, "camera", driver="camera_driver")
CAMERA_PREVIEW = Topic("camera/preview", sensors.CameraPreview, 2.0, "camera", driver="camera_driver")
TAG_CORNERS = Topic("sensor/tag_corners", sensors.TagCorners, 15.0, "camera", link_hz=0.0)
ESTIMATE_TAG = Topic("estimate/tag", estimate.TagEstimate, 15.0, "tag_detector", link_hz=5.0)
RELATIVE = Topic("estimate/relative", estimate.Relative, 50.0, "estimator", link_hz=10.0)
ROVER_ESTIMATE = Topic("estimate/rover", estimate.RoverEstimate, 10.0, "estimator", link_hz=5.0)
CAMERA_PITCH = Topic("command/camera_pitch", commands.CameraPitch, 20.0, GOAL_IN_CHARGE, link_hz=2.0)
CAMERA_ATTITUDE = Topic("camera/attitude", sensors.CameraAttitude, 20.0, "vehicle_bridge", link_hz=2.0)
VELOCITY_COMMAND = Topic("command/velocity", commands.VelocityCommand, 20.0, CLIENTS, urgent=True)
ROVER_COMMAND = Topic("rover/command", commands.RoverCommand, 10.0, CLIENTS, urgent=True)
MISSION = Topic("mission/progress", mission.MissionProgress, 2.0, "mission")
PREFLIGHT = Topic("preflight", preflight.PreflightReport, None, "preflight")
FENCE = Topic("fence", fence.FenceState, 1.0, "vehicle_bridge")

TOPICS: tuple[Topic[Any], ...] = tuple(row for row in list(globals().values()) if isinstance(row, Topic))
"""The rows above: a new topic is one row, and no entry in a list is forgotten."""

ACQUIRE = refusing(
    "@control/acquire", commands.Acquire, commands.AcquireReply, "vehicle_bridge", "service", granted=False
)
RELEASE = refusing(
    "@control/release", commands.Release, commands.ReleaseReply, "vehicle_bridge", "service", released=False, code=-1
)
HOVER = refusing("@control/hover", commands.Hover, commands.HoverReply, "vehicle_bridge", urgent=True, hover_mode=False)
ABORT = refusing("@control/abort", commands.Abort, commands.AbortReply, "vehicle_bridge", urgent=True, hovering=False)
KILL = refusing("@control/kill", commands.Kill, commands.KillReply, "vehicle_bridge", urgent=True, killed=False)
SET_FENCE = refusing("@fence/set", fence.SetFence, fence.FenceReply, "vehicle_bridge", accepted=False)
RESULT = Endpoint(
    "@action/result",
    actions.GetResult,
    actions.ResultReply,
    EVERY_ACTION,
    lambda why: actions.ResultReply(goal_id="-", action="-", running=False, result=None),
    shared=True,
    asker="viewer",
)
UNKNOWN_ACTION = Endpoint(
    "@action/**",
    actions.UnknownAction,
    actions.Rejected
    | actions.PlanReply
    | actions.CancelReply
    | actions.PauseReply
    | actions.ResumeReply
    | actions.ModifyReply,
    "vehicle_bridge",
    lambda why: actions.Rejected(reason=why),
    shared=True,
)
"""Requests to actions that don't exist."""
GET_PARAMETERS = refusing(
    "@estimator/parameters/get", estimate.GetParameters, estimate.ParametersReply, "estimator", "viewer", accepted=False
)
SET_PARAMETERS = refusing(
    "@estimator/parameters/set", estimate.SetParameters, estimate.ParametersReply, "estimator", accepted=False
)
LEASE = refusing(
    "@estimator/parameters/lease", estimate.Lease, estimate.LeaseReply, "estimator", "service", accepted=False
)
RUN_MISSION = refusing("@mission/run", mission.Mission, mission.MissionReply, "mission", accepted=False)
COMMAND_MISSION = refusing("@mission/command", mission.MissionCommand, mission.MissionReply, "mission", accepted=False)
CHECK_PREFLIGHT = refusing("@preflight/check", preflight.GetPreflight, preflight.PreflightReply, "preflight", "viewer")
CONTROL_SIMULATOR = refusing(
    "@simulator/control", simulator.ControlSimulator, simulator.SimulatorReply, "simulator", accepted=False
)
GROUND = Endpoint(
    "simulator/ground",
    terrain.GetGround,
    terrain.Ground,
    "simulator",
    lambda why: terrain.Ground(reason=why),
    wildcards=True,
    asker="viewer",
)
"""The simulator's terrain, for people to look at."""

TAKEOFF = Action(
    "takeoff",
    goals.TakeoffGoal,
    goals.MoveFeedback,
    goals.MoveResult,
    commands.Phase.TAKEOFF,
    changeable=("altitude_m",),
)
GO_TO = Action(
    "go_to",
    goals.GoToGoal,
    goals.MoveFeedback,
    goals.MoveResult,
    commands.Phase.GO_TO,
    changeable=("target_ned_m", "yaw_rad", "speed_mps"),
)
FLY_VELOCITY = Action(
    "fly_velocity",
    goals.FlyVelocityGoal,
    goals.VelocityFeedback,
    goals.VelocityResult,
    commands.Phase.ACTION,
    steered_by=VELOCITY_COMMAND,
)
LAND_ON_SPOT = Action(
    "land_on_spot",
    goals.LandOnSpotGoal,
    goals.LandFeedback,
    goals.LandResult,
    commands.Phase.LANDING,
    changeable=("landing_spot_ned_m",),
    odometry_min_hz=15.0,  # without jitter all landings on a driving rover succeed at 7 Hz, and one of ten at 5 Hz
)
RETURN_HOME = Action(
    "return_home",
    goals.ReturnHomeGoal,
    goals.ReturnFeedback,
    goals.ReturnResult,
    commands.Phase.LANDING,
)
AREA_COVERAGE = Action(
    "area_coverage",
    goals.AreaCoverageGoal,
    goals.ImagesFeedback,
    goals.CoverageResult,
    commands.Phase.COVERAGE,
    takes_pictures=True,
    changeable=("polygon_ned_m", "holes_ned_m", "z_ned_m", "speed_mps"),
)
GET_IMAGES = Action(
    "get_images",
    goals.GetImagesGoal,
    goals.ImagesFeedback,
    goals.ImagesResult,
    commands.Phase.GET_IMAGES,
    takes_pictures=True,
    changeable=("center_ned_m", "radius_m", "num_images", "target_z_ned_m", "speed_mps"),
)
ACTIONS: dict[str, Action[Any]] = {
    a.name: a for a in (TAKEOFF, GO_TO, FLY_VELOCITY, GET_IMAGES, AREA_COVERAGE, LAND_ON_SPOT, RETURN_HOME)
}

ENDPOINTS: tuple[Endpoint[Any, Any], ...] = (
    ACQUIRE, RELEASE, HOVER, ABORT, KILL, RESULT, UNKNOWN_ACTION, GET_PARAMETERS, SET_PARAMETERS, LEASE,
    RUN_MISSION, COMMAND_MISSION, CHECK_PREFLIGHT, SET_FENCE, GROUND, CONTROL_SIMULATOR,
    *(endpoint for action in ACTIONS.values() for endpoint in action.endpoints),
)  # fmt: skip


EVERY_LINK = Topic("@link/*", health.GateLinks, 1.0, "gate", urgent=True)
"""The topic `@link/GATE` of each gate, which also replies there, so that the launchers know whether its links pass."""
KEYS = (
    *("**", "@alive/**", "@link/**"),
    *sorted({f"{e.name.partition('/')[0]}/**" for e in ENDPOINTS if e.name.startswith("@")}),
)
"""Names that cover everything of a vehicle: `**` stops at a chunk that begins with `@`."""


def health_of(service: str) -> Topic[health.ServiceHealth]:
    """The topic on which a service's runtime publishes its health, at 1 Hz of wall time and when the state changes."""
    return Topic(f"health/{service}", health.ServiceHealth, 1.0, service)


def journal_of(service: str) -> Topic[journal.JournalPart]:
    """The topic on which a service's runtime publishes the service's journal, for the recorder."""
    return Topic(f"journal/{service}", journal.JournalPart, 10.0, service, link_hz=0.0)


def feedback_of(action: Action[Any]) -> Topic[actions.FeedbackMessage[Any]]:
    """The topic on which an action's feedback is published for every subscriber."""
    message: Any = actions.FeedbackMessage[action.feedback_type]  # type: ignore[name-defined]
    return Topic(f"action/{action.name}/feedback", message, 10.0, action.name, link_hz=5.0)


EVERY_ACTION_FEEDBACK = replace(feedback_of(GO_TO), name="action/*/feedback")
"""The feedback of every action, also of those that packages add."""


def key(vehicle: str, name: str) -> str:
    """The Zenoh key of a topic or endpoint of one vehicle."""
    return f"jezero/{vehicle}/{name}"


def liveliness_key(vehicle: str, kind: Literal["service", "client"], name: str) -> str:
    """The key of the liveliness token of a service or a client."""
    return f"jezero/{vehicle}/@alive/{kind}/{name}"
