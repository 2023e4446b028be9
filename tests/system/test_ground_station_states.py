"""What the ground station's page says of a flight that ended badly, of silence, and of a goal before it flies.

All tests of the file share one stack and one page. Each leaves the vehicle where the next one expects it; after the
one that cuts the motors nothing flies any more.
"""

import json
import os
import re
import signal
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

pytest.importorskip("nicegui", reason="the extra jezero[ground] is not installed")
pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

from playwright.sync_api import expect

from tests.system.ground_screen import FLIES_A_STACK, FLIGHT_TIMEOUT_MS, Screen, open_screen, stack_with_screen

SILENCE_TIMEOUT_MS = 2000
"""The page must be grey by then. The test has the machine's two processors to itself."""
VIEWPORTS = ({"width": 390, "height": 844}, {"width": 1280, "height": 800})

pytestmark = FLIES_A_STACK


@pytest.fixture(scope="module")
def screen(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Screen]:
    """The page of a stack that is ready."""
    with stack_with_screen(tmp_path_factory.mktemp("ground")) as shown:
        yield shown


@contextmanager
def no_restarts(screen: Screen) -> Iterator[None]:
    """The launcher, which restarts services, stands still during the block."""
    launcher = json.loads((screen.stack.run_dir / "state.json").read_text())["launcher_pid"]
    os.kill(launcher, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(launcher, signal.SIGCONT)


def test_a_goal_is_confirmed_with_its_plan_and_the_confirmation_expires_when_a_field_changes(screen: Screen) -> None:
    screen.choose("takeoff")
    screen.type_in(takeoff__altitude_m="")
    screen.plan("takeoff")
    screen.has("problem-takeoff-altitude_m", "altitude is missing")
    screen.type_in(takeoff__altitude_m="100")
    screen.marked("takeoff-altitude_m").press("Enter")
    screen.plan("takeoff")
    expect(screen.marked("fly-takeoff")).to_have_text(
        re.compile(r"Confirm: [\d min]+ s, \d+ m, \d+ % of the battery, up to 100 m"), timeout=FLIGHT_TIMEOUT_MS
    )
    screen.type_in(takeoff__altitude_m="3")
    expect(screen.marked("fly-takeoff")).to_have_text("Fly")
    with screen.stack.connect() as uav:
        assert not uav.status().armed
    screen.send("takeoff")
    screen.shows("Hovering")


def test_a_silent_vehicle_is_grey_and_the_landing_of_its_failsafe_says_so(screen: Screen) -> None:
    bridge = screen.stack.processes()["vehicle_bridge"]
    with no_restarts(screen):
        os.kill(bridge, signal.SIGSTOP)
        expect(screen.page.locator(".vehicle-silent")).to_be_visible(timeout=SILENCE_TIMEOUT_MS)
        expect(screen.page.locator(".state-why")).to_contain_text("The vehicle is silent for 3 s")
        os.kill(bridge, signal.SIGCONT)
    screen.shows("Landing, failsafe")
    screen.has("notice", "Ended by a failsafe")
    screen.shows("On the ground")
    screen.has("notice", "Ended by a failsafe")
    screen.marked("noted").click()
    expect(screen.marked("notice")).not_to_be_visible()
    screen.shows("On the ground, ready")


def test_messages_cover_neither_the_state_nor_the_buttons_that_stop_the_vehicle(screen: Screen) -> None:
    for viewport in VIEWPORTS:
        screen.page.set_viewport_size(viewport)  # type: ignore[arg-type]
        screen.marked("hover").click()
        toast = screen.page.locator(".q-notification").last
        expect(toast).to_be_visible()
        for part in (".state-words", ".hover-button", ".abort-button", ".hold"):
            box, over = screen.page.locator(part).bounding_box(), toast.bounding_box()
            assert box is not None and over is not None
            assert box["y"] + box["height"] < over["y"], (part, viewport)
    screen.page.set_viewport_size({"width": 1400, "height": 900})


def test_motors_that_were_cut_stay_on_top_in_all_browsers_until_somebody_takes_note(screen: Screen) -> None:
    screen.fly("takeoff")
    screen.shows("Hovering")
    box = screen.page.locator(".hold").bounding_box()
    assert box is not None
    screen.page.mouse.move(box["x"] + 10.0, box["y"] + 10.0)
    screen.page.mouse.down()
    screen.has("notice", "Motors cut on request")
    screen.page.mouse.up()
    screen.shows("On the ground")
    screen.page.reload()
    screen.has("notice", "Motors cut on request")
    other = open_screen(screen.page.context.browser, screen.stack, screen.address)  # type: ignore[arg-type]
    other.has("notice", "Motors cut on request")
    screen.marked("noted").click()
    expect(screen.marked("notice")).not_to_be_visible()
    expect(other.marked("notice")).not_to_be_visible()
    other.page.context.close()


def test_a_page_whose_ground_station_died_is_grey_and_has_no_green_state(screen: Screen) -> None:
    with no_restarts(screen):
        os.kill(screen.stack.processes_cached["ground_station"], signal.SIGKILL)
        expect(screen.page.locator("body.server-silent")).to_be_visible(timeout=SILENCE_TIMEOUT_MS)
        expect(screen.page.locator(".watchdog")).to_contain_text("The ground station is silent for 3 s")
        expect(screen.page.locator(".state-words")).not_to_be_visible()
    screen.shows("On the ground")
