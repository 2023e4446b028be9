"""The fence in force, stepped without an autopilot: who has left it, and where targets and hover points may be."""

from collections.abc import Iterable

import pytest
from msgspec.structs import replace

from jezero.base.frames import Vec3
from jezero.base.vehicle_config import VehicleLimitsConfig
from jezero.runtime.service import Output, Publish, Reply, Request
from jezero.schemas.fence import Fence, FenceReply, FenceState, SetFence, Zone
from jezero.schemas.state import StatusCode
from jezero.schemas.topics import SET_FENCE
from jezero.services.vehicle_bridge.config import OnFence
from jezero.services.vehicle_bridge.fence import FenceKeeper, FenceUpload
from jezero.services.vehicle_bridge.vehicle import Target, VehicleSnapshot
from tests.services.vehicle_bridge.rig import Box

S = 1_000_000_000
FIELD = Zone(name="field", corners_ned_m=((-10.0, -10.0), (10.0, -10.0), (10.0, 10.0), (-10.0, 10.0)))
FENCE = Fence(keep_in=FIELD, ceiling_m=10.0, floor_over_ground_m=1.0)
ORIGIN_DEG = (47.3977418, 8.5455938, 488.0)
IN_DEGREES = Fence(keep_in=Zone(name="field", corners_deg=((47.39, 8.54), (47.40, 8.54), (47.40, 8.55), (47.39, 8.55))))


def keeper(fence: Fence | None = FENCE, on_fence: OnFence = "return") -> FenceKeeper:
    return FenceKeeper(on_fence, VehicleLimitsConfig(), FenceUpload(1), fence)


def at(north_m: float | None, timer_ns: int = 0, *, height_m: float = 3.0) -> VehicleSnapshot:
    pos_ned_m = None if north_m is None else (north_m, 0.0, -height_m)
    return VehicleSnapshot(t_ns=timer_ns, timer_ns=timer_ns, armed=True, pos_ned_m=pos_ned_m, height_m=height_m)


def point(north_m: float, height_m: float = 3.0) -> Target:
    return Target((north_m, 0.0, -height_m), None, None, 0.0)


def states(outputs: Iterable[Output]) -> list[FenceState]:
    messages = [output.message for output in outputs if isinstance(output, Publish)]
    return [message for message in messages if isinstance(message, FenceState)]


def test_a_vehicle_at_the_edge_leaves_once_and_again_only_after_it_was_well_inside() -> None:
    fence = keeper()
    left = [fence.update(at(north_m)) for north_m in (9.0, 10.1, 9.9, 10.1, 9.9, 10.1, 9.6, 10.1)]
    assert left == [False, True, False, False, False, False, False, True]
    assert fence.outside.startswith("0.1 m outside the area 'field' to stay in")


def test_a_vehicle_that_was_never_inside_and_one_without_position_have_not_left() -> None:
    fence = keeper()
    assert [fence.update(at(north_m)) for north_m in (12.0, 9.0, None, 12.0)] == [False] * 4
    assert fence.outside
    assert not fence.update(at(None))
    assert fence.outside == ""
    assert not keeper(None).update(at(1000.0))


@pytest.mark.parametrize(
    ("on_fence", "by_goal", "sent_north_m"),
    [("return", True, 11.0), ("return", False, 12.0), ("stop", True, 12.0), ("land", True, 12.0)],
)
def test_only_a_goal_is_led_in_from_outside_and_only_where_the_vehicle_would_return_by_itself(
    on_fence: OnFence, by_goal: bool, sent_north_m: float
) -> None:
    fence = keeper(on_fence=on_fence)
    fence.update(at(12.0))
    sent = fence.limited(point(12.0), at(12.0), StatusCode.GO_TO, by_goal=by_goal)
    assert sent is not None and sent.pos_ned_m == pytest.approx((sent_north_m, 0.0, -3.0))


def test_a_landed_vehicle_is_not_held_back() -> None:
    fence, far = keeper(), point(30.0)
    standing = replace(at(0.0), landed=True)
    assert fence.limited(far, standing, StatusCode.IDLE, by_goal=True) is far
    assert fence.limited(None, at(0.0), StatusCode.HOVER, by_goal=False) is None
    assert fence.health_text == ""


