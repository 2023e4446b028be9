"""The compose file: what is read, in which order it starts, and how mistakes are told."""

from pathlib import Path

import pytest

from jezero import deploy
from jezero.deploy.launcher.compose import ComposeError, in_levels, parse, select
from jezero.schemas import topics

SHIPPED = Path(deploy.__path__[0]) / "compose.yaml"


def test_the_shipped_file_starts_the_router_first_and_what_needs_the_simulator_after_it() -> None:
    services = parse(SHIPPED.read_text(), {})
    levels = in_levels(services)
    assert levels[:2] == [["router"], ["recorder"]]
    assert "simulator" in levels[2]
    assert {"camera", "autopilot", "estimator", "mission", "ground_station", *topics.ACTIONS} <= set(levels[3])
    assert services["autopilot"].depends_on["simulator"] == "service_started"
    assert services["camera"].depends_on["simulator"] == "service_healthy"
    assert services["go_to"].depends_on["simulator"] == "service_healthy"
    assert "simulator" in services["go_to"].optional, "a real vehicle has none"


def test_the_shipped_file_has_a_server_for_every_action() -> None:
    services = parse(SHIPPED.read_text(), {})
    for action in topics.ACTIONS:
        assert services[action].command == ("python", "-m", "jezero.services.actions", action)


def test_every_shipped_service_but_the_router_is_in_a_profile_and_tells_its_health() -> None:
    for name, service in parse(SHIPPED.read_text(), {}).items():
        assert bool(service.profiles) == (name != "router")
        assert service.has_healthcheck
        assert service.restart == "unless-stopped"


def test_profiles_choose_services_and_those_without_one_always_run() -> None:
    services = parse(SHIPPED.read_text(), {})
    assert list(select(services, ["sim"])) == ["router", "simulator", "camera", "autopilot"]
    assert "simulator" not in select(services, ["control"])
    assert select(services).keys() == services.keys() - {"rover", "rover_driver", "uwb"}


def test_the_profiles_of_three_computers_are_the_whole_stack_and_have_no_service_but_the_router_in_common() -> None:
    services = parse(SHIPPED.read_text(), {})
    parts = [set(select(services, profiles)) for profiles in (["onboard", "sim"], ["rover"], ["ground"])]
    assert set().union(*parts) == set(services)
    assert sum(map(len, parts)) == len(services) + 2


def test_an_optional_dependency_may_be_turned_off_or_outside_the_chosen_profiles() -> None:
    text = (
        "services: {log: {command: x, profiles: [p], scale: $LOG},"
        " a: {command: x, profiles: [p, q], depends_on: {log: {condition: service_started, required: false}}}}"
    )
    services = parse(text, {"LOG": "1"})
    assert in_levels(services) == [["log"], ["a"]]
    assert in_levels(select(services, ["q"])) == [["a"]]
    assert in_levels(parse(text, {"LOG": "0"})) == [["a"]]


def test_an_unknown_profile_is_refused_with_those_there_are() -> None:
    with pytest.raises(
        ComposeError, match=r"profile simulation; there are control, estimation, ground, onboard, rover, sim"
    ):
        select(parse(SHIPPED.read_text(), {}), ["simulation"])


def test_a_dependency_outside_the_chosen_profiles_is_refused() -> None:
    text = "services: {a: {command: x, profiles: [p]}, b: {command: x, profiles: [q], depends_on: [a]}}"
    with pytest.raises(ComposeError, match=r"services\.b\.depends_on: a is in none"):
        select(parse(text, {}), ["q"])


def test_the_environment_takes_defaults_unless_a_variable_is_set() -> None:
    environment = parse(SHIPPED.read_text(), {})["router"].environment
    assert environment["JEZERO_ROUTER"] == "tcp/127.0.0.1:7447"
    environment = parse(SHIPPED.read_text(), {"JEZERO_ROUTER": "tcp/10.0.0.1:1"})["router"].environment
    assert environment["JEZERO_ROUTER"] == "tcp/10.0.0.1:1"


