"""The table of services: what it names exists, and all that it should list is in it."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from jezero.base.config import Config
from jezero.runtime.instance import Instance
from jezero.services import table
from jezero.services.preflight.checks import LANDING_CHAIN
from jezero.services.preflight.service import checked_services
from jezero.services.table import SERVICES, ServiceRow, make, resolve, services
from jezero.trials.stack import service_makers

FOLDER = Path(__file__).parents[2] / "services"
LOADED = "import json, sys, jezero.services.table; print(json.dumps(list(sys.modules)))"


@pytest.mark.parametrize("row", SERVICES, ids=lambda row: row.name)
class TestRow:
    def test_what_makes_it_and_its_settings_are_found(self, row: ServiceRow) -> None:
        assert callable(resolve(row.maker))
        assert not row.settings or issubclass(resolve(row.settings), Config)

    def test_its_ports_are_those_of_the_instance(self, row: ServiceRow) -> None:
        assert all(1 <= getattr(Instance(), port) <= 65535 for _, port in row.ports)


def test_each_package_that_runs_as_a_process_has_a_row_and_only_those() -> None:
    folders = [path.parent.relative_to(FOLDER) for path in FOLDER.rglob("__main__.py")]
    assert {".".join(("jezero.services", *folder.parts)) for folder in folders} == {row.module for row in SERVICES}


def test_names_are_unique() -> None:
    names = [row.name for row in SERVICES]
    assert len(names) == len(set(names))


def test_the_table_imports_no_service() -> None:
    shown = subprocess.run([sys.executable, "-c", LOADED], capture_output=True, text=True, check=True).stdout
    loaded = [name for name in json.loads(shown) if name.startswith("jezero.services.")]
    assert loaded == ["jezero.services.table"]


def test_an_action_has_a_row_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table, "action_names", lambda: ("spiral",))
    rows = services()
    assert (rows["spiral"].name, rows["spiral"].is_action) == ("spiral", True)
    assert set(rows) == {row.name for row in SERVICES} - {"actions"} | {"spiral"}


def test_what_makes_a_service_gets_the_arguments_that_it_has_as_parameters() -> None:
    (row,) = (row for row in SERVICES if row.name == "rover")
    made: Any = make(row, {"address": "here:1", "seed": 3, "vehicle": None})
    assert made.spec.made_with == {"address": "here:1"}
    with pytest.raises(TypeError, match="address"):
        make(row, {"seed": 3})


def test_the_stack_in_virtual_time_has_the_services_that_fly_and_no_other() -> None:
    makers = service_makers(1)
    assert {"simulator", "autopilot", "vehicle_bridge", "estimator", "takeoff", "preflight", "mission"} <= set(makers)
    assert {"rover", "recorder", "ground_station", "actions"}.isdisjoint(makers)


def test_the_preflight_checks_hear_neither_themselves_nor_services_of_other_computers() -> None:
    checked = checked_services()
    assert {"simulator", "camera", "autopilot", "vehicle_bridge", "estimator", "mission", "recorder"} <= set(checked)
    assert {"preflight", "rover", "ground_station", "actions"}.isdisjoint(checked)


def test_a_landing_needs_services_that_there_are() -> None:
    assert set(services()) >= LANDING_CHAIN
