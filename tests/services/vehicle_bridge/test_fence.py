"""The bridge holds the fence: what goes to the autopilot, and what happens to a vehicle that is pushed out."""

import pytest
from msgspec.structs import replace

from jezero.base.mavlink import MavlinkCodec, dialect
from jezero.runtime.service import Health, Publish
from jezero.schemas.commands import Hover, Phase
from jezero.schemas.fence import Fence, FenceState, SetFence, Zone
from jezero.schemas.state import StatusCode
from jezero.schemas.topics import HOVER, SET_FENCE
from jezero.services.vehicle_bridge.config import OnFence, VehicleBridgeConfig
from tests.services.vehicle_bridge.rig import Rig

FIELD = Zone(name="field", corners_ned_m=((-10.0, -10.0), (10.0, -10.0), (10.0, 10.0), (-10.0, 10.0)))
FENCE = Fence(keep_in=FIELD, ceiling_m=10.0)


def flying(on_fence: OnFence = "return") -> Rig:
    rig = Rig(replace(VehicleBridgeConfig(), on_fence=on_fence)).ready()
    assert rig.request(SET_FENCE, SetFence(fence=FENCE)).accepted
    return rig.fly()


def push_to(rig: Rig, north_m: float) -> None:
    rig.autopilot.pos[0] = north_m


def test_setpoints_beyond_the_fence_reach_the_autopilot_as_ones_in_front_of_it() -> None:
    rig = flying()
    control_id = rig.go("go_to", Phase.GO_TO)
    push_to(rig, 9.0)
    outwards = {"pos_ned_m": None, "vel_ned_mps": (8.0, 1.0, 0.0)}
    rig.run(0.2, lambda: rig.setpoint(control_id, Phase.GO_TO, **outwards))
    sent = rig.autopilot.setpoints[-1]
    assert sent.vx == pytest.approx((2.0 * 1.0 * 0.6) ** 0.5, abs=1e-3)
    assert sent.vy == pytest.approx(1.0)
    assert rig.status.grant > 0
    rig.run(0.2, lambda: rig.setpoint(control_id, Phase.GO_TO, pos_ned_m=(30.0, 0.0, -2.0)))
    assert rig.autopilot.setpoints[-1].x == pytest.approx(9.6, abs=1e-3)


def test_a_vehicle_that_is_pushed_out_ends_its_goal_with_the_zone_and_returns_inside() -> None:
    rig = flying()
    control_id = rig.go("go_to", Phase.GO_TO)
    push_to(rig, 10.6)
    rig.run_until(
        lambda: rig.status.code == StatusCode.ABORT,
        lambda: rig.setpoint(control_id, Phase.GO_TO, pos_ned_m=(8.0, 0.0, -2.0)),
    )
    assert "ended: the vehicle is 0.6 m outside the area 'field' to stay in, at north 10.6 m" in rig.status.text
    rig.run(0.5)
    assert rig.status.code == StatusCode.HOVER
    assert rig.autopilot.setpoints[-1].x == pytest.approx(10.6, abs=1e-3)
    rig.run_until(lambda: rig.autopilot.setpoints[-1].x < 9.5)
    assert rig.autopilot.setpoints[-1].x == pytest.approx(9.0, abs=1e-2)
    assert "it returns inside the fence" in rig.status.text


def test_a_vehicle_that_a_goal_led_in_stays_as_long_outside_when_it_is_pushed_out_again() -> None:
    rig = flying()
    for _ in range(2):
        control_id = rig.acquire("go_to").control_id

        def fly(control_id: str = control_id) -> None:
            rig.setpoint(control_id, Phase.GO_TO, pos_ned_m=(5.0, 0.0, -2.0))

        push_to(rig, 5.0)
        rig.run(3.0, fly)
        push_to(rig, 10.6)
        rig.run_until(lambda: rig.status.code == StatusCode.HOVER, fly)
        rig.run(1.0)
        assert rig.autopilot.setpoints[-1].x == pytest.approx(10.6, abs=1e-3)
    rig.run_until(lambda: rig.autopilot.setpoints[-1].x < 9.5)


