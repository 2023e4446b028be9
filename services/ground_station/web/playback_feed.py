"""A recording in the place of a live vehicle, for one page."""

import asyncio
import time

from jezero.recording.mcap_file import RecordingError
from jezero.services.ground_station.playback import Playback, RecordedFlight
from jezero.services.ground_station.state import VehicleState

RECORDED = "this is a recording: nothing can be flown"
NO_STATUS = "The recording has no status of this time."
SPEED_MAX = 50.0


class PlaybackFeed:
    """Plays a recording.

    Attributes:
        flight: the recording.
        playing: whether time goes on.
        speed: seconds of the flight per second.
        problem: why there is no state, where there is none.
        uav: there is none to fly.
        ground: the shape of the ground, which no recording has: it is drawn level.
        ground_version: number of that shape.
    """

    uav = None
    ground = None
    ground_version = 0

    def __init__(self, flight: RecordedFlight, playback: Playback) -> None:
        self.flight = flight
        self.playing, self.speed, self.problem = False, 1.0, NO_STATUS
        self._playback = playback
        self._wanted_s: float | None = None
        self._updated_s = time.monotonic()

    @property
    def state(self) -> VehicleState:
        """State of the vehicle at the present time of the recording."""
        return self._playback.state

    @property
    def now_s(self) -> float:
        """Present time of the recording."""
        return self._playback.t_s

    def play(self, playing: bool) -> None:
        """Start or pause; at the end, start again from the beginning."""
        if playing and self.now_s >= self.flight.duration_s:
            self._wanted_s = 0.0
        self.playing = playing

    def seek(self, t_s: float) -> None:
        """Go to a time at the next `advance`."""
        self._wanted_s = t_s

    def set_speed(self, speed: float) -> None:
        """Set the seconds of the flight per second."""
        self.speed = min(max(speed, 0.1), SPEED_MAX)

    async def advance(self) -> None:
        """Move on by the time since the last call, or to the time that `seek` was given."""
        now_s, before_s = time.monotonic(), self._updated_s
        self._updated_s = now_s
        wanted_s, self._wanted_s = self._wanted_s, None
        if wanted_s is None:
            if not self.playing:
                return
            wanted_s = self.now_s + self.speed * min(now_s - before_s, 1.0)
        try:
            await asyncio.to_thread(self._playback.move_to, wanted_s)
        except RecordingError as error:
            self.problem, self.playing = str(error), False
        if self.now_s >= self.flight.duration_s:
            self.playing = False
