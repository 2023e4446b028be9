"""Pictures of the ground station's page in a real flight, at the size of a laptop and of a phone.

`python -m benchmarks.page_images [--run FOLDER] [--docs]` starts a stack of its own with the run folder FOLDER, flies
it through the SDK, and writes FOLDER/pages/. With `--docs` two of the pictures go to docs/images/ too.
"""

import argparse
import json
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from math import radians
from pathlib import Path
from tempfile import mkdtemp

from PIL import Image
from playwright.sync_api import Page, expect, sync_playwright

from jezero import Vehicle
from jezero.deploy.launcher.ports import instance_environment, reserved_instance

IMAGES = Path(__file__).parents[1] / "docs" / "images"
SIZES = {"wide": (1400, 900), "phone": (390, 844)}
DOCS = {"ground_station": "orbit-wide", "ground_station_landing": "landing-wide"}
"""Pictures of README.md and the documentation, by the name of their files."""
JPEG_QUALITY = 86
ROVER_NED_M = (5.0, -3.0)
TIMEOUT_MS = 180_000
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
FLAGS = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist")
"""WebGL without a graphics card."""


class Photographer:
    """Takes pictures of one page.

    Args:
        folder: for the pictures.
    """

    def __init__(self, page: Page, folder: Path) -> None:
        self._page = page
        self._folder = folder

    def take(self, name: str) -> None:
        """Take a picture of each size, the phone's first."""
        for view in ("Free", "Follow"):  # the eye goes back to its place beside the vehicle
            self._page.get_by_text(view, exact=True).click()
        for size, (width_px, height_px) in reversed(SIZES.items()):
            self._page.set_viewport_size({"width": width_px, "height": height_px})
            self.draw()
            path = self._folder / f"{name}-{size}.png"
            self._page.screenshot(path=path)
            print(path, flush=True)

    def draw(self, frames: int = 4) -> None:
        """Wait until the 3D view has drawn some frames of the vehicle's world."""
        self.wait_for(".view3d-foot", "ground of the simulator")
        self._page.evaluate("window.drawn3d = 0")
        self._page.wait_for_function("frames => window.drawn3d >= frames", arg=frames)

    def wait_for(self, selector: str, pattern: str) -> None:
        """Wait until the text of an element contains a pattern."""
        expect(self._page.locator(selector)).to_contain_text(re.compile(pattern), timeout=TIMEOUT_MS)


@contextmanager
def stack(run: Path) -> Iterator[dict[str, str]]:
    """A stack with its ground station; its environment."""
    with reserved_instance() as instance:
        environment = {
            **os.environ,
            **instance_environment(instance),
            "JEZERO_RUN_DIR": str(run),
            "JEZERO_GROUND": "1",
            "JEZERO_GCS_PORT": str(17550 + instance.number),
        }
        jezero(environment, "up", "-d", "--wait")
        try:
            yield environment
        finally:
            jezero(environment, "down")


def jezero(environment: dict[str, str], *words: str) -> str:
    """Run a command of jezero, and return what it prints."""
    command = [sys.executable, "-m", "jezero.cli.main", *words]
    return subprocess.run(command, env=environment, check=True, stdout=subprocess.PIPE, text=True).stdout


def services(environment: dict[str, str]) -> dict[str, dict[str, object]]:
    return {row["service"]: row for row in json.loads(jezero(environment, "ps", "--json"))}


def launcher_of(run: Path) -> int:
    return int(json.loads((run / "state.json").read_text())["launcher_pid"])


@contextmanager
def opened(address: str) -> Iterator[Page]:
    """The page in a browser, which counts the frames of the 3D view."""
    browser_path = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser_path is None:
        raise SystemExit(f"no browser: install one of {', '.join(BROWSERS)}")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=browser_path, args=list(FLAGS))
        width_px, height_px = SIZES["wide"]
        page = browser.new_page(viewport={"width": width_px, "height": height_px})
        page.add_init_script(
            """window.drawn3d = 0;
            const clear = WebGL2RenderingContext.prototype.clear;
            WebGL2RenderingContext.prototype.clear = function (bits) { window.drawn3d++; clear.call(this, bits); };"""
        )
        page.set_default_timeout(TIMEOUT_MS)
        page.goto(address)
        yield page
        browser.close()


