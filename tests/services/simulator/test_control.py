"""Requests that change the simulated world, as the runtime brings them."""

from typing import Any

import pytest

from jezero.base.frames import distance
from jezero.runtime.service import Output, Publish, Reconnect, Reply, Request, SetPace
from jezero.schemas import topics
from jezero.schemas.rows import Endpoint
from jezero.schemas.simulator import (
    Change,
    ControlSimulator,
    PauseWorld,
    PlaceBody,
    ResetWorld,
    ResumeWorld,
    SetFault,
    SetSpeed,
    SetWind,
    SimulatorReply,
    StepWorld,
)
from jezero.services.simulator.config import RoverConfig, SimulatorConfig, UavConfig, WindConfig
from jezero.services.simulator.service import HIL
from tests.services.simulator.test_service import STEP_NS, Bench, published

CALM = WindConfig(mean_mps=0.0, std_gust_mps=0.0)
THRUST = 0.75
"""Command of all motors with which the vehicle climbs."""


class ControlBench(Bench):
    """A bench that sends requests, and stands still as the runtime does."""

    def __init__(self, config: SimulatorConfig) -> None:
        super().__init__(config)
        self.asked: list[Request] = []
        self.pace = 1.0
        self._number = 0

    def requests(self, endpoint: Endpoint[Any, Any]) -> tuple[Request, ...]:
        if endpoint is not topics.CONTROL_SIMULATOR:
            return ()
        asked, self.asked = tuple(self.asked), []
        return asked

    def run(self, steps: int) -> list[Output]:
        inbox: Any = self
        outputs: list[Output] = []
        for _ in range(steps):
            stands = self.pace == 0.0
            outputs.extend(self.simulator.step(self.t_ns, inbox))
            self.pace = next((o.pace for o in reversed(outputs) if isinstance(o, SetPace)), self.pace)
            self.t_ns += 0 if stands else STEP_NS
            self.wall_ns += 5 * STEP_NS if stands else STEP_NS
        return outputs

    def ask(self, change: Change | None) -> tuple[SimulatorReply, list[Output]]:
        """Send a request, and step until its reply comes."""
        self._number += 1
        self.asked.append(Request(self._number, "client", ControlSimulator(do=change)))
        outputs: list[Output] = []
        for _ in range(1000):
            outputs += self.run(1)
            for output in outputs:
                if isinstance(output, Reply) and output.request_id == self._number:
                    assert isinstance(output.payload, SimulatorReply)
                    return output.payload, outputs
        raise AssertionError("no reply")

    def does(self, change: Change | None) -> Any:
        """State of the world after a change that is accepted."""
        reply, _ = self.ask(change)
        assert reply.accepted, reply.reason
        return reply.state

    def refuses(self, change: Change) -> str:
        """Reason of a refusal."""
        reply, _ = self.ask(change)
        assert not reply.accepted
        return reply.reason

    def climb(self) -> None:
        """Climb for two seconds with all motors."""
        self.command = THRUST
        self.run(500)


@pytest.fixture
def bench() -> ControlBench:
    bench = ControlBench(SimulatorConfig(wind=CALM, rover=RoverConfig(start_yaw_rad=0.0)))
    bench.run(10)
    return bench


def test_a_request_without_a_change_gets_the_state(bench: ControlBench) -> None:
    state = bench.does(None)
    assert state.pos_uav_ned_m == pytest.approx((0.0, 0.0, 0.0), abs=0.01)
    assert state.pos_rover_ned_m[:2] == pytest.approx((5.0, -3.0), abs=0.01)
    assert (state.paused, state.speed, state.motors, state.faults) == (False, 1.0, False, ())
    assert state.height_uav_m == pytest.approx(0.0, abs=0.01)


def test_wind_blows_as_asked_and_carries_a_flying_vehicle(bench: ControlBench) -> None:
    state = bench.does(SetWind(mean_mps=6.0, from_deg=90.0))
    assert state.wind_ned_mps == pytest.approx((0.0, -6.0, 0.0), abs=1e-9)
    assert state.std_gust_mps == 0.0
    gusty = bench.does(SetWind(mean_mps=6.0, from_deg=90.0, std_gust_mps=1.0))
    bench.run(100)
    assert bench.does(None).wind_ned_mps != pytest.approx(gusty.wind_ned_mps, abs=1e-6)
    bench.climb()
    assert bench.does(None).vel_uav_ned_mps[1] < -0.1


