"""The MAVLink interface of a vehicle: handles received messages and sends telemetry on all links."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence

from jezero.base.mavlink import Signing
from jezero.runtime.service import Inbox, Output, Send
from jezero.services.autopilot.config import SigningConfig
from jezero.services.autopilot.mavlink_receiver import MavlinkReceiver
from jezero.services.autopilot.parameters import Parameters
from jezero.services.autopilot.telemetry import (
    GCS,
    GCS_INTERVALS_US,
    OFFBOARD,
    OFFBOARD_INTERVALS_US,
    Senders,
    TelemetryLink,
)
from jezero.services.autopilot.vehicle import AutopilotVehicle

_INTERVALS_US = {OFFBOARD: OFFBOARD_INTERVALS_US, GCS: GCS_INTERVALS_US}


def signing_by_link(config: SigningConfig, kept: int, keep: Callable[[int], None]) -> dict[str, Signing]:
    """Signing of each link that requires signatures; see `Signing` for `kept` and `keep`.

    The links have it in common: a message that was captured on one of them isn't accepted on another.
    """
    key = bytes.fromhex(config.key)
    return dict.fromkeys(config.links, Signing(key, kept, keep)) if key else {}


class MavlinkInterface:
    """Receives messages and sends telemetry of one vehicle.

    Args:
        links: OFFBOARD, GCS, or both.
        signing: signing of the links that require it.
    """

    def __init__(
        self,
        vehicle: AutopilotVehicle,
        parameters: Parameters,
        system_id: int,
        links: Sequence[str],
        signing: Mapping[str, Signing],
    ) -> None:
        self._vehicle = vehicle
        self._receiver = MavlinkReceiver(vehicle, parameters)
        config = parameters.config.telemetry
        interval_min_us = round(config.interval_min_s * 1e6)
        self._senders = Senders((system_id, *config.ground_systems))
        self._links = {
            name: TelemetryLink(name, system_id, self._senders, _INTERVALS_US[name], interval_min_us, signing.get(name))
            for name in links
        }

    @property
    def malformed(self) -> int:
        """Number of malformed messages on all links."""
        return sum([link.malformed for link in self._links.values()])

    @property
    def bad_signatures(self) -> int:
        """Number of messages without an accepted signature on all links."""
        return sum([link.bad_signatures for link in self._links.values()])

    @property
    def refused(self) -> Counter[int]:
        """Number of messages to this vehicle by the MAVLink system that sent them without being listed."""
        return self._senders.refused

    def handle_messages(self, inbox: Inbox) -> Iterator[Output]:
        """Carry out the received messages and reply to them."""
        for name, link in self._links.items():
            data = inbox.received(name)
            for message in link.receive(data) if data else ():
                if reply := self._receiver.handle(link, message):
                    yield Send(name, reply)

    def send_telemetry(self, inbox: Inbox) -> Iterator[Output]:
        """Send status texts, and the streams that are due."""
        vehicle = self._vehicle
        commander = vehicle.commander
        texts = commander.pop_status_texts()
        state = (commander.mode.custom_mode, commander.armed, vehicle.landed)
        for name, link in self._links.items():
            if not inbox.is_up(name):
                continue
            data = b"".join([link.status_text(severity, text) for severity, text in texts]) if texts else b""
            if vehicle.t_us and link.is_due(vehicle.t_us, state):
                data += link.streams(vehicle.snapshot())
            if data:
                yield Send(name, data)
