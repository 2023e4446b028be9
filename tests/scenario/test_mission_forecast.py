"""What `jezero mission check` forecasts is what is flown: time, length and battery.

`pytest -s -m "" tests/scenario/test_mission_forecast.py` flies ten missions in calm air and in a wind of 5 m/s, and
prints a row for each.
"""

from itertools import pairwise
from typing import Any

import pytest
from msgspec.structs import replace

from jezero.base.config import load_config
from jezero.base.frames import distance
from jezero.base.plugins import all_actions
from jezero.base.vehicle_config import VehicleConfig
from jezero.mission_files import plan_mission, shipped_mission
from jezero.mission_files.planning import Start
from jezero.runtime.memory_bus import MemoryBus
from jezero.schemas import topics
from jezero.schemas.mission import GoalStep, Mission, WaitStep
from jezero.services.simulator.camera.config import CameraConfig
from jezero.services.simulator.config import SimulatorConfig, WindConfig
from jezero.trials.planning import VirtualPlanner
from jezero.trials.stack import BlankCamera, build_stack
from tests.scenario.mission_rig import MissionFlight

WIND_MPS = 5.0
SHARE_MAX = 0.1
"""Greatest difference of what is flown from the forecast."""


def step(action: str, **goal: Any) -> GoalStep:
    return GoalStep(label=action, action=action, goal=goal)


def go(north_m: float, east_m: float, down_m: float, **goal: Any) -> GoalStep:
    return step("go_to", target_ned_m=[north_m, east_m, down_m], **goal)


def takeoff(altitude_m: float) -> GoalStep:
    return step("takeoff", altitude_m=altitude_m)


LAND = step("land_on_spot")
FIELD = [[0.0, 0.0], [30.0, 0.0], [30.0, 20.0], [0.0, 20.0]]
MISSIONS: dict[str, tuple[Any, ...]] = {
    "demonstration": shipped_mission("demonstration").steps,
    "patrol": shipped_mission("patrol").steps,
    "guard": (takeoff(6.0), WaitStep(label="wait", duration_s=90.0), LAND),
    "there and back": (takeoff(10.0), go(150.0, 0.0, -10.0, speed_mps=5.0), step("return_home")),
    "across the wind": (takeoff(8.0), go(0.0, 120.0, -8.0, speed_mps=4.0), go(0.0, 0.0, -8.0), LAND),
    "square": (takeoff(5.0), go(40, 0, -5), go(40, 40, -5), go(0, 40, -5), go(0, 0, -5), LAND),
    "high": (takeoff(5.0), go(10.0, 0.0, -60.0), go(0.0, 0.0, -5.0), LAND),
    "orbits": (
        takeoff(4.0),
        step("get_images", center_ned_m=[10.0, 0.0, -4.0], radius_m=8.0, num_images=12),
        step("get_images", center_ned_m=[10.0, 0.0, -6.0], radius_m=4.0, num_images=6),
        LAND,
    ),
    "survey": (takeoff(5.0), step("area_coverage", polygon_ned_m=FIELD, z_ned_m=-8.0, overlap=0.6), LAND),
    "two flights": (takeoff(4.0), go(20.0, 5.0, -4.0), LAND, takeoff(4.0), go(-20.0, 5.0, -4.0), LAND),
}
CASES = [
    pytest.param(name, wind_mps, marks=() if (name, wind_mps) in (("square", 5.0),) else pytest.mark.slow)
    for wind_mps in (0.0, WIND_MPS)
    for name in MISSIONS
]


class WindyFlight(MissionFlight):
    """A stack whose mission service flies a mission in a wind from the north."""

    def __init__(self, wind_mps: float) -> None:
        self._wind_mps = wind_mps
        super().__init__()

    def _make(self, seed: int) -> MemoryBus:
        wind = WindConfig(mean_mps=self._wind_mps, from_deg=0.0, std_gust_mps=0.1 * self._wind_mps)
        simulator = replace(load_config(SimulatorConfig, "simulator"), wind=wind)
        bus = build_stack(seed, simulator=simulator, vehicle=self._vehicle, without=("mission",))
        bus.add(BlankCamera(load_config(CameraConfig, "camera"), self._vehicle.camera, publishes_info=False))
        bus.add(self.service(1))
        return bus

    @property
    def charge(self) -> float:
        battery = self.status.battery
        assert battery is not None and battery.remaining is not None
        return battery.remaining


@pytest.fixture(scope="module")
def planner() -> VirtualPlanner:
    return VirtualPlanner()


@pytest.mark.long
@pytest.mark.parametrize(("name", "wind_mps"), CASES)
def test_time_length_and_battery_of_a_mission_are_forecast(name: str, wind_mps: float, planner: VirtualPlanner) -> None:
    mission = Mission(name="test", steps=MISSIONS[name])
    start = Start(wind_ned_mps=(-wind_mps, 0.0, 0.0), vehicle=load_config(VehicleConfig, "vehicle"))
    plans = list(plan_mission(mission, all_actions(), planner.plan, start))
    assert not any(plan.problem for plan in plans)
    flight = WindyFlight(wind_mps)
    flight.wait_ready()
    began_ns, charge = flight.bus.t_ns, flight.charge
    assert flight.request(topics.RUN_MISSION, mission).accepted
    flight.wait_state("succeeded", 900.0)
    ended_ns = flight.bus.t_ns
    path = [truth.pos_uav_ned_m for truth in flight.truths if began_ns <= truth.t_ns <= ended_ns]
    flown = (
        (ended_ns - began_ns) * 1e-9,
        sum(distance(begin, end) for begin, end in pairwise(path[::25])),
        charge - flight.charge,
    )
    forecast = (
        sum(plan.duration_s or 0.0 for plan in plans),
        sum(plan.reply.distance_m or 0.0 for plan in plans if plan.reply is not None),
        sum(plan.charge_used or 0.0 for plan in plans),
    )
    print(
        f"\n{name}, wind {wind_mps:.0f} m/s: forecast {forecast[0]:.0f} s, {forecast[1]:.0f} m, {forecast[2]:.1%}; "
        f"flown {flown[0]:.0f} s, {flown[1]:.0f} m, {flown[2]:.1%}"
    )
    for forecast_value, flown_value, least in zip(forecast, flown, (3.0, 3.0, 0.01), strict=True):
        assert abs(forecast_value - flown_value) <= max(SHARE_MAX * flown_value, least)
