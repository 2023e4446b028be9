"""Watching and flying in a real browser, with a ground station that needs a password."""

import os
import shutil
import signal
import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

pytest.importorskip("nicegui", reason="the extra jezero[ground] is not installed")
pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

from playwright.sync_api import Browser, Page, expect, sync_playwright

from tests.services.ground_station.serving import PASSWORD, serving, serving_process

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
POLICY = "Content Security Policy"
REFUSED = "you are watching: log in to fly"

pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium on the path"),
    pytest.mark.timeout(300),
]


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    """Address of a ground station without a vehicle."""
    with serving() as pages:
        yield pages


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """A browser."""
    with sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", "--disable-3d-apis"])
        yield started
        started.close()


@pytest.fixture
def page(browser: Browser, address: str) -> Iterator[Page]:
    """The page, by somebody who has not logged in."""
    context = browser.new_context()
    opened = context.new_page()
    opened.set_default_timeout(60_000)
    opened.goto(address)
    expect(opened.locator(".state-words")).to_contain_text("No vehicle", timeout=60_000)
    yield opened
    context.close()


def log_in(page: Page) -> None:
    """Log in by the form."""
    page.locator('[data-mark="log-in"]').click()
    page.locator("input[name=password]").fill(PASSWORD)
    page.locator("button").click()
    expect(page.locator('[data-mark="log-out"]')).to_be_visible(timeout=60_000)


def tells(page: Page, words: str) -> None:
    """Wait until the page notifies its user."""
    expect(page.locator(".q-notification").filter(has_text=words)).to_be_visible(timeout=30_000)


def test_a_page_that_watches_says_so_and_has_no_commands(page: Page) -> None:
    expect(page.locator('[data-mark="access"]')).to_have_text("Watching")
    expect(page.locator('[data-mark="insecure"]')).to_have_count(0)
    for mark in ("hover", "abort", "fly-takeoff"):
        expect(page.locator(f'[data-mark="{mark}"]')).not_to_be_visible()


def test_a_stack_without_tls_says_so_all_the_time(browser: Browser, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("JEZERO_INSECURE", "1")
    monkeypatch.setenv("JEZERO_LISTEN", "tcp/0.0.0.0:7448")
    with serving() as address, browser.new_context() as context:
        page = context.new_page()
        page.goto(address)
        banner = page.locator('[data-mark="insecure"]')
        expect(banner).to_contain_text("tcp/0.0.0.0:7448 is insecure: whoever is on its network", timeout=60_000)


def test_the_server_refuses_a_page_that_watches_though_it_sends_commands(page: Page) -> None:
    page.keyboard.press("Space")
    tells(page, f"Hover failed: {REFUSED}")
    page.keyboard.press("Escape")
    tells(page, f"Abort failed: {REFUSED}")
    expect(page.locator(".events")).not_to_contain_text(REFUSED)
    page.evaluate("document.querySelector('.page').classList.remove('watching')")
    page.locator('[data-mark="fly-takeoff"]').click()
    expect(page.locator('[data-mark="problem-takeoff"]')).to_have_text(REFUSED, timeout=30_000)


def test_who_logs_in_may_fly_until_the_log_out_also_on_pages_that_are_open(page: Page, address: str) -> None:
    log_in(page)
    page.locator('[data-mark="hover"]').click()
    expect(page.locator(".events")).to_contain_text("Hover failed: ", timeout=30_000)
    expect(page.locator('[data-mark="access"]')).to_be_empty()
    second = page.context.new_page()
    second.goto(address)
    second.locator('[data-mark="log-out"]').click()
    expect(second.locator('[data-mark="access"]')).to_have_text("Watching", timeout=60_000)
    expect(page.locator('[data-mark="access"]')).to_have_text("Watching", timeout=60_000)
    page.keyboard.press("Escape")
    tells(page, f"Abort failed: {REFUSED}")


def test_another_site_cannot_show_the_page_in_a_frame(browser: Browser, address: str, tmp_path: Path) -> None:
    (tmp_path / "index.html").write_text(f'<iframe src="{address}/login"></iframe>')
    handler = partial(SimpleHTTPRequestHandler, directory=str(tmp_path))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as other, browser.new_context() as context:
        threading.Thread(target=other.serve_forever, daemon=True).start()
        page = context.new_page()
        with page.expect_console_message(lambda message: "frame-ancestors 'none'" in message.text, timeout=60_000):
            page.goto(f"http://127.0.0.1:{other.server_port}/index.html")
        assert page.frame_locator("iframe").locator("form").count() == 0
        other.shutdown()


def test_a_page_does_nothing_that_its_policy_forbids_and_reaches_no_other_host(browser: Browser, address: str) -> None:
    with browser.new_context() as context:
        page = context.new_page()
        messages: list[str] = []
        page.on("console", lambda message: messages.append(message.text))
        page.goto(address)
        expect(page.locator(".state-words")).to_contain_text("No vehicle", timeout=60_000)
        log_in(page)
        page.goto(f"{address}/recordings")
        expect(page.locator("h1")).to_have_text("Recordings")
        page.goto(address)
        page.locator('[data-mark="tab-go_to"]').click(timeout=60_000)
        expect(page.locator('[data-mark="fly-go_to"]')).to_be_visible(timeout=60_000)
        assert not any(POLICY in text for text in messages)
        with page.expect_console_message(lambda message: POLICY in message.text, timeout=60_000):
            fetched = page.evaluate("fetch('http://192.0.2.1/').then(() => 'reached', error => String(error))")
        assert "Failed to fetch" in fetched


def test_a_page_whose_server_is_silent_says_that_it_is_old(browser: Browser) -> None:
    with serving_process() as (address, server), browser.new_context() as context:
        page = context.new_page()
        page.goto(address)
        expect(page.locator(".state-words")).to_contain_text("No vehicle", timeout=60_000)
        expect(page.locator(".watchdog")).to_have_count(0)
        os.kill(server, signal.SIGSTOP)
        expect(page.locator(".watchdog")).to_contain_text("The ground station is silent for", timeout=60_000)
        expect(page.locator(".state-words")).not_to_be_visible()
        os.kill(server, signal.SIGCONT)
        expect(page.locator(".watchdog")).to_have_count(0, timeout=60_000)
