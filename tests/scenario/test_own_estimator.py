"""The estimator of docs/how-to/write-an-estimator.md, as it stands there, in place of jezero's."""

import re
from pathlib import Path
from types import ModuleType

from jezero.runtime.memory_bus import MemoryBus
from jezero.schemas import topics
from jezero.schemas.goals import GoToGoal, LandOnSpotGoal
from jezero.trials.platform import off_platform_reason
from jezero.trials.stack import build_stack
from tests.scenario.rig import Flight

PAGE = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "write-an-estimator.md"


def program() -> str:
    """The program on the page."""
    (code,) = re.findall(r'```python title="my_estimator.py"\n(.*?)```', PAGE.read_text(), re.DOTALL)
    return str(code)


def stack_with_own_estimator(seed: int) -> MemoryBus:
    module = ModuleType("my_estimator")
    exec(compile(program(), "my_estimator.py", "exec"), module.__dict__)
    bus = build_stack(seed, without=("estimator", "tag_detector"))
    bus.add(module.MyEstimator())
    return bus


def test_the_estimator_of_the_page_lands_on_the_rover_without_leasing_anything() -> None:
    flight = Flight(3, stack_with_own_estimator)
    flight.take_off()
    flight.do(topics.GO_TO, GoToGoal(target_ned_m=(1.0, 2.0, -4.0)))
    flight.do(topics.GO_TO, GoToGoal(target_ned_m=(1.0, 0.0, -3.0), frame="rover"))
    result = flight.finish(flight.send(topics.LAND_ON_SPOT, LandOnSpotGoal()))
    assert result.outcome == "succeeded", result.reason
    assert not flight.status.armed
    assert off_platform_reason(flight.truth, 0.5) == ""