def fly(uav: Vehicle, page: Page, photos: Photographer, bridge: int, launcher: int) -> None:
    """Fly through all that the pictures show.

    Args:
        bridge: process id of the vehicle bridge, which is stopped at the end.
        launcher: process id of the launcher, which starts another one.
    """
    photos.wait_for(".state-words", "ready")
    page.wait_for_selector(".camera img:not([hidden])")
    photos.take("idle")

    uav.takeoff(altitude_m=2.5).result()
    orbit = uav.get_images((*ROVER_NED_M, -3.0), 3.5, 12, target_z_ned_m=-0.5, speed_mps=0.6)
    photos.wait_for(".progress", r"[4-9] of 12")
    photos.take("orbit")
    orbit.result()

    cover(page)
    photos.wait_for(".progress", r"(1[2-9]|[2-9]\d) of")
    page.get_by_text("3D", exact=True).click()
    photos.take("coverage")
    page.locator('[data-mark="hover"]').click()
    photos.wait_for(".state-words", "Hovering")

    landing = uav.land_on_spot()
    photos.wait_for(".target", "Descent|Contact")
    photos.take("landing")
    landing.result()

    uav.takeoff(altitude_m=2.5).result()
    uav.go_to(2.0, 2.0, -10.0, yaw_rad=radians(140.0)).result()
    os.kill(launcher, signal.SIGSTOP)  # it would restart the bridge before the picture is taken
    try:
        os.kill(bridge, signal.SIGSTOP)
        photos.wait_for(".state-words", "Link lost")
        photos.take("lost")
    finally:
        os.kill(launcher, signal.SIGCONT)
    photos.wait_for(".state-more", "failsafe")
    photos.take("failsafe")


def cover(page: Page) -> None:
    """Draw an area on the map, and fly its plan."""
    page.locator('[data-mark="tab-area_coverage"]').click()
    canvas = page.locator(".map canvas")
    canvas.wait_for()  # the tab of this action shows the map
    box = canvas.bounding_box()
    assert box is not None
    middle_px = (box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"])
    for right_px, down_px in ((-200, 90), (-200, -240), (160, -240), (160, 90)):
        page.mouse.click(middle_px[0] + right_px, middle_px[1] + down_px)
    expect(page.locator('[data-mark="plan-area_coverage"]')).to_contain_text("images", timeout=TIMEOUT_MS)
    page.locator('[data-mark="fly-area_coverage"]').click()
    page.locator(".confirming").click()


def write_docs(folder: Path) -> None:
    """Write the pictures of the documentation."""
    for name, taken in DOCS.items():
        picture = Image.open(folder / f"{taken}.png")
        picture.convert("RGB").save(IMAGES / f"{name}.jpg", quality=JPEG_QUALITY, optimize=True, progressive=True)


def main() -> None:
    parser = argparse.ArgumentParser(description="Take pictures of the ground station's page in a real flight.")
    parser.add_argument("--run", type=Path, help="run folder of the stack [default: a new temporary one]")
    parser.add_argument("--docs", action="store_true", help="also write those of docs/images/")
    arguments = parser.parse_args()
    run = arguments.run or Path(mkdtemp(prefix="jezero-pages-"))
    folder = run / "pages"
    folder.mkdir(parents=True, exist_ok=True)
    with stack(run) as environment:
        rows = services(environment)
        address = str(rows["ground_station"]["text"]).partition(",")[0]
        bridge, launcher = int(str(rows["vehicle_bridge"]["pid"])), launcher_of(run)
        vehicle, router = environment["JEZERO_VEHICLE"], environment["JEZERO_ROUTER"]
        with Vehicle.connect(vehicle, router=router) as uav, opened(address) as page:
            fly(uav, page, Photographer(page, folder), bridge, launcher)
    if arguments.docs:
        write_docs(folder)


if __name__ == "__main__":
    main()
