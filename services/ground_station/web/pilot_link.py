"""The vehicle as one page's commands see it: there is none for a page that may not fly."""

from collections.abc import Callable

from jezero.aio import Vehicle
from jezero.services.ground_station.state import VehicleState
from jezero.services.ground_station.web.feed import Feed
from jezero.services.ground_station.web.playback_feed import PlaybackFeed


class PilotLink:
    """The way of all commands of one page to the vehicle.

    Args:
        feed: the connection to the vehicle.
        refusal: returns why the page may not fly now, "" if it may; called for each command.
    """

    def __init__(self, feed: Feed | PlaybackFeed, refusal: Callable[[], str]) -> None:
        self._feed = feed
        self._refusal = refusal

    @property
    def uav(self) -> Vehicle | None:
        """The vehicle; None for a page that may not fly, or without a connection."""
        return None if self._refusal() else self._feed.uav

    @property
    def vehicle(self) -> str:
        """Name of the vehicle, as in its keys; "" for a recording."""
        return self._feed.vehicle if isinstance(self._feed, Feed) else ""

    @property
    def refusal(self) -> str:
        """Why the page may not fly now; "" if it may."""
        return self._refusal()

    @property
    def problem(self) -> str:
        """Why there is no vehicle."""
        return self._refusal() or self._feed.problem

    @property
    def state(self) -> VehicleState:
        """What arrived from the vehicle."""
        return self._feed.state
