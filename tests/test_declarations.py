"""The declarations of the services, the tables of services and topics, the compose file and the docs agree."""

import re
from pathlib import Path
from typing import Any

import click
import pytest

from jezero.base import plugins
from jezero.cli.info import PAGES, reference_page
from jezero.cli.reference.settings import FILES
from jezero.cli.reference.topics import all_specs, all_topics
from jezero.cli.stack import up
from jezero.deploy.launcher.compose import parse
from jezero.runtime.service import Spec
from jezero.schemas.commands import Phase
from jezero.schemas.goals import GoToGoal, MoveFeedback, MoveResult
from jezero.schemas.rows import CLIENTS, EVERY_ACTION, GOAL_IN_CHARGE, Action, Endpoint, Topic
from jezero.schemas.topics import ACTIONS, ENDPOINTS, GROUND, SCENE, TRUTH, health_of
from jezero.services.table import ServiceRow, services

ROOT = Path(__file__).parents[1]
SPECS = all_specs()
COMPOSED = parse((ROOT / "deploy" / "compose.yaml").read_text(), {"JEZERO_GATE": "1", "JEZERO_CAMERA": "1"})


@pytest.mark.parametrize("topic", all_topics(), ids=lambda topic: topic.name)
def test_a_topic_is_published_by_its_writer_and_by_nobody_else(topic: Topic[Any]) -> None:
    writers = {name for name, spec in SPECS.items() if topic in spec.outputs}
    named = topic.writer
    if named == GOAL_IN_CHARGE:
        assert writers
        assert writers <= set(ACTIONS)
    else:
        stand_in = {"rover"} if topic.host == "rover" else set()  # the rover's computer takes its topics over
        own_process = {topic.driver} - {"", "vehicle_bridge"}  # the bridge publishes for real vehicles only
        assert writers == (set() if named == CLIENTS else {named, *stand_in, *own_process})


@pytest.mark.parametrize("endpoint", ENDPOINTS, ids=lambda endpoint: endpoint.name)
def test_an_endpoint_is_served_by_the_service_that_the_table_names(endpoint: Endpoint[Any, Any]) -> None:
    servers = {name for name, spec in SPECS.items() if endpoint in spec.serves}
    named = endpoint.server
    assert servers == (set(ACTIONS) if named == EVERY_ACTION else {named})


@pytest.mark.parametrize("spec", SPECS.values(), ids=lambda spec: spec.name)
def test_a_service_declares_only_topics_and_endpoints_of_the_table(spec: Spec) -> None:
    healths = {health_of(name) for name in SPECS}
    assert {*spec.inputs, *spec.on_demand, *spec.outputs} <= {*all_topics(), *healths}
    assert {*spec.serves, *spec.calls} <= set(ENDPOINTS)


def test_no_service_that_flies_reads_the_truth() -> None:
    readers = {name: {*spec.inputs, *spec.on_demand} for name, spec in SPECS.items()}
    assert not [name for name, topics in readers.items() if TRUTH in topics]
    assert [name for name, topics in readers.items() if SCENE in topics] == ["camera"]


def test_no_service_asks_the_simulator_for_its_ground() -> None:
    assert not [name for name, spec in SPECS.items() if GROUND in spec.calls]


@pytest.mark.parametrize("name", SPECS)
def test_a_service_declares_the_name_of_its_row(name: str) -> None:
    assert SPECS[name].name == name


def test_the_compose_file_starts_every_service_the_router_and_the_gate() -> None:
    assert set(COMPOSED) == {*SPECS, "router", "gate"}


@pytest.mark.parametrize("row", services().values(), ids=lambda row: row.name)
def test_the_compose_file_runs_a_service_as_its_row_says(row: ServiceRow) -> None:
    composed = COMPOSED[row.name]
    assert composed.command == ("python", "-m", row.module, *([row.name] if row.is_action else []))
    assert composed.profiles == row.profiles


def test_the_help_names_every_profile() -> None:
    (option,) = (each for each in up.params if each.name == "profiles")
    profiles = {profile for row in services().values() for profile in row.profiles}
    assert isinstance(option, click.Option)
    assert profiles == set(re.findall(r"\w+", re.findall(r"\((.*)\)", option.help or "")[0]))


@pytest.mark.parametrize("name", PAGES)
def test_a_reference_page_is_as_the_code_says(name: str) -> None:
    file = f"docs/reference/{name}.md"
    current = (ROOT / file).read_text() == reference_page(name)
    assert current, f"{file} is not as the code says: `jezero info page {name} --own > {file}` writes it anew"


@pytest.mark.parametrize("name", PAGES)
def test_a_reference_page_does_not_change_with_an_installed_package(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    before = reference_page(name)
    monkeypatch.setattr(plugins, "plugin_names", lambda: ("mine",))
    assert "mine" in plugins.action_names()
    assert reference_page(name) == before


def test_the_page_of_actions_can_have_those_of_packages() -> None:
    mine = Action("mine", GoToGoal, MoveFeedback, MoveResult, Phase.ACTION)
    assert "## mine\n" in reference_page("actions", {**ACTIONS, "mine": mine})


def test_a_reference_page_gives_every_settings_file() -> None:
    assert set(FILES) == {path.stem for path in (ROOT / "deploy" / "config").glob("*.toml")}


@pytest.mark.parametrize(
    "page", ["CONTRIBUTING.md", "docs/glossary.md", "docs/how-to/add-a-sensor.md", "benchmarks/README.md"]
)
def test_every_path_that_a_page_names_exists(page: str) -> None:
    file = ROOT / page
    text = file.read_text()
    folders = "schemas|services|jezero|deploy|tests|benchmarks|docs"
    named = {ROOT / path for path in re.findall(rf"`((?:{folders})/[^`<> ]*)`", text)}
    linked = {file.parent / path for path in re.findall(r"\]\(([^)#:]+)", text)}
    assert not [str(path) for path in named | linked if not path.exists()]


QUOTES = re.findall(
    r"^## [^\n]*\n\n`([^`]+\.py)`(?:(?!^## ).)*?^```python\n(.*?)^```",
    (ROOT / "docs/how-to/add-a-sensor.md").read_text(),
    re.DOTALL | re.MULTILINE,
)
"""The file that begins a section, and the section's code."""


@pytest.mark.parametrize(("file", "code"), QUOTES, ids=[file for file, _ in QUOTES])
def test_the_code_that_the_page_of_a_sensor_quotes_is_in_the_file_that_it_names(file: str, code: str) -> None:
    lines = iter([line.strip() for line in (ROOT / file).read_text().splitlines()])
    missing = [line for line in code.splitlines() if line.strip() not in lines]
    assert not missing, f"{file} doesn't have these lines, or not in this order: {missing}"


def test_every_code_of_the_page_of_a_sensor_is_a_quotation() -> None:
    assert len(QUOTES) == (ROOT / "docs/how-to/add-a-sensor.md").read_text().count("```python")
