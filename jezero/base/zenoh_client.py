"""The side of Zenoh that services and clients share: settings of a session, and how a message travels."""

import json
from collections.abc import Mapping
from typing import Any

import zenoh

from jezero.base.codec import join_attachment, split_attachment

LINK_SETTINGS: Mapping[str, Any] = {
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "transport/link/tx/lease": 2000,  # ms until a frozen process is noticed; the default takes 10 s
    "transport/link/tx/keep_alive": 4,
}
"""Settings of the router and of everybody else: one link to the router, found by its address alone."""
RETRY = {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 2}
"""When a lost connection is tried again."""
FIRST, LAST = zenoh.Priority.INTERACTIVE_HIGH, zenoh.Priority.DATA_LOW
"""Priorities of the messages that wait for a link: commands and status go first, pictures and journals last."""


def config_of(settings: Mapping[str, Any]) -> zenoh.Config:
    """Zenoh's configuration from values by their path in it; all others keep Zenoh's defaults."""
    config = zenoh.Config()
    for path, value in settings.items():
        config.insert_json5(path, json.dumps(value))
    return config


def client_config(router: str, timeout_s: float | None = None) -> zenoh.Config:
    """Settings of a service or a client: one connection to the router.

    Args:
        timeout_s: duration after which opening a session fails without a router; None waits for it without limit.
    """
    settings = {
        "mode": "client",
        "connect/endpoints": [router],
        "connect/timeout_ms": -1 if timeout_s is None else int(1000 * timeout_s),
        "connect/exit_on_failure": timeout_s is not None,
        "connect/retry": RETRY,
    }
    return config_of({**LINK_SETTINGS, **settings})


def data_of(sample: zenoh.Sample) -> bytes:
    """A message in one piece, as the codec reads it.

    On Zenoh a message's attachment is the payload and its JSON is Zenoh's attachment; others are JSON alone.
    """
    header, payload = sample.attachment, sample.payload.to_bytes()
    return payload if header is None else join_attachment(header.to_bytes(), payload)


def declare_publisher(
    session: zenoh.Session, name: str, *, attached: bool, congestion: zenoh.CongestionControl, urgent: bool = False
) -> zenoh.Publisher:
    """A publisher of the messages of one key.

    Args:
        name: the whole key.
        attached: whether its messages have attachments.
        congestion: what happens to a message that a reader doesn't take in time.
        urgent: whether its messages go first on a link that has no room for all.
    """
    return session.declare_publisher(
        name,
        encoding=zenoh.Encoding.APPLICATION_OCTET_STREAM if attached else zenoh.Encoding.APPLICATION_JSON,
        congestion_control=congestion,
        priority=FIRST if urgent else LAST if attached else zenoh.Priority.DATA,
    )


def put(publisher: zenoh.Publisher, data: bytes, *, attached: bool) -> None:
    """Publish a message that is in one piece, as the codec writes it; see `data_of`."""
    if attached:
        json_data, attachment = split_attachment(data)
        publisher.put(attachment, attachment=json_data)
    else:
        publisher.put(data)
