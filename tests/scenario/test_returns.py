"""The vehicle comes home with the battery's reserve: in wind, to a driving or lost rover, and where ways are blocked.

`pytest -s -m slow tests/scenario/test_returns.py` flies 30 seeds and prints a row for each.
"""

from dataclasses import dataclass
from math import cos, radians, sin
from random import Random

import msgspec
import pytest
from msgspec.structs import replace

from jezero.base.config import load_config
from jezero.base.frames import Vec3, horizontal, subtract
from jezero.runtime.memory_bus import MemoryBus
from jezero.schemas import topics
from jezero.schemas.actions import FeedbackMessage
from jezero.schemas.fence import Fence, SetFence, Zone
from jezero.schemas.goals import ReturnFeedback
from jezero.services.actions.config import load_actions_config
from jezero.services.actions.table import action_server
from jezero.services.autopilot.config import AutopilotConfig
from jezero.services.simulator.config import SimulatorConfig, WindConfig
from jezero.trials.stack import RoverDriver, build_stack
from tests.scenario.rig import Flight, go_to

SEEDS = [pytest.param(seed, marks=() if seed < 2 else pytest.mark.slow) for seed in range(30)]
RESERVE = 0.1
WHY_NOT_ABOVE = 0.2
"""A return that doesn't lead to the best place says why while this much of the capacity is left."""
ROVER_INPUTS = (topics.UWB.name, topics.TAG_CORNERS.name, topics.ROVER_ODOMETRY.name)
KINDS = ("head wind", "driving rover", "lost rover", "blocked way", "wind, rover drives away")


@dataclass(frozen=True)
class Case:
    """What is drawn for one seed.

    Attributes:
        kind: one of `KINDS`.
        out_ned_m: where the vehicle flies before the battery becomes low.
        wind_mps: mean wind.
        wind_from_deg: direction from which the wind blows.
        rover_mps: speed of the rover from the takeoff on.
        rover_turn_rps: its yaw rate.
        charge: at the start.
        rally_points_ned_m: north and east.
    """

    kind: str
    out_ned_m: Vec3
    wind_mps: float
    wind_from_deg: float
    rover_mps: float
    rover_turn_rps: float
    charge: float
    rally_points_ned_m: tuple[tuple[float, float], ...]


def case_of(seed: int) -> Case:
    """The flight of a seed."""
    draw, kind = Random(seed), KINDS[seed % len(KINDS)]
    away_m, bearing_deg = draw.uniform(60.0, 140.0), draw.uniform(-180.0, 180.0)
    bearing = radians(bearing_deg)
    windy, drives = "wind" in kind, "drive" in kind or "driving" in kind
    return Case(
        kind=kind,
        out_ned_m=(away_m * cos(bearing), away_m * sin(bearing), -draw.uniform(4.0, 20.0)),
        wind_mps=draw.uniform(5.0, 9.0) if windy else 1.5,
        wind_from_deg=(bearing_deg + 180.0 + draw.uniform(-30.0, 30.0) + 180.0) % 360.0 - 180.0,
        rover_mps=draw.uniform(0.4, 1.5) * (-1.0 if "away" in kind else 1.0) if drives else 0.0,
        rover_turn_rps=draw.uniform(-0.02, 0.02) if drives else 0.0,
        charge=0.14
        + away_m * (0.0007 if windy else 0.0004)
        + draw.uniform(0.0, 0.03)
        + (0.06 if kind == "blocked way" else 0.0),
        rally_points_ned_m=tuple((draw.uniform(-60.0, 60.0), draw.uniform(-60.0, 60.0)) for _ in range(3)),
    )


