"""Opens Zenoh's routers: the one for the programs of a computer, and its gate to other computers."""

import re
import socket
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import zenoh

from jezero.base.files import describe_os_error
from jezero.base.router_address import is_insecure, is_loopback, parse_router, shown_router
from jezero.base.zenoh_client import LINK_SETTINGS, RETRY, config_of
from jezero.keys.bundle import members_of
from jezero.keys.diagnosis import listening_problem
from jezero.keys.members import KeysError
from jezero.keys.rights import EVERY_VEHICLE, access_control, local_access_control
from jezero.runtime.instance import LISTEN_VARIABLE, PREFIX, HostLinks, make_socket_folder
from jezero.runtime.linux_processes import listen_problem, port_holder, unix_listener
from jezero.schemas.rows import CLIENTS
from jezero.schemas.topics import (
    CAMERA,
    ENDPOINTS,
    EVERY_ACTION_FEEDBACK,
    KEYS,
    TOPICS,
    UNKNOWN_ACTION,
    health_of,
    journal_of,
    key,
)

ROUTER_SETTINGS: Mapping[str, Any] = {
    **LINK_SETTINGS,
    "mode": "router",
    "listen/timeout_ms": 0,  # a port that is taken is an error at once
    "listen/exit_on_failure": True,
    "connect/timeout_ms": -1,  # a router works without the others, and goes on trying to connect to them
    "connect/exit_on_failure": False,
    "connect/retry": RETRY,
    # A reply waits this long in us for a reader that doesn't take it, then the reader's link is closed. The action
    # server that replies can't send setpoints meanwhile, and a setpoint counts for 0.3 s. The default is 5 s.
    "transport/link/tx/queue/congestion_control/block/wait_before_close": 200_000,
    # Room for a picture of 0.9 MB that waits for a slow radio, in batches of 64 kB. With the default of 2 the action
    # server that sends it would wait.
    "transport/link/tx/queue/size/data_low": 16,
    "scouting/delay": 0,  # nothing is scouted; the default waits 0.5 s for it
}
"""Zenoh's settings of every router."""
SIZE_MAX_BYTES = 8_000_000
"""A larger message is dropped. The largest of the contract is a result of 4 MB, besides frames of a large camera."""
SIZED = (
    *(topic.name for topic in TOPICS if topic is not CAMERA),
    *("action/**", "health/**", "journal/**", "viewer/**"),
    *(name for name in KEYS if name.startswith("@")),
)
"""Names of the keys on which the size of messages is limited."""
LOOPBACK = "lo"
COMMANDS_MAX_HZ, QUESTIONS_MAX_HZ, MESSAGES_MAX_HZ = 50.0, 200.0, 200.0
"""Greatest rates on each key at which a link brings in requests with an effect, requests without one, and messages.
People and their scripts stay far below."""


class ListenError(RuntimeError):
    """The router can't listen on its endpoint; the message names it and the reason."""


def open_router(endpoint: str, socket: str) -> zenoh.Session:
    """Open the router for the programs of this computer.

    Args:
        endpoint: Zenoh's endpoint for people's programs, which have the rights of a pilot.
        socket: Zenoh's endpoint of the Unix socket for the services.

    Raises:
        ListenError: `check_local` says no, a port is taken or forbidden for this user, this machine doesn't have the
            address, or the socket can't be made.
    """
    check_local(endpoint)
    try:
        make_socket_folder(socket)
    except OSError as error:
        raise ListenError(f"no socket for the services: {describe_os_error(error)}") from None
    settings = {
        "listen/endpoints": [endpoint, socket],
        "access_control": local_access_control(),
        "low_pass_filter": [_size(EVERY_VEHICLE)],
    }
    return _open(settings, (endpoint,), "JEZERO_ROUTER")


def open_gate(router: str, vehicle: str, links: HostLinks) -> zenoh.Session:
    """Open the router between other computers and that of this one, with the rights of the team's members.

    Args:
        router: Zenoh's endpoint of the router of this computer's own programs.
        vehicle: name of the vehicle within the keys.
        links: links with other computers.

    Raises:
        ListenError: a port is taken or forbidden for this user, this machine doesn't have the address, nobody would
            take the certificate of the bundle, or the list of the team's members is missing.
    """
    if problem := next(filter(None, map(listening_problem, links.listen)), ""):
        raise ListenError(problem)
    outside = (*links.listen, *links.connect)
    settings = {
        "listen/endpoints": list(links.listen),
        "connect/endpoints": [router, *links.connect],
        "downsampling": link_rules(vehicle, outside),
        "low_pass_filter": [_size(vehicle)],
    }
    if with_keys := [each for each in outside if parse_router(each).protocol == "tls"]:
        try:
            settings["access_control"] = access_control(vehicle, members_of(with_keys[0]))
        except KeysError as error:
            raise ListenError(str(error)) from None
    return _open(settings, links.listen, LISTEN_VARIABLE)


