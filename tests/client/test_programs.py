"""Whole programs that use the client: what they import, how they exit and how Ctrl+C ends them."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from tests.client.rig import ACCEPTED, Server, endpoint, server

__all__ = ["endpoint", "server"]

PROGRAM = """
import sys
from jezero import Vehicle
uav = Vehicle.connect("v", router=sys.argv[1])
goal = uav.takeoff()
print("accepted", flush=True)
if sys.argv[2] == "wait":
    goal.result()
"""


@contextmanager
def running_program(endpoint: str, word: str) -> "Iterator[subprocess.Popen[str]]":
    program = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, endpoint, word], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    with program:
        try:
            yield program
        finally:
            program.kill()


def test_a_program_that_forgets_to_close_still_exits(server: Server, endpoint: str) -> None:
    server.serve("@action/takeoff", ACCEPTED, end=False)
    with running_program(endpoint, "leave") as program:
        out, err = program.communicate(timeout=10)
    assert (program.returncode, out, err) == (0, "accepted\n", "")


def test_ctrl_c_is_heard_while_waiting_for_a_result(server: Server, endpoint: str) -> None:
    server.serve("@action/takeoff", ACCEPTED, end=False)
    with running_program(endpoint, "wait") as program:
        assert program.stdout is not None
        assert program.stdout.readline() == "accepted\n"
        program.send_signal(2)
        _, err = program.communicate(timeout=10)
    assert "KeyboardInterrupt" in err


def test_the_client_imports_nothing_heavy() -> None:
    code = "import sys, jezero; jezero.Vehicle; print(*sorted(m.split('.')[0] for m in sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=20)
    loaded = set(done.stdout.split())
    assert {"zenoh", "msgspec"} <= loaded
    assert not loaded & {"numpy", "pymavlink", "pybullet", "scipy", "matplotlib", "click", "rich", "asyncio"}


def test_importing_jezero_alone_loads_no_client() -> None:
    code = "import sys, jezero; print('zenoh' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=20)
    assert done.stdout == "False\n"
