"""Half an hour of two open pages in a real browser, each of which flies: memory of server and pages, and reconnects.

`python -m benchmarks.speed.pages_long --minutes 30` prints a line a minute. It needs Playwright and a Chromium.
"""

import argparse
import shutil
import tempfile
import time
from pathlib import Path

from playwright.sync_api import Browser, CDPSession, Page, expect, sync_playwright

from benchmarks.speed.pages import address_of
from benchmarks.speed.stack import Stack, cpu_ns, memory_mb, running_stack
from jezero.deploy.launcher.ports import reserved_instance

MINUTE_S = 60.0
FLIGHT_TIMEOUT_MS = 180_000
SOFTWARE_GL = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist")


class Viewer:
    """One open page.

    Attributes:
        page: the page.
        connections: number of connections to the server so far; one without reconnects.
        errors: errors in its console, and exceptions of its scripts.
    """

    def __init__(self, browser: Browser, address: str) -> None:
        self.page: Page = browser.new_page(viewport={"width": 1000, "height": 700})
        self.connections = 0
        self.errors: list[str] = []
        self.page.on("websocket", lambda socket: self._on_connection())
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on("console", lambda text: self.errors.append(text.text) if text.type == "error" else None)
        self.page.set_default_timeout(FLIGHT_TIMEOUT_MS)
        self.page.goto(address)
        self._devtools: CDPSession = self.page.context.new_cdp_session(self.page)
        self.shows("ready")

    def _on_connection(self) -> None:
        self.connections += 1

    def shows(self, words: str) -> None:
        """Wait until the state line has these words."""
        expect(self.page.locator(".state-words")).to_contain_text(words, timeout=FLIGHT_TIMEOUT_MS)

    def heap_mb(self) -> float:
        """Memory of the page's scripts that is in use, in MB."""
        self._devtools.send("HeapProfiler.collectGarbage")
        return float(self._devtools.send("Runtime.getHeapUsage")["usedSize"]) / 1e6

    def fly(self) -> None:
        """Take off and land, by clicks."""
        for action, during, after in (
            ("takeoff", "Taking off", "Hovering"),
            ("land_on_spot", "Landing", "On the ground"),
        ):
            self.page.locator(f'[data-mark="tab-{action}"]').click()
            self.page.locator(f'[data-mark="fly-{action}"]').click()
            self.page.locator(".confirming").click()
            self.shows(during)
            self.shows(after)


def main() -> None:
    """Fly with each page in turn, and print the figures of each minute."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=int, default=30)
    minutes = parser.parse_args().minutes
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    with (
        tempfile.TemporaryDirectory() as folder,
        reserved_instance(vehicle="pages") as instance,
        running_stack(instance, Path(folder)) as stack,
        sync_playwright() as playwright,
    ):
        browser = playwright.chromium.launch(executable_path=chromium, args=list(SOFTWARE_GL))
        viewers = [Viewer(browser, address_of(stack)) for _ in range(2)]
        viewers[1].page.get_by_text("Map", exact=True).click()
        print("minute   server MB   server % of a core   heaps MB     connections   errors   flights")
        _watch(stack, viewers, minutes)
        browser.close()


def _watch(stack: Stack, viewers: list[Viewer], minutes: int) -> None:
    pid = stack.processes()["ground_station"]
    start_s, flights = time.monotonic(), 0
    used_ns = cpu_ns(pid)
    for minute in range(1, minutes + 1):
        if minute % 5 == 1:
            viewers[flights % 2].fly()
            flights += 1
        while (rest_s := start_s + minute * MINUTE_S - time.monotonic()) > 0:
            viewers[0].page.wait_for_timeout(min(1000.0 * rest_s, 1000.0))
        before_ns, used_ns = used_ns, cpu_ns(pid)
        heaps = "  ".join(f"{viewer.heap_mb():.1f}" for viewer in viewers)
        connections = sum(viewer.connections for viewer in viewers)
        errors = [error for viewer in viewers for error in viewer.errors]
        cpu = 100.0 * (used_ns - before_ns) * 1e-9 / MINUTE_S
        print(
            f"{minute:>6}{memory_mb(pid)[0]:>12.1f}{cpu:>21.1f}   {heaps:<12}{connections:>12}{len(errors):>9}"
            f"{flights:>10}",
            flush=True,
        )
        for error in errors[:3]:
            print(f"       {error[:200]}", flush=True)


if __name__ == "__main__":
    main()
