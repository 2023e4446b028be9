"""A landing's selection of sensors: leased, renewed, requested again from a new estimator, and released."""

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import msgspec
from msgspec.structs import replace

from jezero.base.frames import Vec3, subtract
from jezero.runtime.memory_bus import MemoryBus, SentRequest
from jezero.runtime.node import Mailbox
from jezero.runtime.service import Call, Inbox, Output, Publish, Reply, Response, Spec
from jezero.schemas import topics
from jezero.schemas.actions import Cancel, Result
from jezero.schemas.commands import Setpoint
from jezero.schemas.estimate import Lease, LeaseReply, Relative
from jezero.schemas.goals import LandOnSpotGoal
from jezero.schemas.rows import Endpoint
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.lifecycle.leases import SelectionLease
from jezero.services.actions.motion.behaviour import Selection
from jezero.services.actions.table import action_server
from tests.services.actions.fake_bridge import FakeBridge
from tests.services.actions.lifecycle.test_vehicle_view import relative_estimate

ROVER_NED_M: Vec3 = (3.0, 0.0, 0.0)
LAND = LandOnSpotGoal(goal_id="g")


class FakeEstimator:
    """Publishes valid estimates of the rover, and stores the leases that are requested.

    Args:
        serves: endpoints that it serves.
        selects: its estimates say so.

    Attributes:
        goal_id: goal to whose selection its estimates belong; None: that of the newest lease.
        refuse: reason with which every lease is refused, when not empty.
    """

    def __init__(self, bridge: FakeBridge, serves: tuple[Endpoint[Any, Any], ...], *, selects: bool) -> None:
        self.spec = Spec(
            name="estimator",
            inputs=(topics.ODOMETRY,),
            outputs=(topics.RELATIVE,),
            serves=serves,
            triggers=(topics.ODOMETRY.name, *(endpoint.name for endpoint in serves)),
        )
        self.selects = selects
        self.leases: list[tuple[int, Lease]] = []
        self.goal_id: str | None = None
        self.refuse = ""
        self._bridge = bridge

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        for request in inbox.requests(topics.LEASE) if self.spec.serves else ():
            self.leases.append((t_ns, request.payload))
            yield Reply(request.request_id, LeaseReply(accepted=not self.refuse, reason=self.refuse))
        for odometry in inbox.new(topics.ODOMETRY):
            last = self.leases[-1][1].goal_id if self.leases else ""
            yield Publish(
                topics.RELATIVE,
                Relative(
                    t_ns=odometry.t_ns,
                    epoch_id=odometry.epoch_id,
                    valid=True,
                    pos_uav_rel_rover_ned_m=subtract(odometry.pos_uav_ned_m, ROVER_NED_M),
                    vel_uav_rel_rover_ned_mps=odometry.vel_uav_ned_mps,
                    cov=(0.0,) * 21,
                    vel_rover_ned_mps=(0.0, 0.0, 0.0),
                    yaw_rover_rad=0.0,
                    yaw_rate_rover_rps=0.0,
                    use_uwb=True,
                    use_tag=True,
                    fused_t_ns=odometry.t_ns,
                    goal_id=last if self.goal_id is None else self.goal_id,
                    selects=self.selects,
                ),
            )


class World:
    """A bus with a hovering vehicle, an estimator and the landing's server."""

    def __init__(self, serves: tuple[Endpoint[Any, Any], ...] = (topics.LEASE,), *, selects: bool = True) -> None:
        self.bus = MemoryBus(seed=1)
        self.bridge = FakeBridge((0.0, 0.0, -4.0))
        self.estimator = FakeEstimator(self.bridge, serves, selects=selects)
        self.setpoints: list[Setpoint] = []
        self.bus.add(self.bridge)
        self.bus.add(self.estimator)
        self.bus.add(action_server("land_on_spot", 5, ActionsConfig()))
        self.bus.observe(self._observe)
        self.bus.run_for(0.5)

    def _observe(self, t_ns: int, topic: str, data: bytes) -> None:
        if topic == topics.SETPOINT.name:
            self.setpoints.append(msgspec.json.decode(data, type=Setpoint))

    def land(self, goal: LandOnSpotGoal = LAND) -> SentRequest:
        return self.bus.send_request(topics.LAND_ON_SPOT.endpoint, goal)

    def end(self, answers: SentRequest) -> Result[object]:
        assert self.bus.run_for(60.0, lambda: answers.ended), answers.replies[-2:]
        assert isinstance(answers.replies[-1], Result)
        self.bus.run_for(0.5)
        return answers.replies[-1]


