"""The mission service of one vehicle."""

from collections.abc import Iterator
from typing import Any

from jezero.client.errors import Refused, TimedOut, Unreachable
from jezero.client.session import Connection, decode
from jezero.client.status import REPLY_TIMEOUT_S
from jezero.client.subscription import Subscription
from jezero.schemas.mission import Mission, MissionCommand, MissionProgress, MissionReply
from jezero.schemas.rows import Endpoint
from jezero.schemas.struct import Payload
from jezero.schemas.topics import COMMAND_MISSION, MISSION, RUN_MISSION

PROGRESS_TIMEOUT_S = 3.0
"""The service publishes its progress twice a second."""


class Missions:
    """Missions of one vehicle, the attribute `Vehicle.mission`.

    The mission service on the vehicle flies a mission, so that it goes on when its sender is gone.
    """

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def run(self, mission: Mission) -> str:
        """Begin a mission; returns its id. Doesn't wait for its end: `watch` does.

        Raises:
            Refused: another mission is flown, or a step has no valid goal.
            Unreachable: no mission service replies.
            TimedOut: the reply is missing.
            ValueError: it is no mission, such as the name of a file.
        """
        if not isinstance(mission, Mission):
            raise ValueError(f"{mission!r} is no Mission: jezero.mission_files.read_mission reads one from a file")
        return self._request(RUN_MISSION, mission)

    def pause(self) -> None:
        """Hold the present step; errors as of `run`."""
        self._request(COMMAND_MISSION, MissionCommand(command="pause"))

    def resume(self) -> None:
        """Go on with a paused or interrupted mission; errors as of `run`."""
        self._request(COMMAND_MISSION, MissionCommand(command="resume"))

    def swapped(self) -> None:
        """Go on with an interrupted mission after a change of the battery; errors as of `run`."""
        self._request(COMMAND_MISSION, MissionCommand(command="swapped"))

    def skip(self) -> None:
        """Leave the present step out and go on; errors as of `run`."""
        self._request(COMMAND_MISSION, MissionCommand(command="skip"))

    def stop(self) -> None:
        """End the mission; the vehicle hovers. Errors as of `run`."""
        self._request(COMMAND_MISSION, MissionCommand(command="stop"))

    def progress(self) -> MissionProgress:
        """The progress of the mission that is flown, or of the last one.

        Raises:
            Unreachable: no mission service replies.
            TimedOut: the reply is missing.
        """
        arrivals = self._connection.stream(MISSION.name, b"", REPLY_TIMEOUT_S)
        progress: MissionProgress = decode(
            MissionProgress, self._connection.first(arrivals, MISSION.name, REPLY_TIMEOUT_S)
        )
        return progress

    def watch(self) -> Iterator[MissionProgress]:
        """Yield the progress, then each one published, for as long as the caller wants.

        Raises:
            Unreachable: the mission service is silent for 3 s.
        """
        with Subscription(self._connection, MISSION) as stream:
            yield self.progress()
            while True:
                try:
                    message = stream.next(PROGRESS_TIMEOUT_S)
                except TimedOut:
                    silent = f"the mission service has been silent for {PROGRESS_TIMEOUT_S:g} s: jezero ps"
                    raise Unreachable(silent) from None
                yield message

    def _request(self, endpoint: Endpoint[Any, MissionReply], request: Payload) -> str:
        reply: MissionReply = self._connection.request(endpoint, request, REPLY_TIMEOUT_S)
        if not reply.accepted:
            raise Refused(reply.reason)
        return reply.mission_id
