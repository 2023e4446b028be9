"""The ground station's page while parts of the stack are restarted, the ground station itself too."""

import json
import os
import re
import signal
from collections.abc import Iterator
from contextlib import suppress

import pytest

pytest.importorskip("nicegui", reason="the extra jezero[ground] is not installed")
pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

from playwright.sync_api import expect

from tests.system.conftest import in_the_air, wait_for, wait_for_status
from tests.system.ground_screen import FLIES_A_STACK, FLIGHT_TIMEOUT_MS, Screen, stack_with_screen

SERVICES = ("vehicle_bridge", "router")

pytestmark = FLIES_A_STACK


@pytest.fixture(scope="module")
def screen(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Screen]:
    """The page of a stack that is ready."""
    with stack_with_screen(tmp_path_factory.mktemp("ground")) as shown:
        yield shown


def test_values_of_a_bridge_that_stands_still_turn_grey_with_their_age_and_then_are_dashes(screen: Screen) -> None:
    north = screen.page.locator(".readings .reading", has_text="north")
    value, age = north.locator(".reading-value"), north.locator(".reading-age")
    expect(value).to_have_text(re.compile(r"-?\d+\.\d\dm"))
    expect(north).not_to_have_class(re.compile("late"))
    expect(screen.page.locator(".view3d-foot")).to_contain_text("ground of the simulator")
    launcher = json.loads((screen.stack.run_dir / "state.json").read_text())["launcher_pid"]
    os.kill(launcher, signal.SIGSTOP)  # it would restart the bridge
    try:
        os.kill(screen.stack.processes_cached["vehicle_bridge"], signal.SIGSTOP)
        expect(north).to_have_class(re.compile("late"))
        expect(age).to_contain_text("s ago")
        expect(screen.page.locator(".horizon")).to_have_class(re.compile("late"))
        expect(screen.page.locator(".view3d-label", has_text="last seen here")).to_have_count(1)
        expect(value).to_have_text("–")
    finally:
        os.kill(launcher, signal.SIGCONT)
    expect(north).not_to_have_class(re.compile("late"))
    assert not screen.errors


def test_the_page_survives_restarts_of_bridge_and_router(screen: Screen) -> None:
    for service in SERVICES:
        process = screen.stack.processes()[service]
        os.kill(process, signal.SIGSTOP)
        screen.shows("Link lost")
        with suppress(ProcessLookupError):  # the launcher may have ended a process that does not answer
            os.kill(process, signal.SIGKILL)
        wait_for(lambda: set(SERVICES) <= set(screen.stack.processes()), 30, f"{service} is restarted")
        screen.shows("On the ground, ready")
    with screen.stack.connect() as uav:
        wait_for_status(uav, lambda status: status.ready, 60, "ready after the restarts")
    screen.fly("takeoff")
    screen.shows("Hovering")


def test_a_goal_goes_on_while_the_ground_station_is_restarted_and_is_shown_afterwards(screen: Screen) -> None:
    with screen.stack.connect() as uav:
        in_the_air(uav)
    screen.choose("go_to")
    screen.type_in(go_to__target_ned_m__north="30", go_to__target_ned_m__east="0", go_to__target_ned_m__height="3")
    screen.page.get_by_text("More settings").locator("visible=true").click()
    screen.type_in(go_to__speed_mps="0.5")
    screen.send("go_to")
    screen.has("goal-owner", "sent from this page")
    before = screen.stack.processes()["ground_station"]
    os.kill(before, signal.SIGKILL)
    processes = screen.stack.processes
    wait_for(lambda: processes().get("ground_station", before) != before, 60.0, "the ground station runs again")
    expect(screen.page.get_by_text("Connection lost")).not_to_be_visible(timeout=FLIGHT_TIMEOUT_MS)
    screen.shows("Flying to a point")
    screen.has("goal-owner", "its sender is gone")
    screen.page.keyboard.press("Escape")
    screen.shows("Hovering")
    assert not screen.foreign