@pytest.mark.parametrize(
    ("written", "variables", "read"),
    [
        ("$V", {"V": "1"}, "1"),
        ("$V", {}, ""),
        ("a${V}b", {"V": "1"}, "a1b"),
        ("$$V", {"V": "1"}, "$V"),
        ("${V:-d}", {"V": ""}, "d"),
        ("${V-d}", {"V": ""}, ""),
        ("${V-d}", {}, "d"),
        ("${V:+set}", {"V": "1"}, "set"),
        ("${V:+set}", {}, ""),
    ],
)
def test_variables_are_replaced_as_the_specification_says(written: str, variables: dict[str, str], read: str) -> None:
    text = f"services: {{a: {{command: x, environment: {{E: '{written}'}}}}}}"
    assert parse(text, variables)["a"].environment == {"E": read}


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (" a: {comand: x}", "services.a.comand: not supported"),
        (" a: {}", "services.a.command: missing"),
        (" a: {command: x, restart: no}", 'services.a.restart: expected no, always, .* "no" needs its quotes'),
        (" a: {command: x, stop_grace_period: 2}", "services.a.stop_grace_period: expected a duration"),
        (" a: {command: x, depends_on: [b]}", "services.a.depends_on.b: there is no such service"),
        (" a: {command: x, depends_on: {a: {condition: ready}}}", "services.a.depends_on.a.condition: expected"),
        (
            " a: {command: x, depends_on: {a: {condition: service_started, required: 0}}}",
            "services.a.depends_on.a.required: expected true or false, got 0",
        ),
        (" a: {command: x, environment: {E: true}}", "services.a.environment.E: expected text"),
        (" a: {command: x, healthcheck: {interval: 1s}}", "services.a.healthcheck.test: missing"),
        (" a: {command: '${V:?set it}'}", "services.a.command: V is not set: set it"),
        (" a: {command: '${'}", "services.a.command: malformed variable"),
        (" 'a b': {command: x}", "services.a b: a name consists of"),
        (" a: [x]", "services.a: expected a mapping"),
        (" a: {command: x, depends_on: [b]}\n b: {command: x, depends_on: [a]}", "wait for each other: a → b → a"),
        (" a: {command: x, depends_on: {b: {condition: service_healthy}}}\n b: {command: x}", "has no healthcheck"),
    ],
)
def test_a_mistake_is_told_with_its_service_and_field(text: str, told: str) -> None:
    with pytest.raises(ComposeError, match=told):
        parse(f"services:\n{text}", {})


@pytest.mark.parametrize("text", ["", "[]", "services: []", "services: {a: ", "networks: {}\nservices: {}"])
def test_what_is_no_compose_file_is_refused(text: str) -> None:
    with pytest.raises(ComposeError):
        parse(text, {})


def test_durations_and_restarts_are_read() -> None:
    service = parse("services: {a: {command: x, stop_grace_period: 1m1.5s, restart: 'on-failure:3'}}", {})["a"]
    assert service.stop_grace_s == 61.5
    assert (service.restart, service.max_retries) == ("on-failure", 3)


def test_a_service_of_scale_0_is_left_out_and_another_number_is_refused() -> None:
    text = "services: {a: {command: x}, b: {command: y, scale: '${N:-1}'}}"
    assert list(parse(text, {})) == ["a", "b"]
    assert list(parse(text, {"N": "0"})) == ["a"]
    with pytest.raises(ComposeError, match=r"services\.b\.scale: \$\{N:-1\} is 'no', expected 0 \(off\) or 1 \(on\)"):
        parse(text, {"N": "no"})
    assert "recorder" not in parse(SHIPPED.read_text(), {"JEZERO_RECORD": "0"})
    assert "ground_station" not in parse(SHIPPED.read_text(), {"JEZERO_GROUND": "0"})
