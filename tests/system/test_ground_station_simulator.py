"""The panel of the simulator on the ground station's page: each of its controls changes the world."""

from collections.abc import Callable, Iterator

import pytest

pytest.importorskip("nicegui", reason="the extra jezero[ground] is not installed")
pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

from playwright.sync_api import expect

from jezero.schemas.simulator import SimulatorState
from tests.system.conftest import wait_for
from tests.system.ground_screen import FLIES_A_STACK, Screen, stack_with_screen

pytestmark = FLIES_A_STACK


@pytest.fixture(scope="module")
def screen(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Screen]:
    """The page of a stack that is ready."""
    with stack_with_screen(tmp_path_factory.mktemp("ground")) as shown:
        yield shown


def test_each_control_of_the_panel_changes_the_world(screen: Screen) -> None:
    expect(screen.marked("simulator")).to_be_visible()
    with screen.stack.connect() as uav:

        def becomes(what: str, is_so: Callable[[SimulatorState], bool]) -> SimulatorState:
            wait_for(lambda: is_so(uav.simulator.state()), 30.0, what)
            return uav.simulator.state()

        def choose(mark: str, option: str) -> None:
            screen.marked(mark).click()
            screen.page.get_by_role("option", name=option, exact=True).click()

        screen.marked("sim-pause").click()
        paused = becomes("paused", lambda state: state.paused)
        screen.has("sim-pause", "Resume")
        screen.has("sim-time", "paused")
        screen.marked("sim-step").click()
        becomes("stepped", lambda state: state.t_ns - paused.t_ns == 1_000_000_000)
        screen.marked("sim-pause").click()
        becomes("resumed", lambda state: not state.paused)
        choose("sim-speed", "0.5 x")
        becomes("half as fast", lambda state: state.speed == 0.5)
        choose("sim-speed", "1 x")
        becomes("as fast as real time", lambda state: state.speed == 1.0)

        screen.type_in(sim__wind="4", sim__wind__from="120", sim__gusts="0.7")
        screen.marked("sim-blow").click()
        state = becomes("wind", lambda state: state.wind_mean_mps == 4.0)
        assert (state.wind_from_deg, state.std_gust_mps) == (120.0, 0.7)

        screen.type_in(sim__north="2", sim__east="-5")
        screen.marked("sim-put").click()
        becomes("the rover elsewhere", lambda state: abs(state.pos_rover_ned_m[0] - 2.0) < 0.1)
        choose("sim-what", "vehicle")
        screen.type_in(sim__north="2", sim__east="-5")
        screen.marked("sim-put").click()
        screen.tells("the rover is there")

        choose("sim-unit", "uwb")
        choose("sim-kind", "stuck")
        screen.marked("sim-fail").click()
        becomes("a fault", lambda state: [(each.unit, each.kind) for each in state.faults] == [("uwb", "stuck")])
        screen.has("sim-faults", "uwb stuck")
        screen.marked("sim-end-uwb").click()
        becomes("no fault", lambda state: not state.faults)

        screen.marked("sim-reset").click()
        becomes("the start", lambda state: abs(state.pos_rover_ned_m[0] - 5.0) < 0.2 and state.wind_mean_mps == 1.5)
    assert screen.errors == []
