"""One landing in virtual time: a take-off to the trial's altitude, then the landing's goal."""

from collections.abc import Callable, Iterable
from contextlib import ExitStack
from math import hypot, inf, radians
from pathlib import Path

import msgspec

from jezero.base.config import ConfigError, load_config
from jezero.base.frames import altitude_m
from jezero.base.vehicle_config import VehicleConfig
from jezero.recording.writer import RECORDING, RecordingWriter
from jezero.runtime.memory_bus import MemoryBus
from jezero.runtime.service import Inbox, Output, Publish, Service
from jezero.schemas import topics
from jezero.schemas.goals import TakeoffGoal
from jezero.schemas.units import NS_PER_S
from jezero.services.simulator.camera.config import CameraConfig
from jezero.services.simulator.config import SeaConfig, SimulatorConfig, WindConfig
from jezero.services.simulator.service import Simulator
from jezero.trials.goals import fly_goal
from jezero.trials.landing.judge import IMPACT_MAX_MPS, EstimateErrors, LandingJudge
from jezero.trials.landing.trial import (
    MOTIONS,
    TAG_HIDDEN_DURATION_S,
    Conditions,
    Trial,
    draw_trial,
)
from jezero.trials.platform import off_platform_reason, offset_m, on_platform_m, tipped_over_reason
from jezero.trials.recording import virtual_recording
from jezero.trials.stack import SYSTEM_ID, RoverDriver, boot_id, service_makers, wired_bus

READY_TIMEOUT_S = 60.0
GOAL_TIMEOUT_S = 240.0
ROVER_DRIVES_BEFORE_S = 2.0
"""The rover drives for this time before the landing's goal is sent, so that it has reached its speed."""
UWB_ONLY_STD_M, UWB_ONLY_OUTLIERS = 0.1, 0.1
"""Errors of real hardware, for the case that lands with UWB only."""
MANY_ROCKS = 300
"""Number of rocks of a landing on a rover that drives over them."""
AFTER_FAILURE_S = 5.0
"""Duration of the flight after a failed landing, which shows what the vehicle does then."""
SERVICES_LEFT_OUT = ("go_to",)
CAMERA_OUTPUTS = (topics.CAMERA.name, topics.TAG_CORNERS.name)


class Landing(msgspec.Struct, frozen=True, kw_only=True):
    """Outcome of one landing.

    Attributes:
        seed: the trial's seed.
        failure: why the landing failed, or "".
        crashed: whether the vehicle lies on its side, touched down harder than 1 m/s, or runs its motors on the ground
            or the platform at the end.
        error_m: horizontal touchdown error; infinite if the landing failed.
        error_rover_body_m: (2,) true position at disarm, forward and right of the platform's centre (case "none": north
            and east of the spot); None if the landing failed.
        time_s: time from the goal to disarm; infinite if the landing failed.
        impact_mps: speed towards the platform at touchdown.
        go_arounds: number of go-arounds after a bad contact.
        errors: errors of the relative estimate during the landing.
    """

    seed: int
    failure: str
    crashed: bool
    error_m: float
    error_rover_body_m: tuple[float, float] | None
    time_s: float
    impact_mps: float
    go_arounds: int
    errors: EstimateErrors


class _TagHidingCamera:
    """A camera service that publishes no images while its tags are hidden.

    Attributes:
        hidden_at: whether the tags are hidden at a time; may be replaced while the bus runs.
    """

    def __init__(self, camera: Service) -> None:
        self.spec = camera.spec
        self.hidden_at: Callable[[int], bool] = lambda t_ns: False
        self._camera = camera

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        for output in self._camera.step(t_ns, inbox):
            is_image = isinstance(output, Publish) and output.topic.name in CAMERA_OUTPUTS
            if not (is_image and self.hidden_at(t_ns)):
                yield output


def fly_landing(
    seed: int,
    conditions: Conditions,
    recordings: Path | None = None,
    autopilot: Callable[[], tuple[Service, int]] | None = None,
) -> Landing:
    """Fly the landing of one seed.

    Args:
        recordings: folder that gets the recording as <case>-<seed>/flight.mcap.
        autopilot: returns an autopilot service that replaces the embedded one, and its MAVLink system id.

    Raises:
        ConfigError: a configuration file is invalid.
    """
    robot = load_config(VehicleConfig, "vehicle")
    trial = draw_trial(seed, conditions, hypot(*robot.airframe.rotor_plane_half_frd_m) + 0.75 * robot.platform.side_m)
    with ExitStack() as cleanup:
        writer: RecordingWriter | None = None
        if recordings is not None:
            path = recordings / f"{conditions.case}-{seed}" / RECORDING
            text = msgspec.json.encode(conditions).decode()
            writer = cleanup.enter_context(virtual_recording(path, seed, conditions=text))
        bus = wired_bus(seed)
        if writer is not None:
            bus.observe(writer.write)
            bus.read_journals(writer.write)
        camera, simulator = _add_services(bus, trial, None if autopilot is None else autopilot())
        cleanup.callback(simulator.close)
        cleanup.callback(bus.end_journals)
        return _fly(trial, bus, camera, simulator)