def test_a_vehicle_that_is_pushed_out_stays_there_by_setting() -> None:
    rig = flying("stop")
    control_id = rig.go("go_to", Phase.GO_TO)
    push_to(rig, 10.6)
    rig.run(0.3, lambda: rig.setpoint(control_id, Phase.GO_TO, pos_ned_m=(8.0, 0.0, -2.0)))
    rig.run(5.0)
    assert rig.status.code == StatusCode.HOVER
    assert rig.autopilot.setpoints[-1].x == pytest.approx(10.6, abs=1e-3)


def test_a_vehicle_that_is_pushed_out_lands_by_setting() -> None:
    rig = flying("land")
    rig.go("go_to", Phase.GO_TO)
    push_to(rig, 10.6)
    rig.run(1.0)
    assert rig.status.code == StatusCode.EXTERNAL
    assert rig.status.autopilot_mode == "AUTO.LAND"
    assert "landing: the vehicle is 0.6 m outside" in rig.status.text


def test_a_hover_that_is_pushed_out_keeps_its_point_inside() -> None:
    rig = flying()
    push_to(rig, 10.6)
    rig.run(5.0)
    assert rig.status.code == StatusCode.HOVER
    assert rig.autopilot.setpoints[-1].x == pytest.approx(0.0, abs=1e-3)


def test_a_hover_inside_stays_where_it_is_also_near_the_edge() -> None:
    rig = flying()
    push_to(rig, 9.3)
    assert rig.request(HOVER, Hover(hover_req=True, hover_pos=(9.3, 0.0, -2.0))).hover_mode
    rig.run(5.0)
    assert rig.status.code == StatusCode.HOVER
    assert rig.autopilot.setpoints[-1].x == pytest.approx(9.3, abs=1e-3)


def test_the_fence_is_published_once_a_second_and_at_once_when_the_vehicle_leaves_it() -> None:
    rig = flying()

    def published(seconds: float) -> list[FenceState]:
        rig.outputs.clear()
        rig.run(seconds)
        outputs = (output.message for output in rig.outputs if isinstance(output, Publish))
        return [message for message in outputs if isinstance(message, FenceState)]

    assert len(published(3.0)) == 3
    push_to(rig, 10.6)
    (first, *_) = published(0.1)
    assert "10.6 m" in first.outside


def test_a_goal_that_begins_outside_may_lead_in() -> None:
    rig = flying("stop")
    push_to(rig, 10.6)
    rig.run(0.5)
    control_id = rig.go("go_to", Phase.GO_TO)
    rig.run(1.0, lambda: rig.setpoint(control_id, Phase.GO_TO, pos_ned_m=(8.0, 0.0, -2.0)))
    assert rig.status.grant > 0
    assert rig.autopilot.setpoints[-1].x == pytest.approx(8.0, abs=1e-3)


def test_a_goal_that_begins_outside_and_waits_is_led_in() -> None:
    rig = flying()
    push_to(rig, 10.6)
    rig.run(0.5)
    control_id = rig.go("go_to", Phase.GO_TO)
    rig.run(1.0, lambda: rig.setpoint(control_id, Phase.GO_TO, pos_ned_m=(10.6, 0.0, -4.0)))
    sent = rig.autopilot.setpoints[-1]
    assert sent.x == pytest.approx(9.6, abs=1e-3)
    assert sent.z == pytest.approx(-4.0, abs=1e-3)
    climbing = {"pos_ned_m": None, "vel_ned_mps": (0.3, 0.0, -1.0)}
    rig.run(1.0, lambda: rig.setpoint(control_id, Phase.GO_TO, **climbing))
    sent = rig.autopilot.setpoints[-1]
    assert (sent.vx, sent.vz) == pytest.approx((-1.0, -1.0), abs=1e-3)


