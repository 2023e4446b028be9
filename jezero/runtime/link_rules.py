"""Which topics cross the links between computers, and at what rate: the column `link_hz` of the topic table.

Within a computer every message passes. A link to another computer may be a radio that carries a thousandth of that.

Source: https://zenoh.io/docs/manual/downsampling.
"""

import socket
from collections.abc import Iterable
from typing import Any

from jezero.router_address import is_insecure
from jezero.schemas.topics import EVERY_ACTION_FEEDBACK, TOPICS, health_of, journal_of, key

LOOPBACK = "lo"


def link_rules(vehicle: str, links: Iterable[str]) -> list[dict[str, Any]]:
    """Zenoh's setting `downsampling` of a router.

    Args:
        vehicle: name of the vehicle within the keys.
        links: endpoints at which the router listens to other computers, or connects to their routers.
    """
    # Each computer's router has its own health, which is of no use to others.
    rates_hz = {topic.name: topic.link_hz for topic in (*TOPICS, EVERY_ACTION_FEEDBACK, journal_of("*"))}
    rates_hz[health_of("router").name] = 0.0
    rule = {
        "messages": ["put"],
        "flows": ["egress"],
        "rules": [{"key_expr": key(vehicle, name), "freq": hz} for name, hz in rates_hz.items() if hz is not None],
    }
    rules = [{**rule, "id": "links with TLS", "link_protocols": ["tls"]}]
    if any(map(is_insecure, links)):  # the programs of this computer use the same protocol, on the loopback
        others = [name for _, name in socket.if_nameindex() if name != LOOPBACK]
        rules.append({**rule, "id": "links without TLS", "link_protocols": ["tcp"], "interfaces": others})
    return rules
