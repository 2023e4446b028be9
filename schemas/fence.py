"""The fence: places to stay in and out of, which the vehicle bridge publishes and the action servers check."""

from typing import Annotated

from msgspec import Meta

from jezero.schemas.struct import Message, Payload, Position, Text

CORNERS_MAX, ZONES_MAX = 500, 50
ZoneName = Annotated[str, Meta(min_length=1, max_length=64)]
NedCorners = Annotated[tuple[tuple[Position, Position], ...], Meta(max_length=CORNERS_MAX)]
DegreeCorners = Annotated[
    tuple[tuple[Annotated[float, Meta(ge=-90.0, le=90.0)], Annotated[float, Meta(ge=-180.0, le=180.0)]], ...],
    Meta(max_length=CORNERS_MAX),
]


class Zone(Payload, frozen=True, kw_only=True):
    """A polygon on the map, with corners in metres or in degrees, never both.

    Attributes:
        name: name of the zone, for people.
        corners_ned_m: (n, 2) north and east of the world's origin; the last corner doesn't repeat the first one.
        corners_deg: (n, 2) latitude and longitude; the bridge places them around the vehicle's origin.
    """

    name: ZoneName
    corners_ned_m: NedCorners = ()
    corners_deg: DegreeCorners = ()

    def __post_init__(self) -> None:
        if bool(self.corners_ned_m) == bool(self.corners_deg):
            raise ValueError(f"zone {self.name!r} needs either corners_ned_m or corners_deg")
        if len(set(self.corners_ned_m or self.corners_deg)) < 3:
            raise ValueError(f"zone {self.name!r} has fewer than three corners")


class Fence(Payload, frozen=True, kw_only=True):
    """A fence.

    Attributes:
        name: name of the fence, for people.
        keep_in: the area that the vehicle stays in; None for no such area.
        keep_out: areas that the vehicle stays out of.
        ceiling_m: greatest height above the world's origin; None for none.
        floor_over_ground_m: least height over the ground, except at takeoffs and landings; 0 for none.
    """

    name: ZoneName = "fence"
    keep_in: Zone | None = None
    keep_out: Annotated[tuple[Zone, ...], Meta(max_length=ZONES_MAX)] = ()
    ceiling_m: Annotated[float, Meta(gt=0.0, le=1e4)] | None = None
    floor_over_ground_m: Annotated[float, Meta(ge=0.0, le=1e3)] = 0.0

    def __post_init__(self) -> None:
        if self.ceiling_m is not None and self.floor_over_ground_m >= self.ceiling_m:
            raise ValueError(f"the floor of {self.floor_over_ground_m:g} m is not below the ceiling")

    @property
    def zones(self) -> tuple[Zone, ...]:
        """All polygons."""
        return (*(() if self.keep_in is None else (self.keep_in,)), *self.keep_out)


class FenceState(Message, frozen=True, kw_only=True):
    """The fence that the bridge holds.

    Attributes:
        fence: the fence, its zones in metres; None for none, and while zones in degrees wait for the vehicle's origin.
        fence_id: the same as `Status.fence_id`; "" for no fence.
        outside: where and how far the vehicle is outside, for people; "" inside.
        autopilot_failure: why the autopilot has not taken the fence as its own, for people; "" for no failure.
    """

    fence: Fence | None = None
    fence_id: str = ""
    outside: Text = ""
    autopilot_failure: Text = ""


class SetFence(Payload, frozen=True, kw_only=True):
    """Request for another fence, refused in flight.

    Attributes:
        fence: the new fence; None for none.
    """

    fence: Fence | None = None


class FenceReply(Payload, frozen=True, kw_only=True):
    """Reply to `SetFence`.

    Attributes:
        accepted: the fence is in force.
        reason: reason of a refusal, for people.
    """

    accepted: bool
    reason: Text = ""
