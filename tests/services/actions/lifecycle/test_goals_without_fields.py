"""A query without fields starts nothing: it may be no more than a look at the key."""

from typing import Any

import pytest

from jezero.codec import decode
from jezero.runtime.node import Node
from jezero.schemas.actions import Rejected
from jezero.schemas.goals import Goal
from jezero.schemas.topics import ACTIONS
from jezero.services.actions.table import action_server


class Replies:
    """Transport of a node that keeps the replies."""

    def __init__(self) -> None:
        self.replies: list[bytes | None] = []

    def reply(self, request_id: int, data: bytes | None, *, final: bool) -> None:
        self.replies.append(data)


def replies_to(name: str, data: bytes, parameters: dict[str, str]) -> list[Any]:
    """What an action's server replies at once to a request for a goal."""
    action, transport = ACTIONS[name], Replies()
    node = Node(action_server(name, boot_id=1), transport, strict=True, boot_id=1)  # type: ignore[arg-type]
    node.deliver_request(action.endpoint.name, 7, "", data, parameters)
    return [None if reply is None else decode(action.endpoint.reply_type, reply) for reply in transport.replies]


@pytest.mark.parametrize("name", ACTIONS)
@pytest.mark.parametrize(
    ("data", "parameters"),
    [(b"", {}), (b"", {"_time": "[..]"}), (b"{}", {}), (b" {\n}\r\n", {}), (b"\t{ }", {"_target": "ALL"})],
)
def test_a_goal_that_names_no_field_is_refused_with_what_to_write(
    name: str, data: bytes, parameters: dict[str, str]
) -> None:
    (refusal,) = replies_to(name, data, parameters)
    assert isinstance(refusal, Rejected)
    own_fields = set(ACTIONS[name].goal_type.__struct_fields__) - set(Goal.__struct_fields__)
    assert "names no field" in refusal.reason and "or a goal_id" in refusal.reason
    assert any(f"such as {field}" in refusal.reason for field in own_fields)


@pytest.mark.parametrize("name", ["takeoff", "land_on_spot", "return_home"])
@pytest.mark.parametrize(("data", "parameters"), [(b"", {"goal_id": "g"}), (b'{"goal_id": "g"}', {})])
def test_a_goal_id_is_enough_of_a_field(name: str, data: bytes, parameters: dict[str, str]) -> None:
    assert replies_to(name, data, parameters) == []
