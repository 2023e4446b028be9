"""The embedded autopilot: speaks what PX4 speaks, and knows only what HIL_SENSOR and HIL_GPS tell."""

from collections.abc import Iterator

from jezero.mavlink import Signing
from jezero.runtime.service import Health, Inbox, Output, Send, Spec
from jezero.services.autopilot.alignment import Fix
from jezero.services.autopilot.config import AutopilotConfig
from jezero.services.autopilot.hil import HilLink, Reading
from jezero.services.autopilot.parameters import Parameters
from jezero.services.autopilot.requests import Requests
from jezero.services.autopilot.telemetry import GCS_INTERVALS_US, OFFBOARD_INTERVALS_US, TelemetryLink
from jezero.services.autopilot.vehicle import Vehicle

HIL, OFFBOARD, GCS = "hil", "offboard", "gcs"
GAP_MAX_US = 1_000_000

SPEC = Spec(name="autopilot", links=(HIL, OFFBOARD, GCS), triggers=(HIL, OFFBOARD, GCS), rate_hz=10.0)


class Autopilot:
    """One autopilot with its links.

    All its time is that of HIL_SENSOR; it answers each with one HIL_ACTUATOR_CONTROLS. A new simulator, or time that
    goes back or leaps, makes it start over; parameters keep what they were set to.

    Args:
        system_id: MAVLink system id.
        boot_id: differs between two runs; the autopilot itself has no use for it.
        since_2015_s: wall time at the start, for signatures.
    """

    spec = SPEC

    def __init__(self, config: AutopilotConfig, system_id: int, boot_id: int, since_2015_s: float = 0.0) -> None:
        self._system_id = system_id
        self._parameters = Parameters(config, system_id)
        key = bytes.fromhex(config.signing.key)
        self._signing: dict[str, Signing] = {name: Signing(key) for name in config.signing.links} if key else {}
        self._since_2015_10us = int(since_2015_s * 1e5)
        self._started_wall_ns: int | None = None
        self._connections = 0
        self._health: Health | None = None
        self._start_over()

    def _start_over(self) -> None:
        self._hil = HilLink(self._system_id)
        self._vehicle = Vehicle(self._parameters, self._system_id)
        self._requests = Requests(self._vehicle, self._parameters)
        self._links = {
            OFFBOARD: TelemetryLink(self._system_id, OFFBOARD_INTERVALS_US, self._signing.get(OFFBOARD)),
            GCS: TelemetryLink(self._system_id, GCS_INTERVALS_US, self._signing.get(GCS)),
        }

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Sensors in, motors out; then what the links ask and tell."""
        if inbox.connections(HIL) != self._connections:
            self._connections = inbox.connections(HIL)
            self._start_over()
        if self._signing:
            self._tell_time(inbox.wall_ns)
        for item in self._hil.receive(inbox.received(HIL)):
            if isinstance(item, Fix):
                self._vehicle.fix(item)
            else:
                yield Send(HIL, self._on_reading(item))
        for name, link in self._links.items():
            for message in link.receive(inbox.received(name)):
                if answer := self._requests.answer(link, message):
                    yield Send(name, answer)
        yield from self._tell(inbox)

    def _tell_time(self, wall_ns: int) -> None:
        """What the clock of the signatures says."""
        if self._started_wall_ns is None:
            self._started_wall_ns = wall_ns
        for signing in self._signing.values():
            signing.now = self._since_2015_10us + (wall_ns - self._started_wall_ns) // 10_000

    def _on_reading(self, reading: Reading) -> bytes:
        """One HIL_SENSOR in, one HIL_ACTUATOR_CONTROLS out."""
        t_us = self._vehicle.t_us
        if reading.t_us < t_us or (t_us and reading.t_us > t_us + GAP_MAX_US):
            self._start_over()
        commands = self._vehicle.step(reading)
        return self._hil.actuators(reading.t_us, commands, armed=self._vehicle.commander.armed)

    def _tell(self, inbox: Inbox) -> Iterator[Output]:
        vehicle = self._vehicle
        commander = vehicle.commander
        said = commander.take_said()
        state = (commander.mode.custom_mode, commander.armed, vehicle.landed)
        for name, link in self._links.items():
            if not inbox.is_up(name):
                continue
            data = b"".join(link.text(severity, text) for severity, text in said)
            if vehicle.t_us and link.is_due(vehicle.t_us, state):
                data += link.stream(vehicle.snapshot())
            if data:
                yield Send(name, data)
        health = self._judge(inbox)
        if health != self._health:
            self._health = health
            yield health

    def _judge(self, inbox: Inbox) -> Health:
        if not inbox.is_up(HIL):
            return Health("starting", "waiting for the simulator")
        text = "connected to the simulator" if self._vehicle.landed else "flying"
        malformed = self._hil.malformed + sum(link.malformed for link in self._links.values())
        refused = sum(link.refused for link in self._links.values())
        text += f"; {malformed} malformed messages" if malformed else ""
        text += f"; {refused} messages without a valid signature" if refused else ""
        return Health("ok", text)
