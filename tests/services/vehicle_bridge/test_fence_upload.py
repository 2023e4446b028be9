"""The autopilot's own fence, over MAVLink's mission protocol with the embedded autopilot at the other end."""

import pytest

from jezero.base.frames import ned_from_geodetic
from jezero.base.mavlink import MavMessage, dialect
from jezero.schemas.fence import Fence, Zone
from jezero.services.vehicle_bridge.fence import KEEP_IN, KEEP_OUT, FenceUpload, autopilot_items
from tests.services.autopilot.test_mavlink_receiver import send
from tests.services.autopilot.test_service import Bench

ORIGIN_DEG = (47.3977418, 8.5455938, 488.0)
FENCE = Fence(
    keep_in=Zone(name="field", corners_ned_m=((-20.0, -20.0), (20.0, -20.0), (20.0, 20.0), (-20.0, 20.0))),
    keep_out=(
        Zone(name="crater", corners_ned_m=((4.0, -4.0), (12.0, -4.0), (12.0, 4.0), (4.0, 4.0))),
        Zone(name="stone", corners_ned_m=((0.0, 0.0), (1.0, 0.0), (1.0, 1.0))),
    ),
)


def test_the_autopilots_fence_is_two_metres_wider_and_small_zones_to_stay_out_of_vanish() -> None:
    items = autopilot_items(FENCE, ORIGIN_DEG)
    assert [(command, count) for command, count, _ in items] == [(KEEP_IN, 4)] * 4 + [(KEEP_OUT, 4)] * 4
    corners_m = [ned_from_geodetic((*corner, ORIGIN_DEG[2]), ORIGIN_DEG)[:2] for _, _, corner in items]
    assert max(north for north, _ in corners_m[:4]) == pytest.approx(22.0, abs=0.01)
    assert min(north for north, _ in corners_m[4:]) == pytest.approx(6.0, abs=0.01)
    assert max(north for north, _ in corners_m[4:]) == pytest.approx(10.0, abs=0.01)


def test_of_a_zone_that_falls_apart_when_it_is_made_smaller_the_larger_part_stays() -> None:
    """Two fields, 20 m and 12 m wide, with a strip of 2 m between them, which the margin of 2 m takes away."""
    both = (
        *((-10.0, -10.0), (10.0, -10.0), (10.0, -1.0), (30.0, -1.0), (30.0, -6.0), (42.0, -6.0)),
        *((42.0, 6.0), (30.0, 6.0), (30.0, 1.0), (10.0, 1.0), (10.0, 10.0), (-10.0, 10.0)),
    )
    items = autopilot_items(Fence(keep_out=(Zone(name="fields", corners_ned_m=both),)), ORIGIN_DEG)
    corners_m = [ned_from_geodetic((*corner, ORIGIN_DEG[2]), ORIGIN_DEG)[:2] for _, _, corner in items]
    assert {command for command, _, _ in items} == {KEEP_OUT}
    assert {count for _, count, _ in items} == {len(items)}, "one polygon"
    for axis in (0, 1):
        assert min(corner[axis] for corner in corners_m) == pytest.approx(-8.0, abs=0.01)
        assert max(corner[axis] for corner in corners_m) == pytest.approx(8.0, abs=0.01)


def exchange(bench: Bench, upload: FenceUpload) -> None:
    """Pass messages until neither side has one."""
    message = upload.due(0)
    while message is not None:
        replies: list[MavMessage] = send(bench, message)
        message = next((item for reply in replies if (item := upload.on_message(reply, 0)) is not None), None)


def test_the_embedded_autopilot_stores_the_fence_and_gives_it_back() -> None:
    bench, upload = Bench(), FenceUpload(1)
    bench.rest(0.1)
    items = autopilot_items(FENCE, ORIGIN_DEG)
    upload.start(items)
    exchange(bench, upload)
    assert upload.done
    (count,) = send(bench, dialect.MAVLink_mission_request_list_message(1, 1, dialect.MAV_MISSION_TYPE_FENCE))
    assert count.count == len(items)
    (item,) = send(bench, dialect.MAVLink_mission_request_int_message(1, 1, 5, dialect.MAV_MISSION_TYPE_FENCE))
    assert (item.command, item.param1) == (KEEP_OUT, 4.0)
    assert (item.x, item.y) == (round(items[5][2][0] * 1e7), round(items[5][2][1] * 1e7))
    upload.clear()
    exchange(bench, upload)
    (count,) = send(bench, dialect.MAVLink_mission_request_list_message(1, 1, dialect.MAV_MISSION_TYPE_FENCE))
    assert count.count == 0