def test_a_standing_vehicle_is_put_on_the_ground_elsewhere(bench: ControlBench) -> None:
    state = bench.does(PlaceBody(north_m=-4.0, east_m=7.0, yaw_rad=1.5))
    assert state.pos_uav_ned_m[:2] == pytest.approx((-4.0, 7.0), abs=0.05)
    assert state.yaw_uav_rad == pytest.approx(1.5, abs=0.02)
    bench.run(250)
    later = bench.does(None)
    assert distance(later.pos_uav_ned_m, state.pos_uav_ned_m) < 0.05
    assert later.height_uav_m == pytest.approx(0.0, abs=0.05)


def test_a_flying_vehicle_is_put_into_the_air_at_rest(bench: ControlBench) -> None:
    bench.climb()
    state = bench.does(PlaceBody(north_m=10.0, east_m=10.0, height_m=8.0))
    assert state.height_uav_m == pytest.approx(8.0, abs=0.05)
    assert state.vel_uav_ned_mps == pytest.approx((0.0, 0.0, 0.0), abs=0.1)


def test_the_rover_is_put_elsewhere_with_its_platform(bench: ControlBench) -> None:
    state = bench.does(PlaceBody(what="rover", north_m=-6.0, east_m=2.0, yaw_rad=-1.0))
    assert state.pos_rover_ned_m[:2] == pytest.approx((-6.0, 2.0), abs=0.05)
    assert state.yaw_rover_rad == pytest.approx(-1.0)
    (truth,) = published(bench.run(5), topics.TRUTH)[-1:]
    assert truth.pos_rover_ned_m[:2] == pytest.approx((-6.0, 2.0), abs=0.05)


@pytest.mark.parametrize(
    ("place", "said"),
    [
        (PlaceBody(north_m=1.0, east_m=0.0, height_m=3.0), "would fall 3 m"),
        (PlaceBody(north_m=5.0, east_m=-3.0), "the rover is there"),
        (PlaceBody(what="rover", north_m=0.5, east_m=0.0), "the vehicle is there"),
        (PlaceBody(what="rover", north_m=9.0, east_m=0.0, height_m=1.0), "stands on the ground"),
    ],
)
def test_an_absurd_place_is_refused_with_the_reason(bench: ControlBench, place: PlaceBody, said: str) -> None:
    before = bench.does(None)
    assert said in bench.refuses(place)
    after = bench.does(None)
    assert after.pos_uav_ned_m == pytest.approx(before.pos_uav_ned_m, abs=1e-3)
    assert after.pos_rover_ned_m == before.pos_rover_ned_m


def test_a_flying_vehicle_is_not_put_on_the_ground(bench: ControlBench) -> None:
    bench.climb()
    assert "land first" in bench.refuses(PlaceBody(north_m=1.0, east_m=1.0))


def test_running_motors_on_the_ground_keep_the_vehicle_there(bench: ControlBench) -> None:
    bench.command = 0.05
    bench.run(50)
    assert "take off first, or disarm" in bench.refuses(PlaceBody(north_m=1.0, east_m=1.0, height_m=3.0))


def test_the_rover_stays_below_a_vehicle_that_stands_on_it() -> None:
    bench = ControlBench(SimulatorConfig(wind=CALM, uav=UavConfig(start="platform")))
    bench.run(10)
    assert "stands on the rover" in bench.refuses(PlaceBody(what="rover", north_m=9.0, east_m=9.0))