def test_a_fence_that_nobody_can_mean_is_refused_and_the_one_before_stays() -> None:
    rig = Rig().ready()
    assert rig.request(SET_FENCE, SetFence(fence=FENCE)).accepted
    rig.run(0.2)
    before = rig.status.fence_id
    bow = Zone(name="bow", corners_ned_m=((-10.0, -10.0), (10.0, 10.0), (10.0, -10.0), (-10.0, 10.0)))
    origin_deg = rig.odometry[-1].origin_deg
    assert origin_deg is not None
    latitude, longitude, _ = origin_deg
    exchanged = tuple((longitude + east, latitude + north) for north, east in ((0, 0), (1e-3, 0), (1e-3, 1e-3)))
    for zone, words in (
        (bow, "'bow': its edges cross"),
        (Zone(name="far", corners_deg=exchanged), "'far': latitude and longitude are exchanged"),
    ):
        reply = rig.request(SET_FENCE, SetFence(fence=Fence(keep_in=zone)))
        assert not reply.accepted and words in reply.reason
    rig.run(0.2)
    assert rig.status.fence_id == before != ""


def test_a_fence_does_not_change_while_the_vehicle_is_armed_or_flies() -> None:
    rig = flying()
    before = rig.status.fence_id
    for fence in (None, Fence(name="other", keep_in=FENCE.keep_in)):
        reply = rig.request(SET_FENCE, SetFence(fence=fence))
        assert not reply.accepted and "land and disarm first" in reply.reason
    assert rig.status.fence_id == before != ""
    rig = Rig().ready()
    rig.autopilot.armed = True
    rig.run(0.1)
    assert not rig.request(SET_FENCE, SetFence(fence=FENCE)).accepted


def test_a_hover_point_outside_is_refused_with_the_zone() -> None:
    rig = flying()
    reply = rig.request(HOVER, Hover(hover_req=True, hover_pos=(20.0, 0.0, -2.0)))
    assert not reply.hover_mode
    assert "10.0 m outside the area 'field' to stay in" in reply.reason


def test_a_fence_that_the_autopilot_does_not_take_stands_in_health_and_on_the_topic() -> None:
    rig = Rig().ready()
    assert rig.request(SET_FENCE, SetFence(fence=FENCE)).accepted

    def last(kind: type[Health] | type[FenceState]) -> str:
        messages = [output.message if isinstance(output, Publish) else output for output in rig.outputs]
        found = [message for message in messages if isinstance(message, kind)][-1]
        return found.text if isinstance(found, Health) else found.autopilot_failure

    rig.run(2.0)  # it may still reply
    assert "fence is not set" not in last(Health)
    assert last(FenceState) == ""
    rig.run(6.0)
    assert "; the autopilot's own fence is not set: the autopilot doesn't reply" in last(Health)
    assert last(FenceState) == "the autopilot doesn't reply"


def test_a_fence_that_is_taken_away_is_taken_from_the_autopilot_too() -> None:
    rig = Rig().ready()
    counts: list[int] = []
    handle = rig.autopilot.handle
    reader = MavlinkCodec(2, 1)

    def counted(data: bytes) -> bytes:
        counts.extend(
            message.count
            for message in reader.parse(data)
            if message.get_msgId() == dialect.MAVLINK_MSG_ID_MISSION_COUNT
        )
        return handle(data)

    rig.autopilot.handle = counted  # type: ignore[method-assign]
    rig.run(2.0)
    assert counts == []
    assert rig.request(SET_FENCE, SetFence(fence=FENCE)).accepted
    rig.run(1.0)
    assert set(counts) == {4}
    assert rig.request(SET_FENCE, SetFence(fence=None)).accepted
    counts.clear()
    rig.run(1.0)
    assert set(counts) == {0}