def test_a_landing_leases_its_selection_once_a_second_and_gives_it_back() -> None:
    world = World()
    result = world.end(world.land())
    assert result.outcome == "succeeded"
    times_ns = [t_ns for t_ns, lease in world.estimator.leases if not lease.release]
    assert len(times_ns) > 5
    assert all(0.95e9 < b - a < 1.1e9 for a, b in pairwise(times_ns))
    assert {(lease.goal_id, lease.use_uwb, lease.use_tag) for _, lease in world.estimator.leases} == {("g", True, True)}
    assert [lease.release for _, lease in world.estimator.leases].count(True) == 1
    assert world.estimator.leases[-1][1].release


def test_a_canceled_landing_gives_it_back_too() -> None:
    world = World()
    answers = world.land()
    world.bus.run_for(2.0)
    world.bus.send_request(topics.LAND_ON_SPOT.cancel, Cancel(goal_id="g"))
    assert world.end(answers).outcome == "canceled"
    assert world.estimator.leases[-1][1].release


def test_the_rough_position_moves_with_the_autopilots() -> None:
    world = World()
    answers = world.land(LandOnSpotGoal(goal_id="g", use_uwb=False, landing_spot_ned_m=(2.0, 1.0, 0.0)))
    world.bus.run_for(0.5)
    world.bridge.step_position((10.0, 0.0, 0.0))
    world.bus.run_for(1.2)
    assert world.estimator.leases[0][1].pos_rover_ned_m == (2.0, 1.0, 0.0)
    assert world.estimator.leases[-1][1].pos_rover_ned_m == (12.0, 1.0, 0.0)
    world.bus.send_request(topics.LAND_ON_SPOT.cancel, Cancel(goal_id="g"))
    world.end(answers)


def test_nothing_descends_by_an_estimate_of_somebody_elses_selection() -> None:
    world = World()
    world.estimator.goal_id = "another"
    result = world.end(world.land())
    assert result.outcome == "aborted"
    assert result.reason.endswith("the estimator doesn't use this goal's selection yet")
    assert all(setpoint.pos_ned_m == (0.0, 0.0, -4.0) for setpoint in world.setpoints)


def test_a_refused_lease_is_told_and_asked_for_again() -> None:
    world = World()
    world.estimator.goal_id, world.estimator.refuse = "", "another goal holds it"
    result = world.end(world.land())
    assert result.outcome == "aborted"
    assert result.reason.endswith("the estimator refused the selection: another goal holds it")
    assert len(world.estimator.leases) > 10


def test_an_estimator_that_does_not_select_needs_no_lease() -> None:
    world = World(serves=(), selects=False)
    assert world.end(world.land()).outcome == "succeeded"


def test_an_estimator_that_does_not_select_is_not_asked_for_a_lease() -> None:
    world = World(selects=False)
    assert world.end(world.land()).outcome == "succeeded"
    renewals = [lease for _, lease in world.estimator.leases if not lease.release]
    assert len(renewals) <= 1  # the first one goes out before the first estimate has come


def test_an_estimator_that_selects_and_serves_no_lease_is_told_what_to_publish() -> None:
    world = World(serves=())
    result = world.end(world.land())
    assert result.outcome == "aborted"
    assert "did not lease the landing's selection of sensors" in result.reason
    assert "an estimator with fixed inputs publishes `selects` = false" in result.reason


# -- step by step --

MS = 1_000_000
SELECTION = Selection(use_uwb=True, use_tag=False, pos_rover_ned_m=(1.0, 2.0, 0.0))


