"""What an action server says about its action."""

import pytest

from jezero.schemas.actions import GetDescription
from jezero.schemas.topics import ACTIONS
from tests.services.actions.rig import World


@pytest.mark.parametrize("name", ACTIONS)
def test_a_server_describes_the_goal_the_feedback_and_the_result_of_its_action(name: str) -> None:
    action, world = ACTIONS[name], World()
    request = world.bus.send_request(action.describe, GetDescription())
    assert world.bus.run_for(1.0, lambda: request.ended)
    (description,) = request.replies
    assert (description.name, description.endpoint) == (name, f"@action/{name}")
    for schema, struct in (
        (description.goal, action.goal_type),
        (description.feedback, action.feedback_type),
        (description.result, action.result_type),
    ):
        described = schema["$defs"][schema["$ref"].rsplit("/", 1)[1]]
        assert set(struct.__struct_fields__) <= set(described["properties"])
