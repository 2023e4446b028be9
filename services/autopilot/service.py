"""The embedded autopilot: speaks what PX4 speaks, and knows only what HIL_SENSOR and HIL_GPS tell."""

from collections.abc import Iterator

from jezero.runtime.service import Health, Inbox, Output, Send, Spec
from jezero.services.autopilot.alignment import Fix
from jezero.services.autopilot.config import AutopilotConfig
from jezero.services.autopilot.estimator import Estimator
from jezero.services.autopilot.flight import Flight
from jezero.services.autopilot.hil import HilLink, Reading
from jezero.services.autopilot.mavlink_side import GCS, OFFBOARD, MavlinkSide, make_signing
from jezero.services.autopilot.parameters import Parameters
from jezero.services.autopilot.vehicle import Vehicle

__all__ = ["GCS", "HIL", "OFFBOARD", "SPEC", "Autopilot"]

HIL = "hil"
GAP_MAX_US = 1_000_000

SPEC = Spec(name="autopilot", links=(HIL, OFFBOARD, GCS), triggers=(HIL, OFFBOARD, GCS), rate_hz=10.0)


class Autopilot:
    """One autopilot with its links.

    All its time is that of HIL_SENSOR; it answers each with one HIL_ACTUATOR_CONTROLS. A new simulator, or time that
    goes back or leaps, makes it start over; parameters keep what they were set to.

    Args:
        system_id: MAVLink system id.
        since_2015_s: wall time at the start, for signatures.
    """

    spec = SPEC

    def __init__(self, config: AutopilotConfig, system_id: int, since_2015_s: float = 0.0) -> None:
        self._system_id = system_id
        self._parameters = Parameters(config, system_id)
        self._signing = make_signing(config.signing)
        self._since_2015_10us = int(since_2015_s * 1e5)
        self._started_wall_ns: int | None = None
        self._connections = 0
        self._health: Health | None = None
        self._judged: tuple[bool, int, int] | None = None
        """What the health of a connected autopilot tells."""
        self._start_over()

    def _start_over(self) -> None:
        config = self._parameters.config
        estimator = Estimator(config.estimator, config.airframe.gravity_mps2)
        self._hil = HilLink(self._system_id)
        self._vehicle = Vehicle(self._parameters, self._system_id, estimator, Flight(config, estimator))
        self._side = MavlinkSide(self._vehicle, self._parameters, self._system_id, (OFFBOARD, GCS), self._signing)

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        """Sensors in, motors out; then what the links ask and tell."""
        if inbox.connections(HIL) != self._connections:
            self._connections = inbox.connections(HIL)
            self._start_over()
        if self._signing:
            self._tell_time(inbox.wall_ns)
        for item in self._hil.receive(inbox.received(HIL)):
            if type(item) is Reading:
                yield Send(HIL, self._on_reading(item))
            elif type(item) is Fix:
                self._vehicle.fix(item)
        yield from self._side.answer(inbox)
        yield from self._side.tell(inbox)
        health = self._judge(inbox)
        if health != self._health:
            self._health = health
            yield health

    def _tell_time(self, wall_ns: int) -> None:
        """What the clock of the signatures says."""
        if self._started_wall_ns is None:
            self._started_wall_ns = wall_ns
        for signing in self._signing.values():
            signing.clock_10us = self._since_2015_10us + (wall_ns - self._started_wall_ns) // 10_000

    def _on_reading(self, reading: Reading) -> bytes:
        """One HIL_SENSOR in, one HIL_ACTUATOR_CONTROLS out."""
        t_us = self._vehicle.t_us
        if reading.t_us < t_us or (t_us and reading.t_us > t_us + GAP_MAX_US):
            self._start_over()
        commands = self._vehicle.step(reading)
        return self._hil.actuators(reading.t_us, commands, armed=self._vehicle.commander.armed)

    def _judge(self, inbox: Inbox) -> Health:
        if not inbox.is_up(HIL):
            self._judged = None
            return Health("starting", "waiting for the simulator")
        landed, malformed, refused = (
            self._vehicle.landed,
            self._hil.malformed + self._side.malformed,
            self._side.bad_signatures,
        )
        if self._health is not None and self._judged == (landed, malformed, refused):
            return self._health
        self._judged = (landed, malformed, refused)
        text = "connected to the simulator" if landed else "flying"
        text += f"; {malformed} malformed messages" if malformed else ""
        text += f"; {refused} messages without a valid signature" if refused else ""
        return Health("ok", text)
