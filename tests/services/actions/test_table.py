"""The table of actions holds what the contract and the settings declare."""

from typing import Any

import msgspec
import pytest

from jezero.base.config import Config
from jezero.recording.journals import ServiceRun
from jezero.replay.rebuild import SettingError, make_service
from jezero.runtime.journal import class_of
from jezero.schemas.commands import Phase
from jezero.schemas.goals import GoToGoal, MoveFeedback, MoveResult
from jezero.schemas.rows import Action
from jezero.schemas.topics import ACTIONS
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.lifecycle.declaration import ActionDeclaration
from jezero.services.actions.table import PLANNERS, action_server
from jezero.services.actions.takeoff import TakeoffPlanner


def test_every_action_of_the_contract_has_a_planner_and_settings() -> None:
    assert set(PLANNERS) == set(ACTIONS)
    assert set(ACTIONS) <= set(ActionsConfig.__struct_fields__)


class MineConfig(Config, frozen=True, kw_only=True):
    mine_mps: float = 1.0


def test_the_settings_of_a_packages_action_are_recorded_and_replayed(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[MineConfig] = []

    def planner(settings: MineConfig, config: ActionsConfig) -> Any:
        made.append(settings)
        return TakeoffPlanner(config)

    action = Action("mine", GoToGoal, MoveFeedback, MoveResult, Phase.ACTION)
    declaration = ActionDeclaration(action=action, settings=MineConfig, planner=planner)
    monkeypatch.setattr("jezero.services.actions.table.load_declaration", lambda name: declaration)
    recorded = action_server("mine", 5, settings={"mine_mps": 3.0}).spec.made_with
    run = ServiceRun("mine", 5, msgspec.to_builtins(dict(recorded)), class_of(action_server("takeoff", 5)))
    make_service(run, {})
    make_service(run, {"mine_mps": "0.5"})
    assert [settings.mine_mps for settings in made] == [3.0, 3.0, 0.5]
    with pytest.raises(SettingError, match="mine: Expected `float`, got `str`"):
        make_service(run, {"mine_mps": '"fast"'})
    with pytest.raises(SettingError, match="did you mean 'mine_mps'"):
        make_service(run, {"mine_m": "1"})


def test_the_settings_of_jezeros_own_actions_are_recorded_once() -> None:
    assert "settings" not in action_server("takeoff", 5).spec.made_with
