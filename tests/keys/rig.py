"""A team, strangers, and routers that speak TLS on free loopback ports."""

import socket
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import zenoh

from jezero.base.zenoh_client import config_of
from jezero.keys.bundle import secured
from jezero.keys.members import Role
from jezero.keys.team import Team
from jezero.runtime.routing import ROUTER_SETTINGS


def make_team(folder: Path) -> Team:
    """A team with a vehicle that others reach as `127.0.0.2`, a ground station and two pilots."""
    team = Team(folder)
    team.found()
    team.add("vehicle", "uav1", ["127.0.0.2"])
    team.add("ground", "lab")
    team.add("pilot", "ana")
    team.add("pilot", "bo")
    team.add("viewer", "eye")
    return team


def add_at(team: Team, days_from_now: int, role: Role, name: str) -> Path:
    """A bundle made at another time, valid for a year from then."""
    then = Team(team.folder, datetime.now(UTC) + timedelta(days=days_from_now))
    return then.bundle(then.add(role, name).name)


TRIES = 5


def free_port() -> int:
    """A port that is free on all addresses of this computer."""
    with socket.socket() as probe:
        probe.bind(("0.0.0.0", 0))
        return int(probe.getsockname()[1])


@contextmanager
def router(
    bundle: Path, settings: Mapping[str, Any] | None = None, port: int | None = None
) -> Iterator[tuple[int, zenoh.Session]]:
    """A router that listens with a bundle on all addresses of the loopback; its port and session."""
    port, session = _listening(bundle, settings or {}, port)
    with session:
        yield port, session


def _listening(bundle: Path, settings: Mapping[str, Any], port: int | None) -> tuple[int, zenoh.Session]:
    """Open a router at a port, or at a free one: another process may take that between its choice and its use."""
    for tries_left in reversed(range(TRIES)):
        chosen = port or free_port()
        endpoint = secured(f"tls/0.0.0.0:{chosen}", bundle)
        try:
            return chosen, zenoh.open(config_of({**ROUTER_SETTINGS, "listen/endpoints": [endpoint], **settings}))
        except zenoh.ZError:
            if port is not None or not tries_left:
                raise
    raise AssertionError("unreachable")


def access_control(allowed: tuple[str, ...], keys: str) -> dict[str, Any]:
    """Zenoh's settings with which these members alone put and subscribe, to these keys."""
    rule = {
        "id": "all", "permission": "allow", "flows": ["ingress", "egress"], "key_exprs": [keys],
        "messages": ["put", "declare_subscriber"],
    }  # fmt: skip
    settings = {
        "enabled": True,
        "default_permission": "deny",
        "rules": [rule],
        "subjects": [{"id": "members", "cert_common_names": list(allowed)}],
        "policies": [{"rules": ["all"], "subjects": ["members"]}],
    }
    return {"access_control": settings}
