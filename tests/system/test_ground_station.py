"""The ground station's page in a real browser: what a person clicks flies a real stack."""

import json
import os
import re
import shutil
import signal
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from urllib.parse import urlsplit

import pytest

pytest.importorskip("nicegui", reason="the extra jezero[ground] is not installed")
pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

from playwright.sync_api import Locator, Page, expect, sync_playwright

from tests.system.conftest import Stack, wait_for, wait_for_status

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
SOFTWARE_GL = (
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--disable-gpu-rasterization",
    "--disable-accelerated-2d-canvas",
)
FLIGHT_TIMEOUT_MS = 180_000
SERVICES = ("vehicle_bridge", "router")

pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium on the path"),
    pytest.mark.timeout(900),
]


@dataclass
class Screen:
    """One page, with all that went wrong in it.

    Attributes:
        stack: the stack whose ground station serves it.
        page: the page.
        errors: errors in its console, and exceptions of its scripts.
        foreign: addresses of other hosts that it requested.
    """

    stack: Stack
    page: Page
    errors: list[str] = field(default_factory=list)
    foreign: list[str] = field(default_factory=list)

    def marked(self, mark: str) -> Locator:
        """The element with a mark; of a field, what is typed into."""
        return self.page.locator(f'[data-mark="{mark}"]')

    def shows(self, words: str) -> None:
        """Wait until the state line begins with these words."""
        expect(self.page.locator(".state-words")).to_contain_text(words, timeout=FLIGHT_TIMEOUT_MS)

    def tells(self, event: str) -> None:
        """Wait until an event is in the list, which a state that ends soon leaves behind."""
        expect(self.page.locator(".events")).to_contain_text(event, timeout=FLIGHT_TIMEOUT_MS)

    def choose(self, action: str) -> None:
        """Open the form of an action."""
        self.marked(f"tab-{action}").click()
        expect(self.marked(f"fly-{action}")).to_be_visible()

    def fly(self, action: str) -> None:
        """Open the form of an action and send it."""
        self.choose(action)
        self.marked(f"fly-{action}").click()

    def click_map(self, right_px: float, up_px: float) -> None:
        """Click the map, at a distance from its middle."""
        box = self.page.locator(".map canvas").bounding_box()
        assert box is not None
        self.page.mouse.click(box["x"] + 0.5 * box["width"] + right_px, box["y"] + 0.5 * box["height"] - up_px)


@pytest.fixture
def screen(unstarted: Stack) -> Iterator[Screen]:
    """The page of a stack that is ready."""
    unstarted.environment["JEZERO_GROUND"] = "1"
    unstarted.up()
    rows = {row["service"]: row for row in json.loads(unstarted.jezero("ps", "--json").stdout)}
    address = rows["ground_station"]["text"].partition(",")[0]
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=list(SOFTWARE_GL))
        page = browser.new_page(viewport={"width": 1400, "height": 900})
        page.set_default_timeout(60_000)
        shown = Screen(unstarted, page)
        page.on("console", lambda message: shown.errors.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: shown.errors.append(str(error)))
        page.on("request", lambda request: _note_foreign(shown, request.url, address))
        page.goto(address)
        shown.shows("On the ground, ready")
        yield shown
        browser.close()


def _note_foreign(screen: Screen, url: str, address: str) -> None:
    if urlsplit(url).scheme not in ("blob", "data") and urlsplit(url).netloc != urlsplit(address).netloc:
        screen.foreign.append(url)


def test_a_mission_is_flown_by_clicks_alone(screen: Screen) -> None:
    screen.fly("takeoff")
    screen.shows("Hovering")

    screen.choose("go_to")
    screen.marked("go_to-target_ned_m-north").fill("1")
    screen.marked("go_to-target_ned_m-east").fill("1")
    screen.marked("fly-go_to").click()
    screen.tells("Flying to a point")
    screen.shows("Hovering")

    screen.choose("area_coverage")
    for right_px, up_px in ((-60, -60), (-60, 60), (60, 60), (60, -60)):
        screen.click_map(right_px, up_px)
    expect(screen.marked("plan-area_coverage")).to_contain_text("images", timeout=60_000)
    screen.marked("fly-area_coverage").click()
    screen.tells("Covering an area")
    screen.shows("Hovering")

    screen.fly("land_on_spot")
    screen.tells("Landing")
    screen.shows("On the ground")
    with screen.stack.connect() as uav:
        assert not uav.status().armed
    assert not screen.errors
    assert not screen.foreign


def test_keys_hover_and_abort_and_a_wrong_field_tells_why(screen: Screen) -> None:
    screen.choose("takeoff")
    screen.marked("takeoff-altitude_m").fill("9000")
    screen.marked("fly-takeoff").click()
    expect(screen.marked("problem-takeoff")).to_contain_text("120", timeout=30_000)
    screen.marked("takeoff-altitude_m").fill("high")
    screen.marked("fly-takeoff").click()
    expect(screen.marked("problem-takeoff")).to_contain_text("'high' is no number")
    screen.marked("takeoff-altitude_m").fill("2")
    screen.marked("fly-takeoff").click()
    screen.shows("Hovering")

    with screen.stack.connect() as uav:
        for key, ended in (("Space", "hover"), ("Escape", "abort")):
            goal = uav.go_to(20.0, 0.0, -3.0, speed_mps=0.5)
            screen.shows("Flying to a point")  # another client's goal is shown too
            screen.marked("pause").click()
            screen.shows("Flying to a point, paused")
            expect(screen.marked("pause")).to_have_text("Resume", timeout=10_000)
            screen.marked("pause").click()
            expect(screen.marked("pause")).to_have_text("Pause", timeout=10_000)
            screen.page.keyboard.press(key)
            screen.shows("Hovering")
            reply = uav.result_of(goal.goal_id)
            assert reply is not None, ended
            assert not reply.running, ended
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