@pytest.mark.parametrize(
    ("code", "holds"),
    [
        (StatusCode.HOVER, True),
        (StatusCode.GO_TO, True),
        (StatusCode.TAKEOFF, False),
        (StatusCode.LANDING, False),
        (StatusCode.LANDING_DONE, False),
        (StatusCode.ABORT, False),
    ],
)
def test_the_floor_holds_but_for_a_takeoff_and_a_landing(code: StatusCode, holds: bool) -> None:
    sent = keeper().limited(point(0.0, height_m=0.2), at(0.0, height_m=1.5), code, by_goal=True)
    assert sent is not None and sent.pos_ned_m is not None
    assert sent.pos_ned_m[2] == pytest.approx(-1.0 if holds else -0.2)


def test_health_counts_how_often_a_target_began_to_be_held_back_and_names_the_last_limit() -> None:
    fence = keeper()
    far, near, high = point(30.0, 9.0), point(1.0, 9.0), point(0.0, 12.0)
    for target in (far, far, near, near, high, high):
        fence.limited(target, at(0.0, height_m=9.0), StatusCode.GO_TO, by_goal=True)
    assert fence.health_text == "; held back 2 times, the last time by the ceiling of 10 m"
    fence.update(at(12.0))
    assert fence.health_text.startswith("; the vehicle is outside the fence; held back 2 times")


@pytest.mark.parametrize(
    ("pos_ned_m", "words"),
    [
        ((5.0, 0.0, -3.0), ""),
        ((20.0, 0.0, -3.0), "10.0 m outside the area 'field' to stay in"),
        ((5.0, 0.0, -0.3), "0.3 m up is below the floor of 1 m"),
        ((5.0, 0.0, -12.0), "2.0 m above the ceiling of 10 m"),
        (None, ""),
    ],
)
def test_a_hover_point_is_refused_outside_the_fence_and_below_its_floor(pos_ned_m: Vec3 | None, words: str) -> None:
    refusal = keeper().point_refusal(pos_ned_m)
    assert words in refusal
    assert bool(refusal) is bool(words)
    assert keeper(None).point_refusal(pos_ned_m) == ""


def test_a_vehicle_that_hovers_outside_returns_after_two_seconds_to_a_point_1_m_inside() -> None:
    fence, target = keeper(), point(12.0)
    assert [fence.return_point(target, at(12.0, t_s * S)) for t_s in (10, 11)] == [None, None]
    inside = fence.return_point(target, at(12.0, 13 * S))
    assert inside == pytest.approx((9.0, 0.0, -3.0))


@pytest.mark.parametrize("between", [point(9.0), None, Target(None, (0.0, 0.0, 0.0), None, 0.0)])
def test_the_two_seconds_begin_when_the_hover_point_is_outside(between: Target | None) -> None:
    fence, target = keeper(), point(12.0)
    assert fence.return_point(target, at(12.0, 10 * S)) is None
    assert fence.return_point(between, at(9.0, 11 * S)) is None
    assert [fence.return_point(target, at(12.0, t_s * S)) for t_s in (12, 13)] == [None, None]
    assert fence.return_point(target, at(12.0, 15 * S)) is not None


@pytest.mark.parametrize("fence", [keeper(on_fence="stop"), keeper(on_fence="land"), keeper(None)])
def test_a_vehicle_outside_stays_by_setting_and_without_a_fence(fence: FenceKeeper) -> None:
    assert [fence.return_point(point(12.0), at(12.0, t_s * S)) for t_s in (10, 20)] == [None, None]


def test_a_vehicle_stays_where_no_point_inside_is_found() -> None:
    """The whole area to stay in lies within a zone to stay out of."""
    wide = Zone(name="wide", corners_ned_m=((-30.0, -30.0), (30.0, -30.0), (30.0, 30.0), (-30.0, 30.0)))
    fence = keeper(Fence(keep_in=FIELD, keep_out=(wide,)))
    assert [fence.return_point(point(12.0), at(12.0, t_s * S)) for t_s in (10, 20)] == [None, None]


