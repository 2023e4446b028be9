"""A vehicle on its MAVLink links: what is asked there, and what is told."""

from collections.abc import Iterator, Mapping, Sequence

from jezero.mavlink import Signing
from jezero.runtime.service import Inbox, Output, Send
from jezero.services.autopilot.config import SigningConfig
from jezero.services.autopilot.parameters import Parameters
from jezero.services.autopilot.requests import Requests
from jezero.services.autopilot.telemetry import GCS_INTERVALS_US, OFFBOARD_INTERVALS_US, TelemetryLink
from jezero.services.autopilot.vehicle import Vehicle

OFFBOARD, GCS = "offboard", "gcs"
_INTERVALS_US = {OFFBOARD: OFFBOARD_INTERVALS_US, GCS: GCS_INTERVALS_US}


def make_signing(config: SigningConfig) -> dict[str, Signing]:
    """The links on which signatures are demanded."""
    key = bytes.fromhex(config.key)
    return {name: Signing(key) for name in config.links} if key else {}


class MavlinkSide:
    """Answers and telemetry of one vehicle.

    Args:
        links: OFFBOARD, GCS, or both.
        signing: of those links that demand it.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        parameters: Parameters,
        system_id: int,
        links: Sequence[str],
        signing: Mapping[str, Signing],
    ) -> None:
        self._vehicle = vehicle
        self._requests = Requests(vehicle, parameters)
        interval_min_us = round(parameters.config.telemetry.interval_min_s * 1e6)
        self._links = {
            name: TelemetryLink(system_id, _INTERVALS_US[name], interval_min_us, signing.get(name)) for name in links
        }

    @property
    def malformed(self) -> int:
        """Stretches of bytes that were no message."""
        return sum([link.malformed for link in self._links.values()])

    @property
    def bad_signatures(self) -> int:
        """Messages whose signature was not believed."""
        return sum([link.bad_signatures for link in self._links.values()])

    def answer(self, inbox: Inbox) -> Iterator[Output]:
        """Do what was asked."""
        for name, link in self._links.items():
            data = inbox.received(name)
            for message in link.receive(data) if data else ():
                if answer := self._requests.answer(link, message):
                    yield Send(name, answer)

    def tell(self, inbox: Inbox) -> Iterator[Output]:
        """What the vehicle has to say, and what is due."""
        vehicle = self._vehicle
        commander = vehicle.commander
        said = commander.take_said()
        state = (commander.mode.custom_mode, commander.armed, vehicle.landed)
        for name, link in self._links.items():
            if not inbox.is_up(name):
                continue
            data = b"".join([link.text(severity, text) for severity, text in said]) if said else b""
            if vehicle.t_us and link.is_due(vehicle.t_us, state):
                data += link.stream(vehicle.snapshot())
            if data:
                yield Send(name, data)
