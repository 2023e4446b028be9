"""Logging in and out, on a server of its own."""

import http.client
import shutil
import ssl
import subprocess
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlencode, urlsplit

import pytest

pytest.importorskip("nicegui", reason="the extra jezero[ground] is not installed")

from tests.services.ground_station.serving import ADDRESS, PASSWORD, serving


class Browser:
    """Sends requests to one server."""

    def __init__(self, address: str) -> None:
        parts = urlsplit(address)
        self._tls = parts.scheme == "https"
        self.host, self._port = parts.netloc, parts.port

    def request(self, method: str, path: str, fields: dict[str, str] | None = None, **headers: str) -> tuple[int, str]:
        """Status of the reply, and its `Set-Cookie`."""
        context = ssl._create_unverified_context() if self._tls else None
        connection = (
            http.client.HTTPSConnection(ADDRESS, self._port, timeout=20, context=context)
            if self._tls
            else http.client.HTTPConnection(ADDRESS, self._port, timeout=20)
        )
        connection.request(method, path, None if fields is None else urlencode(fields), headers)
        reply = connection.getresponse()
        reply.read()
        connection.close()
        return reply.status, reply.getheader("Set-Cookie", "")

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
    assert "HttpOnly" in cookie
    assert "SameSite=strict" in cookie
    assert "Secure" not in cookie


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


@pytest.mark.skipif(shutil.which("openssl") is None, reason="there is no openssl on the path")
def test_with_tls_the_cookie_is_sent_over_tls_only(tmp_path: Path) -> None:
    key, certificate = tmp_path / "key.pem", tmp_path / "certificate.pem"
    request = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-subj",
               "/CN=test", "-days", "1", "-keyout", str(key), "-out", str(certificate)]  # fmt: skip
    subprocess.run(request, check=True, capture_output=True)
    with serving("tcp/127.0.0.1:1", f"certificate={certificate}", f"key={key}") as address:
        assert address.startswith("https://")
        status, cookie = Browser(address).log_in(PASSWORD)
    assert status == 303
    assert "Secure" in cookie
