"""What must not end the launcher, as the services would die with it, and what it must not believe."""

import io
from pathlib import Path
from types import SimpleNamespace

import pytest
import zenoh

from jezero.base.codec import encode
from jezero.deploy.launcher.compose import ComposeError, parse
from jezero.deploy.launcher.health import HealthWatcher
from jezero.deploy.launcher.output import LogReader, Output
from jezero.deploy.launcher.state import RunFolder
from jezero.runtime.instance import Instance
from jezero.schemas.health import ServiceHealth
from jezero.schemas.state import Status


class FullDisk:
    """A log file that takes nothing."""

    def write(self, data: bytes) -> int:
        raise OSError(28, "No space left on device")


def sample_of(key: str, payload: bytes, kind: zenoh.SampleKind = zenoh.SampleKind.PUT) -> "zenoh.Sample":
    content = SimpleNamespace(to_bytes=lambda: payload)
    return SimpleNamespace(key_expr=key, payload=content, kind=kind)  # type: ignore[return-value]


def folder_in(tmp_path: Path) -> RunFolder:
    folder = RunFolder(tmp_path)
    folder.acquire()
    return folder


def test_a_full_disk_loses_lines_and_says_how_many_once_there_is_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = folder_in(tmp_path)
    output = Output(folder, ["a"], None)
    with monkeypatch.context() as full:
        full.setitem(output._files, "a", FullDisk())
        output.write_line("a", "lost")
        output.write_line("a", "lost too")
    output.write_line("a", "back")
    output.write_line("a", "again")
    output.close()
    texts = [line.split(" ", 1)[1] for _, line in LogReader(folder, ["a"]).read()]
    assert texts == ["[launcher] 2 lines before this one could not be written", "back", "again"]


def test_a_terminal_without_the_character_shows_another(tmp_path: Path) -> None:
    screen = io.BytesIO()
    output = Output(folder_in(tmp_path), ["a"], io.TextIOWrapper(screen, encoding="ascii"))
    output.on_data("a", "1 → 2\n".encode())
    output.close()
    assert screen.getvalue() == b"a | 1 ? 2\n"


def test_health_and_status_count_only_on_exactly_their_key() -> None:
    watcher = HealthWatcher(Instance(vehicle="uav1"), lambda: None)
    health = encode(ServiceHealth(t_ns=0, service="router", boot_id=1, state="ok", text="fine"))
    ready = Status(
        t_ns=0, code=0, name="IDLE", armed=False, landed=True, in_charge="none", bridge_boot_id=1, ready=True
    )
    status = encode(ready)
    for key in ("jezero/**", "jezero/uav1/health/*", "jezero/uav1/health/go_to", "jezero/uav2/health/router"):
        watcher._on_health(sample_of(key, health))
    for key in ("jezero/**", "jezero/uav1/*", "jezero/uav2/status"):
        watcher._on_status(sample_of(key, status))
    watcher._on_status(sample_of("jezero/uav1/status", status, zenoh.SampleKind.DELETE))
    assert watcher.report("router").text == "" and not watcher.vehicle_ready[0]
    watcher._on_health(sample_of("jezero/uav1/health/router", health))
    watcher._on_status(sample_of("jezero/uav1/status", status))
    assert watcher.report("router").text == "fine" and watcher.vehicle_ready[0]


def test_a_default_within_a_default_is_refused_rather_than_misread() -> None:
    with pytest.raises(ComposeError, match=r"services\.a\.command: malformed variable, or one within another"):
        parse("services: {a: {command: 'echo ${A:-${B:-x}}'}}", {"B": "b"})