def _fly(trial: Trial, bus: MemoryBus, camera: _TagHidingCamera, simulator: Simulator) -> Landing:
    conditions = trial.conditions
    driver = RoverDriver()
    bus.add(driver)
    judge = LandingJudge()
    bus.observe(judge)
    failure = _take_off(bus, judge, trial)
    if not failure:
        driver.speed_mps, driver.yaw_rate_rps, driver.reverse_s = MOTIONS[conditions.rover]
        bus.run_for(ROVER_DRIVES_BEFORE_S if driver.speed_mps else 0.0)
        assert judge.truth is not None, "no truth in flight"
        judge.start(bus.t_ns)
        start_ns = bus.t_ns
        camera.hidden_at = lambda t_ns: _tag_hidden(trial, judge, (t_ns - start_ns) / NS_PER_S)
        bus.at(start_ns + int(trial.disturbed_s * NS_PER_S), "", lambda: _disturb(trial, simulator))
        failure = fly_goal(bus, topics.LAND_ON_SPOT, trial.goal(judge.truth.pos_rover_ned_m), GOAL_TIMEOUT_S)
        if failure:
            bus.run_for(AFTER_FAILURE_S)
        return _landing(trial, judge, start_ns, failure)
    return _landing(trial, judge, bus.t_ns, f"before the landing: {failure}")


def _disturb(trial: Trial, simulator: Simulator) -> None:
    """Change compass and wind as the conditions say."""
    conditions = trial.conditions
    simulator.turn_compass(radians(conditions.compass_step_deg))
    if conditions.wind_change_mps is not None:
        simulator.change_wind(conditions.wind_change_mps, trial.wind_change_from_deg)


def _tag_hidden(trial: Trial, judge: LandingJudge, flown_s: float) -> bool:
    conditions, truth = trial.conditions, judge.truth
    if conditions.hide_tag and any(s <= flown_s < s + TAG_HIDDEN_DURATION_S for s in trial.tag_hidden_start_s):
        return True
    until_m = conditions.tag_until_m
    return until_m is not None and truth is not None and altitude_m(offset_m(truth)[2]) < until_m


def _add_services(
    bus: MemoryBus, trial: Trial, other_autopilot: tuple[Service, int] | None
) -> tuple[_TagHidingCamera, Simulator]:
    conditions, seed = trial.conditions, trial.seed
    makers = service_makers(
        seed,
        simulator=simulator_config(trial),
        camera=camera_config(conditions),
        system_id=SYSTEM_ID if other_autopilot is None else other_autopilot[1],
    )
    camera: _TagHidingCamera | None = None
    simulator: Simulator | None = None
    for name, make in makers.items():
        if name in SERVICES_LEFT_OUT:
            continue
        service = (
            other_autopilot[0] if name == "autopilot" and other_autopilot is not None else make(boot_id(seed, name))
        )
        if isinstance(service, Simulator):
            simulator = service
        if name == "camera":
            service = camera = _TagHidingCamera(service)
        bus.add(service)
    assert camera is not None, "a stack without a camera"
    assert simulator is not None, "a stack without a simulator"
    return camera, simulator


def simulator_config(trial: Trial) -> SimulatorConfig:
    """The shipped settings with the trial's rover position, wind, UWB errors and error of the rover's compass."""
    conditions, replace = trial.conditions, msgspec.structs.replace
    shipped = load_config(SimulatorConfig, "simulator")
    std_m = _std_uwb_m(conditions)
    default_share = UWB_ONLY_OUTLIERS if conditions.case == "uwb" else 0.0
    share = default_share if conditions.uwb_outliers is None else conditions.uwb_outliers
    north_m, east_m = trial.pos_rover_ned_m
    return replace(
        shipped,
        wind=WindConfig(
            mean_mps=conditions.wind_mps, from_deg=trial.wind_from_deg, std_gust_mps=conditions.std_gust_mps
        ),
        terrain=replace(
            shipped.terrain,
            water_depth_m=0.0 if conditions.sea is None else conditions.sea[0],
            rocks=MANY_ROCKS if conditions.rocks else shipped.terrain.rocks,
        ),
        rover=replace(
            shipped.rover,
            start_north_m=north_m,
            start_east_m=east_m,
            start_yaw_rad=trial.yaw_rover_rad,
            tilt_deg=conditions.tilt_deg,
            tilt_towards_deg=trial.tilt_towards_deg,
            tilts_with_ground=conditions.rocks or shipped.rover.tilts_with_ground,
            sea=_sea_config(trial),
        ),
        uwb=replace(
            shipped.uwb,
            std_m=shipped.uwb.std_m if std_m is None else std_m,
            share_blocked=share,
            bias_anchors_m=_bias_anchors_m(conditions),
            anchors_shifted=int(conditions.anchors_rotated),
        ),
        rover_odometry=replace(shipped.rover_odometry, bias_yaw_rad=radians(conditions.rover_compass_deg)),
    )


