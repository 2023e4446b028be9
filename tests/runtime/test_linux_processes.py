"""Ports that are taken, and who has them."""

import os
import shlex
import socket
import subprocess
import sys

import pytest

from jezero.runtime.links import TcpServer, Udp
from jezero.runtime.linux_processes import COMMAND_MAX, listen_problem, port_holder

HOST = "127.0.0.1"


def test_a_free_port_has_no_problem_and_no_holder() -> None:
    with socket.create_server((HOST, 0)) as taken:
        port = taken.getsockname()[1]
    assert listen_problem("tcp", HOST, port, "VARIABLE") == ""
    assert port_holder("tcp", port) is None


@pytest.mark.parametrize("address", [HOST, "0.0.0.0"])
def test_the_holder_of_a_port_is_named_with_its_command(address: str) -> None:
    script = (
        f"import socket; s = socket.create_server(('{address}', 0)); print(s.getsockname()[1], flush=True); input()"
    )
    command = [sys.executable, "-c", script, "the end\x1b"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None
        port = int(other.stdout.readline())
        problem = listen_problem("tcp", HOST, port, "VARIABLE")
        other.communicate("\n")
    begin = f"TCP port {port} of {HOST} is held by process {other.pid} ({shlex.join(command)[: COMMAND_MAX // 2]}…"
    assert problem.startswith(begin)
    assert problem.endswith(" input()' 'the end\N{REPLACEMENT CHARACTER}'): stop that, or set VARIABLE to another one")


def test_links_that_cannot_listen_name_the_port_and_its_holder() -> None:
    me = f"is held by process {os.getpid()} \\(.*JEZERO_INSTANCE"
    with socket.create_server((HOST, 0)) as held:
        port = held.getsockname()[1]
        with pytest.raises(OSError, match=f"TCP port {port} of {HOST} {me}"):
            TcpServer(HOST, port).start()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as held:
        held.bind((HOST, 0))
        port = held.getsockname()[1]
        link = Udp((HOST, port), (HOST, 9))
        with pytest.raises(OSError, match=f"UDP port {port} of {HOST} {me}"):
            link.start()
        link.close()


def test_an_address_of_another_machine_and_an_unknown_host_are_told_apart() -> None:
    assert "Cannot assign requested address; set V to another one" in listen_problem("tcp", "203.0.113.9", 7447, "V")
    unknown = listen_problem("tcp", "no-such-host.invalid", 7447, "V")
    assert unknown.startswith("cannot listen on no-such-host.invalid: ")
