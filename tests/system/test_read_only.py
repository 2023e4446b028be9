"""A stack as in its containers: without capabilities, on a file system that is read-only but for its run folder."""

import subprocess
from dataclasses import replace
from pathlib import Path

import pytest

from jezero import Vehicle
from tests.system.conftest import Stack, wait_for

TIMEOUT_S = 120.0
CONTAINER = """
set -e
mount --make-rprivate /
mount --bind "$RUN" "$RUN"
mount -t tmpfs tmpfs "$HOME"
for place in $(awk '{print $2}' /proc/mounts | sort -u); do
    case "$place" in "$RUN"|"$HOME"|/proc*|/sys*|/dev*) continue;; esac
    mount -o remount,bind,ro "$place" 2>/dev/null || true
done
exec setpriv --no-new-privs --bounding-set=-all --inh-caps=-all -- "$@"
"""
"""Runs a command as compose.yaml has it: `read_only`, `tmpfs`, `cap_drop` and `no-new-privileges`."""
BEFORE = ("unshare", "--user", "--map-root-user", "--mount", "sh", "-c", CONTAINER, "sh")


@pytest.mark.whole
def test_it_flies_and_writes_nowhere_else(unstarted: Stack, tmp_path: Path) -> None:
    home = tmp_path / "home"
    home.mkdir()
    unstarted.run_dir.mkdir(mode=0o700)
    environment = unstarted.environment | {
        "HOME": str(home), "RUN": str(unstarted.run_dir), "TMPDIR": str(home), "JEZERO_GROUND": "1"
    }  # fmt: skip
    stack = replace(unstarted, before=BEFORE, environment=environment)
    probe = ["sh", "-c", f"touch {tmp_path}/outside || echo refused"]
    tried = subprocess.run([*BEFORE, *probe], env=environment, capture_output=True, text=True, check=False)
    if tried.stdout.strip() != "refused":
        pytest.skip(f"this machine makes no read-only file system for a test: {tried.stderr.strip()}")
    try:
        stack.up()
        with Vehicle.connect(stack.instance.vehicle, router=stack.instance.router) as vehicle:
            vehicle.wait_ready(TIMEOUT_S)
            vehicle.takeoff(altitude_m=2.0).result(timeout_s=TIMEOUT_S)
        wait_for(lambda: list((stack.run_dir / "recordings").glob("*.mcap")), TIMEOUT_S, "a recording")
        logs = {log.name: log.read_text() for log in (stack.run_dir / "logs").iterdir()}
        assert not [name for name, text in logs.items() if "Read-only file system" in text or "Traceback" in text]
    finally:
        unstarted.jezero("down", check=False)
