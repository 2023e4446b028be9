"""What each program may do on a router, as Zenoh's access control has it: made from the topic table.

Everything that is not allowed here is denied. A rule holds for a link. On the router of a computer's own programs the
kind of the link decides: its Unix socket, which the kernel opens to this user alone, has the rights of the services,
and TCP those of a pilot. At the gate the certificate decides, so that the computer behind a link has the rights of its
certificate, whoever is on it: it must give its own clients no more than theirs.

Sources: the topic table; https://zenoh.io/docs/manual/access-control. Zenoh compares keys by inclusion, and `**` stops
at a chunk that begins with `@`: so each of those needs a key of its own.
"""

from collections.abc import Iterable, Iterator, Mapping
from fnmatch import fnmatchcase
from typing import Any

from jezero.keys.members import HOST_ROLES, Members, Role
from jezero.schemas.rows import CLIENTS, Rank
from jezero.schemas.topics import ENDPOINTS, EVERY_LINK, KEYS, TOPICS, health_of, key

RANK_OF: Mapping[Role, Rank] = {
    "vehicle": "service",
    "ground": "pilot",
    "pilot": "pilot",
    "rover": "viewer",
    "viewer": "viewer",
}
"""What each role may ask. A ground computer has a pilot's rights, because pilots are its clients."""
RANKS: tuple[Rank, ...] = ("viewer", "pilot", "service")
ALL_MESSAGES = (
    "put", "delete", "declare_subscriber", "query", "declare_queryable", "reply",
    "liveliness_token", "liveliness_query", "declare_liveliness_subscriber",
)  # fmt: skip
ROVER_SERVICES = ("rover", "rover_driver")
"""Services of the rover's computer."""
BOTH, IN, OUT = ("ingress", "egress"), ("ingress",), ("egress",)
EVERY_VEHICLE = "*"
"""The router of a computer's own programs may serve several vehicles."""


def asked_by(role: Role) -> tuple[str, ...]:
    """Names of the endpoints to which a role may send requests."""
    return tuple(endpoint.name for endpoint in ENDPOINTS if _may(role, endpoint.asker)) + _asked_of_packages(role)


def written_by(role: Role) -> tuple[str, ...]:
    """Names of the topics on which a role may publish; "**" for all."""
    if role == "vehicle":
        return ("**",)
    if role == "rover":
        return (
            *(topic.name for topic in TOPICS if topic.host == "rover"),
            *(health_of(name).name for name in ROVER_SERVICES),
        )
    if RANK_OF[role] == "pilot":
        return tuple(topic.name for topic in TOPICS if topic.writer == CLIENTS)
    return ()


def may_send(role: Role, name: str) -> bool:
    """Whether a role may send a request to an endpoint or publish on a topic, by its name."""
    return any(fnmatchcase(name, allowed) for allowed in (*asked_by(role), *written_by(role)))


def local_access_control() -> dict[str, Any]:
    """Zenoh's setting `access_control` of the router of a computer's own programs."""
    services = {"id": "services", "link_protocols": ["unixsock-stream"]}
    people = {"id": "people", "link_protocols": ["tcp"]}
    return _access_control(EVERY_VEHICLE, (("vehicle", services), ("pilot", people)))


def access_control(vehicle: str, members: Members) -> dict[str, Any]:
    """Zenoh's setting `access_control` of the gate to other computers.

    Args:
        vehicle: name of the vehicle within the keys.
        members: the team; those that are revoked may do nothing.
    """
    named: dict[Role, list[str]] = {role: list(members.allowed(role)) for role in RANK_OF}
    subjects: list[tuple[Role, dict[str, Any]]] = [
        (role, {"id": role, "cert_common_names": names}) for role, names in named.items() if names
    ]
    # Its link with the router of its own computer, and those that a person has opened without TLS.
    plain = {"id": "plain links", "link_protocols": ["tcp", "unixsock-stream"]}
    return _access_control(vehicle, (*subjects, ("vehicle", plain)))


def _access_control(vehicle: str, subjects: Iterable[tuple[Role, dict[str, Any]]]) -> dict[str, Any]:
    """Access control by which each subject has the rights of a role."""
    subjects = tuple(subjects)
    rules = {role: list(_rules(vehicle, role)) for role in {role for role, _ in subjects}}
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [rule for each in rules.values() for rule in each],
        "subjects": [subject for _, subject in subjects],
        "policies": [
            {"rules": [rule["id"] for rule in rules[role]], "subjects": [subject["id"]]} for role, subject in subjects
        ],
    }


def _rules(vehicle: str, role: Role) -> Iterator[dict[str, Any]]:
    """The rules of a role; the services of the vehicle itself may do everything."""

    def rule(name: str, messages: Iterable[str], flows: Iterable[str], keys: Iterable[str]) -> dict[str, Any]:
        return {
            "id": f"{role}: {name}",
            "permission": "allow",
            "messages": list(messages),
            "flows": list(flows),
            "key_exprs": list(keys),
        }

    def of_vehicle(names: Iterable[str]) -> list[str]:
        return [key(vehicle, name) for name in names]

    if role == "vehicle":
        yield rule("all", ALL_MESSAGES, BOTH, ("**", *of_vehicle(KEYS)))
        return
    alive, asked, written = of_vehicle(("@alive/**",)), of_vehicle(asked_by(role)), of_vehicle(written_by(role))
    yield rule("subscribes", ("declare_subscriber", "query"), IN, ("**",))
    # The router of a computer has to know who replies; a program sends its request to its router in any case.
    yield rule("hears", ("put", "reply", "declare_queryable"), OUT, ("**",))
    yield rule("asks", ("query",), IN, asked)
    yield rule("gets replies", ("reply", "declare_queryable"), OUT, asked)
    yield rule("sees who is there", ("declare_liveliness_subscriber", "liveliness_query"), IN, alive)
    yield rule("hears who is there", ("liveliness_token",), OUT, alive)
    if tokens := _tokens_of(role):
        yield rule("is there", ("liveliness_token",), IN, of_vehicle(f"@alive/{kind}/**" for kind in tokens))
    if written:
        yield rule("publishes", ("put",), IN, written)
        yield rule("is heard", ("declare_subscriber",), OUT, written)
    if role in HOST_ROLES:
        messages = ("put", "declare_subscriber", "query", "declare_queryable", "reply")
        yield rule("checks links", messages, BOTH, of_vehicle((EVERY_LINK.name,)))


def _may(role: Role, rank: Rank) -> bool:
    return RANKS.index(RANK_OF[role]) >= RANKS.index(rank)


def _tokens_of(role: Role) -> tuple[str, ...]:
    """Kinds of the liveliness tokens that a role may declare; a viewer needs none, as it has no goals."""
    if role == "rover":
        return ("client", *(f"service/{name}" for name in ROVER_SERVICES))
    return ("client",) if _may(role, "pilot") else ()


def _asked_of_packages(role: Role) -> tuple[str, ...]:
    """Endpoints of actions that packages add, which the table of this computer may not have."""
    return ("@action/**",) if _may(role, "pilot") else ("@action/*/image",)
