"""Which topics cross the links between computers, and at what rate: the column `link_hz` of the topic table.

Within a computer every message passes. A link to another computer may be a radio that carries a thousandth of that.
What comes in over one link is limited too, so that no member of the team keeps a service from serving the others.

Source: https://zenoh.io/docs/manual/downsampling.
"""

import socket
from collections.abc import Iterable, Mapping
from typing import Any

from jezero.router_address import is_insecure
from jezero.schemas.rows import CLIENTS
from jezero.schemas.topics import (
    ENDPOINTS,
    EVERY_ACTION_FEEDBACK,
    TOPICS,
    UNKNOWN_ACTION,
    health_of,
    journal_of,
    key,
)

LOOPBACK = "lo"
COMMANDS_MAX_HZ, QUESTIONS_MAX_HZ, MESSAGES_MAX_HZ = 50.0, 200.0, 200.0
"""Greatest rates on each key at which a link brings in requests with an effect, requests without one, and messages.
People and their scripts stay far below."""


def link_rules(vehicle: str, links: Iterable[str]) -> list[dict[str, Any]]:
    """Zenoh's setting `downsampling` of a router.

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