class ReturnFlight(Flight):
    """A flight whose battery becomes low far from home.

    Attributes:
        driver: of the rover.
        reported: the return's feedback, each with the charge at that time.
    """

    def __init__(self, seed: int, case: Case) -> None:
        self.driver = RoverDriver()
        self.reported: list[tuple[ReturnFeedback, float]] = []
        self._case = case
        super().__init__(seed, self._make)
        self.bus.observe(self._keep)

    def _make(self, seed: int) -> MemoryBus:
        case = self._case
        wind = WindConfig(mean_mps=case.wind_mps, from_deg=case.wind_from_deg, std_gust_mps=0.1 * case.wind_mps)
        simulator = replace(load_config(SimulatorConfig, "simulator"), wind=wind)
        autopilot = replace(load_config(AutopilotConfig, "autopilot"), charge_at_start=case.charge)
        bus = build_stack(seed, simulator=simulator, autopilot=autopilot, without=("return_home",))
        actions = load_actions_config()
        home = replace(actions.return_home, rally_points_ned_m=case.rally_points_ned_m)
        bus.add(action_server("return_home", 1, replace(actions, return_home=home)))
        bus.add(self.driver)
        return bus

    def _keep(self, t_ns: int, topic: str, data: bytes) -> None:
        if topic == topics.feedback_of(topics.RETURN_HOME).name:
            message = msgspec.json.decode(data, type=FeedbackMessage[ReturnFeedback])
            self.reported.append((message.feedback, self.charge))

    @property
    def charge(self) -> float:
        """The charge that the autopilot reports."""
        battery = self.status.battery
        return 0.0 if battery is None or battery.remaining is None else battery.remaining

    def place_ned_m(self) -> Vec3:
        """Where the place that was named last is in truth."""
        place, _ = self.reported[-1]
        return self.truth.pos_rover_ned_m if place.place == "rover" else place.place_ned_m


def lose_the_rover(sender: str, receiver: str, name: str, t_ns: int, data: bytes) -> list[tuple[int, bytes]]:
    """Drop what is known of the rover on its way to the estimator."""
    return [] if name in ROVER_INPUTS and receiver in ("estimator", "tag_detector") else [(t_ns, data)]


def pond_before(out_ned_m: Vec3) -> Zone:
    """A zone across the straight way home, 20 to 30 m before the place."""
    north_m, east_m, _ = out_ned_m
    along = (north_m / horizontal(out_ned_m), east_m / horizontal(out_ned_m))
    across = (-along[1], along[0])
    corners = ((20.0, -25.0), (30.0, -25.0), (30.0, 25.0), (20.0, 25.0))
    return Zone(
        name="pond",
        corners_ned_m=tuple(
            (ahead * along[0] + aside * across[0], ahead * along[1] + aside * across[1]) for ahead, aside in corners
        ),
    )


def way_out(case: Case) -> list[Vec3]:
    """The corners of the way to where the battery becomes low; it leads around the pond."""
    north_m, east_m, down_m = case.out_ned_m
    if case.kind != "blocked way":
        return [case.out_ned_m]
    away_m = horizontal(case.out_ned_m)
    aside = (-40.0 * east_m / away_m, 40.0 * north_m / away_m)
    return [(aside[0], aside[1], down_m), (north_m + aside[0], east_m + aside[1], down_m), case.out_ned_m]


@pytest.mark.long
@pytest.mark.parametrize("seed", SEEDS)
def test_a_return_lands_at_the_place_that_it_named_with_the_reserve_or_says_early_why_not(seed: int) -> None:
    case = case_of(seed)
    flight = ReturnFlight(seed, case)
    flight.wait_ready()
    if case.kind == "blocked way":
        assert flight.request(topics.SET_FENCE, SetFence(fence=Fence(keep_out=(pond_before(case.out_ned_m),)))).accepted
    flight.take_off(3.0)
    if case.rover_mps:
        flight.driver.speed_mps, flight.driver.yaw_rate_rps = case.rover_mps, case.rover_turn_rps
    if case.kind == "lost rover":
        flight.bus.tamper = lose_the_rover
    for corner_ned_m in way_out(case):
        request = flight.send(topics.GO_TO, go_to(*corner_ned_m, speed_mps=5.0))
        if flight.finish(request, 240.0).outcome != "succeeded":
            break
    flight.wait(lambda: flight.status.action == "return_home", 400.0, "the return")
    started = flight.charge
    flight.wait(lambda: not flight.status.armed, 300.0, "the landing")
    place, _ = flight.reported[-1]
    away_m = horizontal(subtract(flight.truth.pos_uav_ned_m, flight.place_ned_m()))
    why_not = max((charge for feedback, charge in flight.reported if feedback.place == place.place), default=0.0)
    print(
        f"\nseed {seed}, {case.kind}: from {horizontal(case.out_ned_m):.0f} m with {started:.0%}, wind "
        f"{case.wind_mps:.0f} m/s, rover {case.rover_mps:.1f} m/s: {place.place}, {away_m:.2f} m off, "
        f"{flight.charge:.1%} left; {place.reason}"
    )
    assert away_m < (0.5 if place.place == "rover" else 2.0)
    assert flight.charge >= RESERVE or why_not >= WHY_NOT_ABOVE