@pytest.mark.parametrize(
    ("code", "armed", "accepted"),
    [
        (StatusCode.IDLE, False, True),
        (StatusCode.IDLE, True, False),
        (StatusCode.IDLE, None, False),
        (StatusCode.LANDING_DONE, False, False),
        (StatusCode.EXTERNAL, False, False),
    ],
)
def test_a_fence_is_set_and_kept_while_the_vehicle_is_idle_and_surely_disarmed(
    code: StatusCode, armed: bool | None, accepted: bool
) -> None:
    kept: list[Fence | None] = []
    fence = FenceKeeper("return", VehicleLimitsConfig(), FenceUpload(1), keep=kept.append)
    box = Box()
    box.pending[SET_FENCE.name] = [Request(7, "test", SetFence(fence=FENCE))]
    (reply,) = fence.handle(code, replace(at(0.0), armed=armed), box)
    assert isinstance(reply, Reply) and isinstance(reply.payload, FenceReply)
    assert reply.request_id == 7
    assert reply.payload.accepted is accepted
    assert ("land and disarm first" in reply.payload.reason) is not accepted
    assert kept == ([FENCE] if accepted else [])
    assert bool(fence.fence_id) is accepted


@pytest.mark.parametrize(("t_ns", "published_ns"), [(5 * S, 5 * S), (-S, 0)])
def test_the_fence_is_published_with_vehicle_time_which_is_never_negative(t_ns: int, published_ns: int) -> None:
    (state,) = states(keeper().publish(ORIGIN_DEG, replace(at(0.0), t_ns=t_ns), 0))
    assert state.t_ns == published_ns


def test_the_fence_is_published_once_a_second_and_when_the_vehicle_leaves_or_comes_in() -> None:
    fence = keeper()

    def published_ms(times_ms: range) -> list[int]:
        return [t for t in times_ms if states(fence.publish(ORIGIN_DEG, at(0.0), t * 1_000_000))]

    assert published_ms(range(0, 3100, 100)) == [0, 1000, 2000, 3000]
    fence.update(at(12.0))
    assert published_ms(range(3100, 3500, 100)) == [3100]
    fence.update(at(13.0))
    assert published_ms(range(3500, 3800, 100)) == [], "still outside"
    fence.update(at(9.0))
    assert published_ms(range(3800, 4200, 100)) == [3800]


def test_zones_in_degrees_wait_for_the_origin_and_are_placed_anew_around_another_one() -> None:
    fence = keeper(IN_DEGREES)
    (before,) = states(fence.publish(None, at(0.0), 0))
    assert before.fence is None and before.fence_id
    (placed,) = states(fence.publish(ORIGIN_DEG, at(0.0), 100))
    assert placed.fence is not None and placed.fence.keep_in is not None
    south_m = min(north_m for north_m, _ in placed.fence.keep_in.corners_ned_m)
    assert south_m == pytest.approx(-862.0, abs=5.0)  # 0.00774 degrees of 111.2 km
    moved = (ORIGIN_DEG[0] + 0.001, *ORIGIN_DEG[1:])
    (again,) = states(fence.publish(moved, at(0.0), 200))
    assert again.fence is not None and again.fence.keep_in is not None
    south_again_m = min(north_m for north_m, _ in again.fence.keep_in.corners_ned_m)
    assert south_again_m - south_m == pytest.approx(-111.2, abs=1.0)
    assert len({before.fence_id, placed.fence_id, again.fence_id}) == 3


@pytest.mark.parametrize(
    ("fence", "origin_deg", "corners"),
    [(FENCE, ORIGIN_DEG, 4), (FENCE, None, None), (IN_DEGREES, None, None), (None, ORIGIN_DEG, None)],
)
def test_the_autopilot_gets_the_fence_once_its_place_on_earth_is_known(
    fence: Fence | None, origin_deg: Vec3 | None, corners: int | None
) -> None:
    upload = FenceUpload(1)
    held = FenceKeeper("return", VehicleLimitsConfig(), upload, fence)
    list(held.publish(origin_deg, at(0.0), 0))
    message = upload.due(0)
    assert (None if message is None else message.count) == corners


def test_the_autopilot_gets_the_fence_once_and_again_around_another_origin() -> None:
    upload = FenceUpload(1)
    fence = FenceKeeper("return", VehicleLimitsConfig(), upload, FENCE)

    def is_announced(origin_deg: Vec3, t_s: int) -> bool:
        list(fence.publish(origin_deg, at(0.0), t_s * S))
        return upload.due(t_s * S) is not None

    assert is_announced(ORIGIN_DEG, 10)
    upload.done = True
    assert not is_announced(ORIGIN_DEG, 20)
    assert is_announced((ORIGIN_DEG[0] + 0.001, *ORIGIN_DEG[1:]), 30)
