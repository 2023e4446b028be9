"""Addresses of the router."""

import pytest

from jezero.base.router_address import RouterAddress, insecurity, is_on_this_computer, parse_router, shown_router


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("tcp/127.0.0.1:7447", ("tcp", "127.0.0.1", 7447)),
        ("tls/rover.local:7447", ("tls", "rover.local", 7447)),
        ("udp/[::1]:65535", ("udp", "::1", 65535)),
        ("tcp/[fe80::1%eth0]:1#iface=eth0", ("tcp", "fe80::1%eth0", 1)),
        ("tcp/0.0.0.0:7447?prio=1", ("tcp", "0.0.0.0", 7447)),
        ("tls/uav1:7447#root_ca_certificate_file=/my keys/ca.pem", ("tls", "uav1", 7447)),
        ("unixsock-stream//tmp/router", ("unixsock-stream", "", 0)),
    ],
)
def test_an_address_has_a_protocol_a_host_and_a_port(text: str, parts: tuple[str, str, int]) -> None:
    assert parse_router(text) == RouterAddress(*parts)


def test_an_address_is_shown_without_the_files_of_its_keys() -> None:
    assert shown_router("tls/uav1:7447#connect_private_key_file=/keys/key.pem") == "tls/uav1:7447"
    assert shown_router("tcp/uav1:7447?prio=1") == "tcp/uav1:7447?prio=1"


@pytest.mark.parametrize(
    "text",
    ["", "127.0.0.1:7447", "tcp/", "tcp/host", "tcp/host:", "tcp/host:x", "tcp/host:0", "tcp/host:65536", "tcp/:7447",
     "tcp//host:7447", "tcp://host:7447", "tcp/::1:7447", "tcp/a b:7447", "http/host:7447", "tcp/host:7447 ",
     "unixsock-stream/"],
)  # fmt: skip
def test_anything_else_is_refused_with_an_example(text: str) -> None:
    with pytest.raises(ValueError, match=r"is no address of a router: write PROTOCOL/HOST:PORT, such as tcp/127"):
        parse_router(text)


@pytest.mark.parametrize(
    ("text", "insecure"),
    [
        ("tcp/127.0.0.1:7447", False),
        ("tcp/[::1]:7447", False),
        ("udp/localhost:7447", False),
        ("unixsock-stream//tmp/router", False),
        ("tls/192.168.1.10:7447", False),
        ("tcp/192.168.1.10:7447", True),
        ("tcp/0.0.0.0:7447", True),
        ("tcp/[::]:7447", True),
        ("udp/uav1.local:7447", True),
        ("tcp/localhost.example.org:7447", True),
    ],
)
def test_an_address_without_tls_is_insecure_where_other_computers_are(text: str, insecure: bool) -> None:
    assert ("whoever is on its network" in insecurity(text)) == insecure


@pytest.mark.parametrize(
    ("text", "is_here"),
    [
        ("unixsock-stream//tmp/router", True),
        ("tcp/localhost:7447", True),
        ("tls/127.0.0.2:7447#root_ca_certificate_file=/keys/ca.pem", True),
        ("tcp/[::1]:7447", True),
        ("tcp/192.168.1.10:7447", False),
        ("tls/uav1.local:7447", False),
    ],
)
def test_a_socket_and_a_loopback_address_are_on_this_computer(text: str, is_here: bool) -> None:
    assert is_on_this_computer(text) == is_here