def _sea_config(trial: Trial) -> SeaConfig:
    if trial.conditions.sea is None:
        return SeaConfig()
    height_m, period_s, tilt_deg = trial.conditions.sea
    return SeaConfig(wave_height_m=height_m, period_s=period_s, tilt_deg=tilt_deg, from_deg=trial.sea_from_deg)


def _bias_anchors_m(conditions: Conditions) -> tuple[float, ...]:
    """Constant error of each anchor; a single one holds for all.

    Raises:
        ConfigError: the number of errors is not that of the anchors.
    """
    biases_m = conditions.uwb_bias_m
    anchors = len(load_config(VehicleConfig, "vehicle").uwb.pos_anchors_rover_body_m)
    if len(biases_m) not in (0, 1, anchors):
        raise ConfigError(f"{len(biases_m)} UWB errors are given for {anchors} anchors: give one, or {anchors}")
    return biases_m * anchors if len(biases_m) == 1 else biases_m


def _std_uwb_m(conditions: Conditions) -> float | None:
    """Standard deviation of the UWB ranges; None for the shipped setting."""
    if conditions.uwb_std_m is not None:
        return conditions.uwb_std_m
    return UWB_ONLY_STD_M if conditions.case == "uwb" else None


def camera_config(conditions: Conditions) -> CameraConfig:
    """The shipped settings with the conditions' mode, latency and size of the printed tags."""
    shipped = load_config(CameraConfig, "camera")
    delay_s = shipped.delay_s if conditions.camera_delay_s is None else conditions.camera_delay_s
    side_m = load_config(VehicleConfig, "vehicle").platform.side_tag_m
    scale = 1.0 if conditions.tag_side_m is None else conditions.tag_side_m / side_m
    return msgspec.structs.replace(shipped, mode=conditions.tags, delay_s=delay_s, print_scale=scale)


def _take_off(bus: MemoryBus, judge: LandingJudge, trial: Trial) -> str:
    """Take off to the trial's altitude; returns why that failed, or ""."""

    def is_ready() -> bool:
        return judge.status is not None and judge.status.ready

    if not bus.run_for(READY_TIMEOUT_S, stop=is_ready):
        return f"not ready: {judge.status.not_ready_reason if judge.status else 'no status'}"
    return fly_goal(bus, topics.TAKEOFF, TakeoffGoal(altitude_m=trial.altitude_m), GOAL_TIMEOUT_S)


def _landing(trial: Trial, judge: LandingJudge, start_ns: int, failure: str) -> Landing:
    truth = judge.truth
    if not failure and (truth is None or judge.disarmed_ns is None or judge.status is None or judge.status.armed):
        failure = "not disarmed"
    error_rover_body_m: tuple[float, float] | None = None
    if not failure and truth is not None:
        if trial.conditions.case == "none":
            failure = tipped_over_reason(truth)
            north_m, east_m, _ = trial.spot_ned_m
            error_rover_body_m = (truth.pos_uav_ned_m[0] - north_m, truth.pos_uav_ned_m[1] - east_m)
        else:
            robot = load_config(VehicleConfig, "vehicle")
            height_stand_m = robot.airframe.height_stand_m
            failure = off_platform_reason(truth, 0.5 * robot.platform.side_m, height_stand_m)
            error_rover_body_m = on_platform_m(truth, height_stand_m)[:2]
        if judge.impact_mps > IMPACT_MAX_MPS:
            failure = failure or f"impact at {judge.impact_mps:.2f} m/s"
    landed = not failure and error_rover_body_m is not None and judge.disarmed_ns is not None
    return Landing(
        seed=trial.seed,
        failure=failure,
        crashed=judge.crashed,
        error_m=hypot(*error_rover_body_m) if landed and error_rover_body_m else inf,
        error_rover_body_m=error_rover_body_m if landed else None,
        time_s=((judge.disarmed_ns or 0) - start_ns) / NS_PER_S if landed else inf,
        impact_mps=round(judge.impact_mps, 3),
        go_arounds=judge.go_arounds,
        errors=judge.errors,
    )