def test_a_reset_puts_everything_back_and_closes_the_link_of_the_autopilot(bench: ControlBench) -> None:
    epoch = bench.does(None).epoch_id
    bench.does(SetWind(mean_mps=6.0, from_deg=90.0))
    bench.does(SetFault(unit="gps", kind="off"))
    bench.does(PlaceBody(what="rover", north_m=-6.0, east_m=2.0))
    bench.climb()
    reply, outputs = bench.ask(ResetWorld())
    assert Reconnect(HIL) in outputs
    assert reply.accepted
    bench.command = None
    bench.up = False
    bench.run(5)
    bench.up, bench.count = True, bench.count + 1
    bench.run(5)
    state = bench.does(None)
    assert state.epoch_id == epoch + 1
    assert state.pos_uav_ned_m == pytest.approx((0.0, 0.0, 0.0), abs=0.02)
    assert state.pos_rover_ned_m[:2] == pytest.approx((5.0, -3.0), abs=0.01)
    assert state.wind_mean_mps == 0.0
    assert state.faults == ()


def test_paused_nothing_moves_and_the_clock_says_so(bench: ControlBench) -> None:
    bench.climb()
    state = bench.does(PauseWorld())
    assert state.paused
    outputs = bench.run(100)
    clocks = published(outputs, topics.CLOCK)
    assert {(clock.t_ns, clock.pace) for clock in clocks} == {(state.t_ns, 0.0)}
    assert 15 <= len(clocks) <= 21  # ten a second, in 2 s of real time
    assert not published(outputs, topics.IMU)
    assert bench.does(None).pos_uav_ned_m == state.pos_uav_ned_m


def test_after_a_pause_time_goes_on_where_it_stood(bench: ControlBench) -> None:
    bench.climb()
    before = bench.does(PauseWorld())
    t_ns = bench.t_ns
    bench.run(20)
    reply, outputs = bench.ask(ResumeWorld())
    assert SetPace(1.0) in outputs
    assert published(outputs, topics.CLOCK)[-1].pace == 1.0
    (imu,) = published(bench.run(6), topics.IMU)[:1]
    assert t_ns <= imu.t_ns <= t_ns + 5 * STEP_NS
    assert reply.state is not None
    assert distance(reply.state.pos_uav_ned_m, before.pos_uav_ned_m) < 0.05


def test_a_step_lasts_as_long_as_asked_and_pauses_again(bench: ControlBench) -> None:
    bench.does(PauseWorld())
    t_ns = bench.does(None).t_ns
    state = bench.does(StepWorld(duration_s=0.4))
    assert state.paused
    assert state.t_ns == t_ns + 400_000_000
    assert bench.pace == 0.0


def test_a_step_needs_a_pause(bench: ControlBench) -> None:
    assert "jezero sim pause" in bench.refuses(StepWorld(duration_s=1.0))


def test_a_step_that_is_paused_early_gets_its_reply(bench: ControlBench) -> None:
    bench.does(PauseWorld())
    bench.asked.append(Request(900, "client", ControlSimulator(do=StepWorld(duration_s=5.0))))
    bench.run(10)
    _, outputs = bench.ask(PauseWorld())
    assert any(isinstance(o, Reply) and o.request_id == 900 for o in outputs)


def test_the_speed_goes_to_the_runtime_and_the_clock(bench: ControlBench) -> None:
    _, outputs = bench.ask(SetSpeed(speed=0.25))
    assert SetPace(0.25) in outputs
    assert published(outputs, topics.CLOCK)[-1].pace == 0.25


def test_a_paused_simulator_keeps_a_new_speed_until_it_goes_on(bench: ControlBench) -> None:
    bench.does(PauseWorld())
    _, outputs = bench.ask(SetSpeed(speed=2.0))
    assert not [o for o in outputs if isinstance(o, SetPace)]
    _, outputs = bench.ask(ResumeWorld())
    assert SetPace(2.0) in outputs


def test_the_speed_that_is_reached_is_measured(bench: ControlBench) -> None:
    bench.run(300)
    assert bench.does(None).speed_reached == pytest.approx(1.0, abs=0.01)


def test_only_changes_are_replied_to_once(bench: ControlBench) -> None:
    _, outputs = bench.ask(SetWind(mean_mps=1.0, from_deg=0.0))
    outputs += bench.run(20)
    assert len([o for o in outputs if isinstance(o, Reply)]) == 1
    assert [o for o in outputs if isinstance(o, Publish)]
