"""The embedded autopilot: has the MAVLink interface of PX4, and measurements only from HIL_SENSOR and HIL_GPS."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import msgspec

from jezero.base.mavlink import Signing
from jezero.base.vehicle_config import VehicleConfig
from jezero.runtime.service import Health, Inbox, Output, Publish, Send, Spec
from jezero.schemas.commands import CameraPitch
from jezero.schemas.topics import SIMULATED_GIMBAL
from jezero.services.autopilot.alignment import Fix
from jezero.services.autopilot.config import AutopilotConfig, SigningConfig
from jezero.services.autopilot.estimator import StateEstimator
from jezero.services.autopilot.gimbal import NOBODY
from jezero.services.autopilot.hil import HilLink, RangeSample, SensorSample
from jezero.services.autopilot.mavlink_interface import MavlinkInterface, signing_by_link
from jezero.services.autopilot.multicopter import MulticopterController
from jezero.services.autopilot.parameters import Parameters
from jezero.services.autopilot.telemetry import GCS, OFFBOARD
from jezero.services.autopilot.vehicle import AutopilotVehicle

__all__ = ["GCS", "HIL", "OFFBOARD", "SPEC", "Autopilot"]

HIL = "hil"
GAP_MAX_US = 1_000_000

SPEC = Spec(
    name="autopilot",
    outputs=(SIMULATED_GIMBAL,),
    links=(HIL, OFFBOARD, GCS),
    triggers=(HIL, OFFBOARD, GCS),
    rate_hz=10.0,
)


class Autopilot:
    """One autopilot with its links.

    Its time is that of HIL_SENSOR, and it replies to each with one HIL_ACTUATOR_CONTROLS. It restarts when a simulator
    connects, or when time goes back or jumps; parameters keep their values.

    Args:
        config: settings of the autopilot.
        vehicle: the vehicle itself: its airframe and its battery.
        system_id: MAVLink system id.
        since_2015_s: wall time at the start, for the time stamps of signatures.
        insecurity: sentence that the health shows all the time; "" for none.
        kept_stamp: time stamp of signatures that was kept before the restart; -1 when there was none.
        keep_stamp: stores such a time stamp.
        offboard_key: key of the signatures of the offboard link, 32 bytes; b"" leaves that link to `config.signing`.
    """

    def __init__(
        self,
        config: AutopilotConfig,
        vehicle: VehicleConfig,
        system_id: int,
        since_2015_s: float = 0.0,
        insecurity: str = "",
        kept_stamp: int = -1,
        keep_stamp: Callable[[int], None] = lambda _: None,
        offboard_key: bytes = b"",
    ) -> None:
        made_with = {
            "config": msgspec.structs.replace(config, signing=SigningConfig()),  # recordings have no key
            "vehicle": vehicle,
            "system_id": system_id,
            "since_2015_s": since_2015_s,
            "insecurity": insecurity,
        }
        self.spec = replace(SPEC, made_with=made_with)
        self._system_id = system_id
        self._insecurity = f"; {insecurity}" if insecurity else ""
        self._parameters = Parameters(config, vehicle.battery, system_id)
        self._robot = vehicle
        self._signing = signing_by_link(config.signing, kept_stamp, keep_stamp)
        self._since_2015_10us = int(since_2015_s * 1e5)
        if offboard_key:  # what was sent before the start isn't accepted; a kept time stamp would cost some seconds
            self._signing[OFFBOARD] = Signing(offboard_key, self._since_2015_10us)
        self._started_wall_ns: int | None = None
        self._connections = 0
        self._health: Health | None = None
        self._health_state: tuple[bool, int, int, int] | None = None
        """(landed, malformed messages, bad signatures, refused messages) of the last health."""
        self._restart()

    def _restart(self) -> None:
        config = self._parameters.config
        estimator = StateEstimator(config.estimator, self._robot.planet.gravity_mps2, self._robot.heading_by)
        self._hil = HilLink(self._system_id)
        controller = MulticopterController(config, self._robot, estimator)
        self._vehicle = AutopilotVehicle(
            self._parameters, self._system_id, estimator, controller, self._robot.heading_by
        )
        self._mavlink = MavlinkInterface(
            self._vehicle, self._parameters, self._system_id, (OFFBOARD, GCS), self._signing
        )

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Reply to sensor samples with motor commands; handle messages and send telemetry on the other links."""
        if inbox.connections(HIL) != self._connections:
            self._connections = inbox.connections(HIL)
            self._restart()
        if self._signing:
            self._update_signing_clock(inbox.wall_ns)
        for item in self._hil.receive(inbox.received(HIL)):
            if type(item) is SensorSample:
                yield Send(HIL, self._on_sample(item))
            elif type(item) is Fix:
                self._vehicle.on_fix(item)
            elif type(item) is RangeSample:
                self._vehicle.newest_range = item
        yield from self._mavlink.handle_messages(inbox)
        gimbal = self._vehicle.gimbal
        if gimbal.controller != NOBODY and gimbal.move(self._vehicle.t_us):
            angles = CameraPitch(t_ns=t_ns, pitch_camera_rad=gimbal.pitch_rad, roll_camera_rad=gimbal.roll_rad)
            yield Publish(SIMULATED_GIMBAL, angles)
        yield from self._mavlink.send_telemetry(inbox)
        health = self._current_health(inbox)
        if health != self._health:
            self._health = health
            yield health

    def _update_signing_clock(self, wall_ns: int) -> None:
        """Set the clocks of the signed links."""
        if self._started_wall_ns is None:
            self._started_wall_ns = wall_ns
        for signing in self._signing.values():
            signing.clock_10us = self._since_2015_10us + (wall_ns - self._started_wall_ns) // 10_000

    def _on_sample(self, sample: SensorSample) -> bytes:
        """Advance the vehicle to a sensor sample; returns HIL_ACTUATOR_CONTROLS."""
        t_us = self._vehicle.t_us
        if sample.t_us < t_us or (t_us and sample.t_us > t_us + GAP_MAX_US):
            self._restart()
        commands = self._vehicle.step(sample)
        return self._hil.actuators(sample.t_us, commands, armed=self._vehicle.commander.armed)

    def _current_health(self, inbox: Inbox) -> Health:
        if not inbox.is_up(HIL):
            self._health_state = None
            return Health("starting", f"waiting for the simulator{self._insecurity}")
        landed, malformed, bad_signatures, refused = state = (
            self._vehicle.landed,
            self._hil.malformed + self._mavlink.malformed,
            self._mavlink.bad_signatures,
            self._mavlink.refused.total(),
        )
        if self._health is not None and self._health_state == state:
            return self._health
        self._health_state = state
        text = "connected to the simulator" if landed else "flying"
        text += f"; {malformed} malformed messages" if malformed else ""
        text += f"; {bad_signatures} messages without a valid signature" if bad_signatures else ""
        if refused:
            systems = ", ".join(map(str, sorted(self._mavlink.refused)))
            text += f"; {refused} messages of MAVLink system {systems} refused: see ground_systems in autopilot.toml"
        return Health("ok", text + self._insecurity)
