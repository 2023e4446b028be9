"""What each member of a team may do on a router, as Zenoh's access control has it: made from the topic table.

Everything that is not allowed here is denied. A rule holds for a link, so that a computer's router has the rights of
its own certificate, whoever is behind it: it must give its own clients no more than theirs.

Sources: the topic table; https://zenoh.io/docs/manual/access-control. Zenoh compares keys by inclusion, and `**` stops
at a chunk that begins with `@`: so each of those needs a key of its own.
"""

from collections.abc import Iterable, Iterator, Mapping
from fnmatch import fnmatchcase
from typing import Any

from jezero.keys.members import Members, Role
from jezero.schemas.rows import CLIENTS, Rank
from jezero.schemas.topics import ENDPOINTS, KEYS, TOPICS, health_of, journal_of, key

RANK_OF: Mapping[Role, Rank] = {
    "vehicle": "service",
    "ground": "pilot",
    "pilot": "pilot",
    "rover": "viewer",
    "viewer": "viewer",
}
"""What each role may read and ask. A ground computer has a pilot's rights, because pilots are its clients."""
RANKS: tuple[Rank, ...] = ("viewer", "pilot", "service")
ALL_MESSAGES = (
    "put", "delete", "declare_subscriber", "query", "declare_queryable", "reply",
    "liveliness_token", "liveliness_query", "declare_liveliness_subscriber",
)  # fmt: skip
BOTH, IN, OUT = ("ingress", "egress"), ("ingress",), ("egress",)
PLAIN_LINKS = "plain links"
"""Subject of the links without TLS, which only programs of the router's own computer have."""


def asked_by(role: Role) -> tuple[str, ...]:
    """Names of the endpoints to which a role may send requests."""
    return tuple(endpoint.name for endpoint in ENDPOINTS if _may(role, endpoint.asker)) + _asked_of_packages(role)


def hidden_from(role: Role) -> tuple[str, ...]:
    """Names of the topics to which a role may not subscribe: with a setpoint's control id anybody could fly."""
    topics = (*TOPICS, journal_of("*"))
    return tuple(topic.name for topic in topics if not _may(role, topic.reader))


def written_by(role: Role) -> tuple[str, ...]:
    """Names of the topics on which a role may publish; "**" for all."""
    if role == "vehicle":
        return ("**",)
    if role == "rover":
        return (*(topic.name for topic in TOPICS if topic.host == "rover"), health_of("rover").name)
    if RANK_OF[role] == "pilot":
        return tuple(topic.name for topic in TOPICS if topic.writer == CLIENTS)
    return ()


def may_send(role: Role, name: str) -> bool:
    """Whether a role may send a request to an endpoint or publish on a topic, by its name."""
    return any(fnmatchcase(name, allowed) for allowed in (*asked_by(role), *written_by(role)))


def access_control(vehicle: str, members: Members) -> dict[str, Any]:
    """Zenoh's setting `access_control` of a router.

    Args:
        vehicle: name of the vehicle within the keys.
        members: the team; those that are revoked may do nothing.
    """
    named: dict[str, list[str]] = {role: list(members.allowed(role)) for role in RANK_OF}
    roles: list[Role] = [role for role in RANK_OF if named[role]]
    rules = {role: list(_rules(vehicle, role)) for role in {*roles, "vehicle"}}
    subjects = [{"id": role, "cert_common_names": named[role]} for role in roles]
    policies = [{"rules": [rule["id"] for rule in rules[role]], "subjects": [role]} for role in roles]
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [rule for each in rules.values() for rule in each],
        "subjects": [*subjects, {"id": PLAIN_LINKS, "link_protocols": ["tcp", "unixsock-stream"]}],
        "policies": [*policies, {"rules": [rule["id"] for rule in rules["vehicle"]], "subjects": [PLAIN_LINKS]}],
    }


def _rules(vehicle: str, role: Role) -> Iterator[dict[str, Any]]:
    """The rules of a role; its services of the vehicle itself may do everything."""

    def rule(name: str, messages: Iterable[str], flows: Iterable[str], names: Iterable[str]) -> dict[str, Any]:
        return {
            "id": f"{role}: {name}",
            "permission": "allow",
            "messages": list(messages),
            "flows": list(flows),
            "key_exprs": [key(vehicle, each) for each in names],
        }

    alive = ("@alive/**",)
    if role == "vehicle":
        yield rule("all", ALL_MESSAGES, BOTH, KEYS)
        return
    yield rule("subscribes", ("declare_subscriber", "query"), IN, ("**",))
    # The router of a computer has to know who replies; a program sends its request to its router in any case.
    yield rule("hears", ("put", "reply", "declare_queryable"), OUT, ("**",))
    yield {**rule("hears no secrets", ("put",), OUT, hidden_from(role)), "permission": "deny"}
    yield rule("asks", ("query",), IN, asked_by(role))
    yield rule("gets replies", ("reply", "declare_queryable"), OUT, asked_by(role))
    yield rule("sees who is there", ("declare_liveliness_subscriber", "liveliness_query"), IN, alive)
    yield rule("hears who is there", ("liveliness_token",), OUT, alive)
    yield rule("is there", ("liveliness_token",), IN, (f"@alive/{kind}/**" for kind in _tokens_of(role)))
    if written_by(role):
        yield rule("publishes", ("put",), IN, written_by(role))
        yield rule("is heard", ("declare_subscriber",), OUT, written_by(role))


def _may(role: Role, rank: Rank) -> bool:
    return RANKS.index(RANK_OF[role]) >= RANKS.index(rank)


def _tokens_of(role: Role) -> tuple[str, ...]:
    return ("client", "service/rover", "claim/rover") if role == "rover" else ("client",)


def _asked_of_packages(role: Role) -> tuple[str, ...]:
    """Endpoints of actions that packages add, which the table of this computer may not have."""
    return ("@action/**",) if _may(role, "pilot") else ("@action/*/image",)
