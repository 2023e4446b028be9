"""Looking back in a real browser, at a flight in virtual time."""

import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("nicegui", reason="the extra jezero[ground] is not installed")
pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

from playwright.sync_api import Page, expect, sync_playwright

from jezero.schemas import topics
from jezero.schemas.goals import LandOnSpotGoal, TakeoffGoal
from jezero.trials.flight import fly_virtually

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
MISSION = ((topics.TAKEOFF, TakeoffGoal(altitude_m=2.0), 1.0), (topics.LAND_ON_SPOT, LandOnSpotGoal(), 0.0))

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium on the path"),
    pytest.mark.timeout(600),
]


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short flight with the camera's images."""
    path = tmp_path_factory.mktemp("run") / "flight.mcap"
    fly_virtually(MISSION, 0, path, on_images=lambda images: None)
    return path


@pytest.fixture(scope="module")
def page(recording: Path) -> Iterator[Page]:
    """The page of the recording, opened from the list of its folder."""
    command = [sys.executable, "-m", "jezero.cli.main", "ground", "--recording", str(recording.parent)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            address = process.stdout.readline().split(" are on ")[1].partition(". ")[0]
            with sync_playwright() as playwright:
                browser = playwright.chromium.launch(
                    executable_path=CHROMIUM, args=["--no-sandbox", "--disable-3d-apis"]
                )
                opened = browser.new_page()
                opened.set_default_timeout(30_000)
                opened.goto(address)
                opened.get_by_text(recording.name).click()
                expect(opened.locator('[data-mark="slider"]')).to_be_visible(timeout=60_000)
                yield opened
                browser.close()
        finally:
            process.terminate()


def shows(page: Page, words: str) -> None:
    """Wait until the state line has these words."""
    expect(page.locator(".state-words")).to_contain_text(words, timeout=60_000)


def seconds(page: Page) -> float:
    """Time that the page shows."""
    minutes, rest = page.locator('[data-mark="time"]').inner_text().partition(" / ")[0].split(":")
    return 60.0 * float(minutes) + float(rest)


def test_jumps_show_the_state_of_their_time_and_the_picture(page: Page) -> None:
    page.locator(".timeline-mark[title*='Taking off']").first.click()
    shows(page, "Taking off")
    expect(page.locator(".camera img")).to_be_visible(timeout=60_000)
    page.locator(".timeline-mark[title*='Landed']").first.click()
    shows(page, "On the ground")
    expect(page.locator(".events")).to_contain_text("Landed")
    page.locator(".timeline-mark[title*='Landing']").first.click()
    shows(page, "Landing")
    expect(page.locator(".events")).not_to_contain_text("Landed")
    page.locator('[data-mark="slider"]').fill("0")
    shows(page, "No vehicle")
    expect(page.locator(".state-why")).to_contain_text("The recording has no status of this time")
    page.locator('[data-mark="slider"]').fill("1")
    shows(page, "On the ground")
    expect(page.locator(".events")).not_to_contain_text("Taking off")


def test_it_plays_faster_when_told_so_and_pauses(page: Page) -> None:
    page.locator('[data-mark="slider"]').fill("0")
    expect(page.locator('[data-mark="time"]')).to_contain_text("0:00.0 /", timeout=60_000)
    page.locator('[data-mark="speed"]').select_option("5")
    page.locator('[data-mark="play"]').click()
    shows(page, "Taking off")
    page.keyboard.press("Space")
    expect(page.locator('[data-mark="play"]')).to_have_attribute("aria-label", "Play", timeout=60_000)
    paused_s = seconds(page)
    assert paused_s > 0.0
    page.locator('[data-mark="play"]').click()
    page.wait_for_function(
        "from => Number(document.querySelector('[data-mark=slider]').value) > from + 1", arg=paused_s
    )


def test_the_page_says_that_it_is_a_recording_and_has_no_commands(page: Page) -> None:
    expect(page.locator('[data-mark="recorded"]')).to_have_text("Recording flight.mcap")
    for mark in ("hover", "abort", "fly-takeoff"):
        expect(page.locator(f'[data-mark="{mark}"]')).not_to_be_visible()
    page.evaluate("document.querySelector('.page').classList.remove('recorded')")
    page.locator('[data-mark="hover"]').click()
    refused = page.locator(".q-notification").filter(has_text="Hover failed: this is a recording")
    expect(refused).to_be_visible(timeout=30_000)