class Steps:
    """A lease whose estimator is played by the test."""

    def __init__(self, selection: Selection = SELECTION) -> None:
        self.lease = SelectionLease("g", selection)
        self.inbox = Mailbox(())

    def renew(self, at_ms: int, shift_ned_m: Vec3 = (0.0, 0.0, 0.0)) -> Call | None:
        """The call to the estimator at a time, if there is one."""
        outputs = list(self.lease.renew(at_ms * MS, self.inbox, shift_ned_m))
        self.inbox.clear()
        assert all(isinstance(output, Call) for output in outputs) and len(outputs) < 2
        return outputs[0] if outputs else None  # type: ignore[return-value]

    def respond(self, call: Call | None, reply: LeaseReply | None, error: str | None = None) -> None:
        assert call is not None
        self.inbox.responses.append(Response(call.tag, reply, error))

    def reason(self) -> str:
        """Why the goal may not use an estimate of the estimator's own selection; "" when it may use it."""
        checked = self.lease.checked(replace(relative_estimate(), goal_id="", selects=True))
        assert (checked.valid, checked.fused_t_ns) == (False, 0)
        return checked.reason


ACCEPTED, REFUSED = LeaseReply(accepted=True), LeaseReply(accepted=False, reason="another goal holds it")


def test_a_lease_is_renewed_once_a_second_and_soon_after_a_refusal() -> None:
    steps = Steps()
    call = steps.renew(0)
    steps.respond(call, ACCEPTED)
    assert [steps.renew(at_ms) for at_ms in (10, 500, 990)] == [None] * 3
    call = steps.renew(1000)
    steps.respond(call, REFUSED)
    assert [steps.renew(at_ms) for at_ms in (1010, 1150)] == [None] * 2
    call = steps.renew(1250)
    steps.respond(call, ACCEPTED)
    assert [steps.renew(at_ms) for at_ms in (1260, 1500, 2200)] == [None] * 3
    call = steps.renew(2260)
    assert steps.renew(3200) is None
    steps.respond(call, REFUSED)
    assert steps.renew(3210) is None, "the refusal comes late"
    assert steps.renew(3270) is not None, "and puts the next call off by nothing"


def test_a_lease_asks_for_the_goals_selection_at_the_rovers_position_in_the_present_frame() -> None:
    call = Steps().renew(0, (0.5, 0.0, 0.1))
    assert call is not None
    assert call.payload == Lease(goal_id="g", use_uwb=True, use_tag=False, pos_rover_ned_m=(1.5, 2.0, 0.1))
    call = Steps(replace(SELECTION, pos_rover_ned_m=None)).renew(0, (0.5, 0.0, 0.1))
    assert call is not None
    assert call.payload == Lease(goal_id="g", use_uwb=True, use_tag=False)


def test_until_its_lease_is_accepted_a_goal_knows_why_it_may_not_use_the_estimate() -> None:
    steps = Steps()
    assert steps.reason() == "the estimator has not replied yet"
    call = steps.renew(0)
    assert call is not None and call.timeout_s < 1.1, "before the next call"
    steps.respond(call, None, "timeout")
    steps.renew(1000)
    assert "did not lease the landing's selection of sensors: timeout" in steps.reason()
    steps.respond(call, ACCEPTED)
    second = steps.renew(1100)
    assert "timeout" in steps.reason(), "the first call's reply doesn't count any more"
    assert second is None
    call = steps.renew(2200)
    steps.respond(call, REFUSED)
    steps.renew(2210)
    assert steps.reason() == "the estimator refused the selection: another goal holds it"
    call = steps.renew(2500)
    steps.respond(call, ACCEPTED)
    steps.renew(2510)
    assert steps.reason() == "the estimator doesn't use this goal's selection yet"


def test_an_estimate_of_the_goals_selection_or_of_an_estimator_that_does_not_select_is_used_as_it_is() -> None:
    lease = SelectionLease("g", SELECTION)
    for estimate in (
        replace(relative_estimate(), goal_id="g", selects=True),
        replace(relative_estimate(), goal_id="", selects=False),
    ):
        assert lease.checked(estimate) == estimate


def test_only_a_lease_that_was_asked_for_is_ended() -> None:
    steps = Steps()
    assert list(steps.lease.end(0)) == []
    steps.renew(0)
    (end,) = steps.lease.end(5 * MS)
    assert isinstance(end, Call)
    assert end.payload == Lease(goal_id="g", use_uwb=True, use_tag=False, release=True)
