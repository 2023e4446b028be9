"""A page of the ground station in a real browser, for the tests that click it."""

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from playwright.sync_api import Browser, Locator, Page, expect, sync_playwright

from tests.system.conftest import Stack, new_stack

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
REPLY_TIMEOUT_MS = 60_000
expect.set_options(timeout=REPLY_TIMEOUT_MS)
FLIES_A_STACK = [
    pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium on the path"),
    pytest.mark.timeout(900),
    pytest.mark.slow,  # a stack, and a browser that draws without a graphics card, need both processors for minutes
]
"""Marks of the tests that fly a stack from its page."""
CLICKED = ("go_to", "get_images", "area_coverage")
"""Actions whose forms take clicks on the map at once."""


@dataclass
class Screen:
    """One page, with all that went wrong in it.

    Attributes:
        started: the stack whose ground station serves it; None for a hand-made server in its place.
        page: the page.
        address: of the page.
        errors: errors in its console, and exceptions of its scripts.
        foreign: addresses of other hosts that it requested.
        maps: number of pictures of the growing map that it has got.
    """

    started: Stack | None
    page: Page
    address: str
    errors: list[str] = field(default_factory=list)
    foreign: list[str] = field(default_factory=list)
    maps: int = 0

    @property
    def stack(self) -> Stack:
        """The stack."""
        assert self.started is not None
        return self.started

    def marked(self, mark: str) -> Locator:
        """The element with a mark; of a field, what is typed into."""
        return self.page.locator(f'[data-mark="{mark}"]')

    def shows(self, words: str) -> None:
        """Wait until the state line begins with these words."""
        expect(self.page.locator(".state-words")).to_contain_text(words, timeout=FLIGHT_TIMEOUT_MS)

    def tells(self, event: str) -> None:
        """Wait until an event is in the list, which a state that ends soon leaves behind."""
        expect(self.page.locator(".events")).to_contain_text(event, timeout=FLIGHT_TIMEOUT_MS)

    def has(self, mark: str, words: str) -> None:
        """Wait until an element has these words."""
        expect(self.marked(mark)).to_contain_text(words, timeout=REPLY_TIMEOUT_MS)

    def type_in(self, **values: object) -> None:
        """Type into the fields with these marks, in which `__` stands for `-`."""
        for mark, value in values.items():
            self.marked(mark.replace("__", "-")).fill(str(value))

    def choose(self, action: str) -> None:
        """Open the form of an action."""
        self.marked(f"tab-{action}").click()
        expect(self.marked(f"fly-{action}")).to_be_visible()
        expect(self.page.locator('[data-mark^="fly-"]:visible')).to_have_count(1)  # the form before has slid away
        cursor = "crosshair" if action in CLICKED else "grab"
        expect(self.page.locator(".map canvas")).to_have_css("cursor", cursor)

    def plan(self, action: str) -> None:
        """Press the button of a form for the first time, which plans the goal."""
        self.marked(f"fly-{action}").click()

    def send(self, action: str) -> None:
        """Plan the goal of a form, and confirm it."""
        self.plan(action)
        self.has(f"fly-{action}", "Confirm")
        self.marked(f"fly-{action}").click()

    def fly(self, action: str) -> None:
        """Open the form of an action and send it."""
        self.choose(action)
        self.send(action)

    def place(self, right_px: float, up_px: float) -> tuple[float, float]:
        """A place of the map on the screen, by its distance from the map's middle."""
        box = self.page.locator(".map canvas").bounding_box()
        assert box is not None
        return box["x"] + 0.5 * box["width"] + right_px, box["y"] + 0.5 * box["height"] - up_px

    def click_map(self, right_px: float, up_px: float, button: str = "left") -> None:
        """Click the map."""
        x, y = self.place(right_px, up_px)
        self.page.mouse.click(x, y, button="right" if button == "right" else "left")

    def drag_map(self, start_px: tuple[float, float], end_px: tuple[float, float]) -> None:
        """Drag from one place of the map to another."""
        self.page.mouse.move(*self.place(*start_px))
        self.page.mouse.down()
        self.page.mouse.move(*self.place(*end_px), steps=4)
        self.page.mouse.up()

    def rings(self) -> list[list[list[float]]]:
        """The rings of the area that the browser has kept."""
        kept = self.page.evaluate("JSON.parse(localStorage.getItem('jezero-area') || 'null')")
        rings: list[list[list[float]]] = kept["rings"] if kept else []
        return rings

    def wait_for_rings(self, corners: list[int]) -> None:
        """Wait until the browser keeps rings with these numbers of corners."""
        lengths = "(JSON.parse(localStorage.getItem('jezero-area'))?.rings ?? []).map((ring) => ring.length)"
        self.page.wait_for_function(f"JSON.stringify({lengths}) === '{corners}'.replaceAll(' ', '')")


def open_screen(browser: Browser, stack: Stack | None, address: str) -> Screen:
    """Open the page in a context of its own, as another person's browser would."""
    context = browser.new_context(viewport={"width": 1400, "height": 900}, accept_downloads=True)
    context.add_init_script(
        "localStorage.setItem('jezero-view', '\"map\"')"
    )  # the view in space takes a whole processor
    page = context.new_page()
    page.set_default_timeout(REPLY_TIMEOUT_MS)
    screen = Screen(stack, page, address)
    page.on("console", lambda message: screen.errors.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: screen.errors.append(str(error)))
    page.on("request", lambda request: _note_request(screen, request.url))
    page.goto(address)
    expect(page.locator(".map canvas")).to_be_visible()
    page.locator(".picture summary").click()  # the camera's picture takes the next one
    return screen


def _note_request(screen: Screen, url: str) -> None:
    parts = urlsplit(url)
    screen.maps += parts.path == "/coverage.webp"
    if parts.scheme not in ("blob", "data") and parts.netloc != urlsplit(screen.address).netloc:
        screen.foreign.append(url)


def pages_of(stack: Stack) -> str:
    """Start a stack with its ground station, and return the address of its pages."""
    stack.environment["JEZERO_GROUND"] = "1"
    stack.up()
    rows = {row["service"]: row for row in json.loads(stack.jezero("ps", "--json").stdout)}
    address: str = rows["ground_station"]["text"].partition(",")[0]
    return address


@contextmanager
def browser_started() -> Iterator[Browser]:
    """A browser without a graphics card."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=list(SOFTWARE_GL))
        yield browser
        browser.close()


@contextmanager
def stack_with_screen(folder: Path) -> Iterator[Screen]:
    """The page of a stack that is ready.

    Args:
        folder: for the run folder.
    """
    with new_stack(folder, whole=True) as stack, browser_started() as browser:
        shown = open_screen(browser, stack, pages_of(stack))
        shown.shows("On the ground, ready")
        yield shown
