"""The table of actions holds what the contract and the settings declare."""

from jezero.schemas.topics import ACTIONS
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.table import DECLARATIONS


def test_every_action_of_the_contract_has_one_declaration() -> None:
    assert {name: declaration.action for name, declaration in DECLARATIONS.items()} == ACTIONS


def test_every_action_declares_the_type_of_its_settings() -> None:
    config = ActionsConfig()
    for name, declaration in DECLARATIONS.items():
        assert type(getattr(config, name)) is declaration.settings
