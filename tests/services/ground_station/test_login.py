"""Logging in and out, on a server of its own."""

import shutil
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

pytest.importorskip("nicegui", reason="the extra jezero[ground] is not installed")

from tests.services.ground_station.serving import PASSWORD, ask, make_certificate, serving

pytestmark = pytest.mark.process

FLOOD = 60


class Browser:
    """Sends requests to one server."""

    def __init__(self, address: str) -> None:
        self.address = address

    def request(self, method: str, path: str, fields: dict[str, str] | None = None, **headers: str) -> tuple[int, str]:
        """Status of the reply, and its `Set-Cookie`."""
        reply = ask(self.address, method, path, fields, **headers)
        return reply.status, reply.headers.get("Set-Cookie", "")

    def log_in(self, password: str, **headers: str) -> tuple[int, str]:
        """Send a password."""
        return self.request("POST", "/login", {"password": password}, **headers)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """A browser of a server without TLS."""
    with serving() as address:
        yield Browser(address)


def test_the_right_password_gives_a_cookie_that_scripts_and_other_sites_do_not_get(browser: Browser) -> None:
    status, cookie = browser.log_in(PASSWORD)
    assert status == 303
    attributes = cookie.lower().split("; ")
    assert "httponly" in attributes
    assert "samesite=strict" in attributes
    assert "secure" not in attributes


def test_other_sites_do_not_log_in(browser: Browser) -> None:
    assert browser.log_in(PASSWORD, Origin="http://example.org")[0] == 403


def test_a_form_without_the_password_is_refused(browser: Browser) -> None:
    forms: list[dict[str, str]] = [{}, {"password": ""}, {"other": PASSWORD}, {"password": PASSWORD * 99}]
    assert [browser.request("POST", "/login", fields) for fields in forms] == [(401, "")] * 4
    assert browser.log_in(PASSWORD)[0] == 303


def test_a_large_form_is_refused(browser: Browser) -> None:
    assert browser.request("POST", "/login", {"password": "x" * 70_000})[0] == 413


def test_the_page_is_only_got_and_nothing_else_is_done_by_a_get(browser: Browser) -> None:
    assert browser.request("GET", "/")[0] == 200
    assert browser.request("GET", "/logout")[0] in (404, 405)
    assert browser.request("POST", "/")[0] == 405


def test_after_five_wrong_passwords_the_right_one_waits_too() -> None:
    with serving() as address:
        browser = Browser(address)
        assert [browser.log_in("a wrong password")[0] for _ in range(6)] == [401] * 5 + [429]
        assert browser.log_in(PASSWORD) == (429, "")


def test_a_cookie_that_was_changed_or_has_logged_out_only_watches(browser: Browser) -> None:
    cookie = ask(browser.address, "POST", "/login", {"password": PASSWORD}).cookie
    assert not watches(browser, cookie)
    assert watches(browser, "")
    assert watches(browser, cookie[:-1])
    assert watches(browser, cookie.replace("=", "=A", 1))
    assert ask(browser.address, "POST", "/logout", Cookie=cookie).status == 303
    assert watches(browser, cookie)


def watches(browser: Browser, cookie: str) -> bool:
    """Whether the page of a cookie may not fly."""
    return '"text":"Watching"' in ask(browser.address, "GET", "/", Cookie=cookie).text


def test_a_flood_of_passwords_from_many_addresses_is_checked_one_by_one_and_the_rest_is_refused_at_once() -> None:
    """A guess takes one processor for 0.05 s; the others, and the pages, go on."""
    with serving() as address, ThreadPoolExecutor(FLOOD) as pool:

        def guess(number: int) -> int:
            return ask(address, "POST", "/login", {"password": "a wrong one"}, source=f"127.0.1.{1 + number}").status

        assert ask(address, "GET", "/login").status == 200
        guesses = [pool.submit(guess, number) for number in range(FLOOD)]
        assert ask(address, "GET", "/login").status == 200
        found = Counter(each.result() for each in guesses)
        assert set(found) == {401, 429}
        assert ask(address, "POST", "/login", {"password": PASSWORD}).status == 303


@pytest.mark.skipif(shutil.which("openssl") is None, reason="there is no openssl on the path")
def test_with_tls_the_cookie_is_sent_over_tls_only(tmp_path: Path) -> None:
    certificate, key = make_certificate(tmp_path)
    with serving("tcp/127.0.0.1:1", f"certificate={certificate}", f"key={key}") as address:
        assert address.startswith("https://")
        status, cookie = Browser(address).log_in(PASSWORD)
    assert status == 303
    assert "secure" in cookie.lower().split("; ")