def link_rules(vehicle: str, links: Iterable[str]) -> list[dict[str, Any]]:
    """Zenoh's setting `downsampling` of a router.

    Within a computer every message passes. A link to another computer may be a radio that carries a thousandth of
    that. What comes in over one link is limited too, so that no member of the team keeps a service from serving the
    others. Source: https://zenoh.io/docs/manual/downsampling.

    Args:
        vehicle: name of the vehicle within the keys.
        links: endpoints at which the router listens to other computers, or connects to their routers.
    """
    limits = (
        _limit("put", "egress", vehicle, _rates_out_hz()),
        _limit("put", "ingress", vehicle, _written_hz()),
        _limit("query", "ingress", vehicle, _asked_hz()),
    )
    rules = [{**limit, "id": f"{limit['id']} with TLS", "link_protocols": ["tls"]} for limit in limits]
    if any(map(is_insecure, links)):  # the programs of this computer use the same protocol, on the loopback
        others = [name for _, name in socket.if_nameindex() if name != LOOPBACK]
        without = {"link_protocols": ["tcp"], "interfaces": others}
        rules += [{**limit, "id": f"{limit['id']} without TLS", **without} for limit in limits]
    return rules


def _rates_out_hz() -> dict[str, float]:
    """Greatest rates of the topics that don't cross with each message."""
    topics = (*TOPICS, EVERY_ACTION_FEEDBACK, journal_of("*"))
    rates_hz = {topic.name: topic.link_hz for topic in topics if topic.link_hz is not None}
    # Each computer has its own router and gate, whose health is of no use to others.
    return rates_hz | {health_of(name).name: 0.0 for name in ("router", "gate")}


def _written_hz() -> dict[str, float]:
    """Greatest rates of the topics that other computers may write."""
    return {topic.name: MESSAGES_MAX_HZ for topic in TOPICS if topic.writer == CLIENTS or topic.host == "rover"}


def _asked_hz() -> dict[str, float]:
    """Greatest rates of requests to each endpoint; the key of `UNKNOWN_ACTION` has those of all actions."""
    return {
        endpoint.name: QUESTIONS_MAX_HZ if endpoint.asker == "viewer" else COMMANDS_MAX_HZ
        for endpoint in ENDPOINTS
        if endpoint is not UNKNOWN_ACTION
    }


def _limit(message: str, flow: str, vehicle: str, rates_hz: Mapping[str, float]) -> dict[str, Any]:
    return {
        "id": f"{message} {flow}",
        "messages": [message],
        "flows": [flow],
        "rules": [{"key_expr": key(vehicle, name), "freq": hz} for name, hz in rates_hz.items()],
    }


def _size(vehicle: str) -> dict[str, Any]:
    """The rule by which larger messages than any of the contract are dropped."""
    return {
        "id": "size",
        "messages": ["put", "query", "reply"],
        "flows": ["ingress"],
        "key_exprs": [key(vehicle, name) for name in SIZED],
        "size_limit": SIZE_MAX_BYTES,
    }


def _open(settings: Mapping[str, Any], listen: Sequence[str], variable: str) -> zenoh.Session:
    try:
        return zenoh.open(config_of({**ROUTER_SETTINGS, **settings}))
    except zenoh.ZError as error:
        problem = next(filter(None, (router_problem(each, variable) for each in listen)), "")
        raise ListenError(problem or f"cannot listen on {shown(listen)}: {_reason(error)}") from error


def router_problem(endpoint: str, variable: str = "JEZERO_ROUTER") -> str:
    """Why no router can listen on an endpoint now, in one sentence, or "".

    Args:
        endpoint: Zenoh's endpoint.
        variable: environment variable that has the address.

    Raises:
        ValueError: the endpoint's syntax is wrong.
    """
    protocol, host, port = parse_router(endpoint)
    if not host:
        return ""
    return listening_problem(endpoint) or listen_problem("udp" if protocol == "udp" else "tcp", host, port, variable)


def check_local(endpoint: str) -> None:
    """Check the address for the programs of the router's own computer, on which nothing is left out.

    Raises:
        ListenError: other computers reach it, or it has TLS.
    """
    protocol, host, _ = parse_router(endpoint)
    if host and (protocol == "tls" or not is_loopback(host)):
        raise ListenError(
            f"JEZERO_ROUTER is {shown_router(endpoint)}, but the programs of this computer need an address on its "
            "loopback, such as tcp/127.0.0.1:7447. Give the address for other computers with --listen or JEZERO_LISTEN"
        )


def bus_of_router(router: str) -> str:
    """The socket for services of a router that runs; "" if none is known, as of another user's router.

    Args:
        router: its address for people's programs, or the socket itself.
    """
    if router.startswith(PREFIX):
        return router
    protocol, host, port = parse_router(router)
    holder = port_holder("tcp", port) if protocol == "tcp" and is_loopback(host) else None
    path = "" if holder is None else unix_listener(holder)
    return f"{PREFIX}{path}" if path else ""


def shown(endpoints: Iterable[str]) -> str:
    """Endpoints for people: without the files of their bundles."""
    return " and ".join(map(shown_router, endpoints))


def _reason(error: zenoh.ZError) -> str:
    """Zenoh's reason without the places in its source."""
    known = re.search(r"([A-Z][\w ]+) \(os error \d+\)", str(error))
    return known[1] if known else str(error).split(" at /", maxsplit=1)[0]