def test_an_autopilot_that_never_replies_is_named_after_some_tries() -> None:
    upload = FenceUpload(1)
    assert upload.due(0) is None, "without a fence nothing is sent"
    upload.start(autopilot_items(FENCE, ORIGIN_DEG))
    sent_ms = [ms for ms in range(0, 4600, 100) if upload.due(ms * 1_000_000) is not None]
    assert sent_ms == [0, 1000, 2000, 3000, 4000]
    assert upload.failure == "", "it may still reply to the last one"
    assert upload.due(5_100_000_000) is None
    assert upload.failure == "the autopilot doesn't reply"


def test_an_autopilot_that_asks_for_items_gets_as_much_time_again() -> None:
    upload = FenceUpload(1)
    upload.start(autopilot_items(FENCE, ORIGIN_DEG))
    assert upload.due(0) is not None
    request = dialect.MAVLink_mission_request_int_message(1, 191, 0, dialect.MAV_MISSION_TYPE_FENCE)
    assert upload.on_message(request, 900_000_000) is not None
    assert upload.due(1_800_000_000) is None
    assert upload.due(1_900_000_000) is not None


def test_messages_about_another_mission_and_items_that_there_are_not_are_ignored() -> None:
    upload = FenceUpload(1)
    fence, route = dialect.MAV_MISSION_TYPE_FENCE, dialect.MAV_MISSION_TYPE_MISSION
    first = dialect.MAVLink_mission_request_int_message(1, 191, 0, fence)
    assert upload.on_message(first, 0) is None, "no fence was sent"
    upload.start(autopilot_items(FENCE, ORIGIN_DEG))
    assert upload.on_message(dialect.MAVLink_mission_request_int_message(1, 191, 0, route), 0) is None
    assert upload.on_message(dialect.MAVLink_mission_request_int_message(1, 191, 8, fence), 0) is None
    upload.on_message(dialect.MAVLink_mission_ack_message(1, 191, 4, route), 0)
    assert (upload.failure, upload.done) == ("", False)
    upload.on_message(dialect.MAVLink_mission_ack_message(1, 191, 0, fence), 0)
    assert upload.done
    assert upload.on_message(first, 0) is None
    assert upload.due(9_000_000_000) is None


def test_a_restarted_autopilot_gets_the_fence_again_and_one_that_has_none_gets_none() -> None:
    upload = FenceUpload(1)
    upload.restart()
    upload.clear()
    assert upload.due(0) is None, "a fence that somebody else has stored stays"
    upload.start(autopilot_items(FENCE, ORIGIN_DEG))
    upload.on_message(dialect.MAVLink_mission_ack_message(1, 191, 0, dialect.MAV_MISSION_TYPE_FENCE), 0)
    upload.restart()
    message = upload.due(0)
    assert message is not None and message.count == 8


def test_a_refusal_is_named_with_its_number() -> None:
    upload = FenceUpload(1)
    upload.start(autopilot_items(FENCE, ORIGIN_DEG))
    upload.on_message(dialect.MAVLink_mission_ack_message(1, 191, 4, dialect.MAV_MISSION_TYPE_FENCE), 0)
    assert "refuses it with MAV_MISSION_RESULT 4" in upload.failure
    assert upload.due(0) is None


def test_a_fence_that_the_autopilot_takes_late_is_set_all_the_same() -> None:
    upload = FenceUpload(1)
    upload.start(autopilot_items(FENCE, ORIGIN_DEG))
    for second in range(30):
        upload.due(second * 1_000_000_000)
    assert upload.failure == "the autopilot doesn't reply"
    accepted = dialect.MAVLink_mission_ack_message(1, 1, dialect.MAV_MISSION_ACCEPTED, dialect.MAV_MISSION_TYPE_FENCE)
    upload.on_message(accepted, 30_000_000_000)
    assert (upload.done, upload.failure) == (True, "")
