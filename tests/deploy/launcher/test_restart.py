"""When a service that ended is started again."""

import pytest

from jezero.deploy.launcher.compose import ComposeService, Restart
from jezero.deploy.launcher.processes import RestartPolicy, describe_exit

ENDED = "ended with exit code 1"


def policy(restart: Restart, max_retries: int | None = None) -> RestartPolicy:
    service = ComposeService(
        name="a", command=("x",), environment={}, depends_on={}, restart=restart, max_retries=max_retries
    )
    return RestartPolicy(service)


def test_the_wait_doubles_with_each_crash_and_a_sixth_one_within_a_minute_ends_it() -> None:
    rule = policy("always")
    waits = [rule.after_exit(float(second), 0.1, 1, ENDED) for second in range(5)]
    assert waits == [0.2, 0.4, 0.8, 1.6, 3.2]
    assert rule.after_exit(5.0, 0.1, 1, ENDED) is None
    assert rule.gave_up == "crash loop: ended 6 times within 60 s; last it ended with exit code 1"
    assert rule.restarts == 5


def test_a_service_that_ran_for_longer_than_a_minute_starts_again_at_once() -> None:
    rule = policy("unless-stopped")
    for second in range(4):
        rule.after_exit(float(second), 0.1, 1, ENDED)
    assert rule.after_exit(70.0, 66.0, -9, "ended with SIGKILL") == 0.2


def test_crashes_more_than_a_minute_apart_are_no_loop() -> None:
    rule = policy("always")
    assert [rule.after_exit(31.0 * n, 30.0, 1, ENDED) for n in range(20)] == [0.2] + [0.4] * 19


@pytest.mark.parametrize(
    ("restart", "code", "again", "gave_up"),
    [
        ("no", 0, False, ""),
        ("no", 1, False, "ended with exit code 1"),
        ("on-failure", 0, False, ""),
        ("on-failure", 1, True, ""),
        ("on-failure", -9, True, ""),
        ("always", 0, True, ""),
        ("unless-stopped", 0, True, ""),
    ],
)
def test_the_restart_field_decides(restart: Restart, code: int, again: bool, gave_up: str) -> None:
    rule = policy(restart)
    assert (rule.after_exit(0.0, 1.0, code, f"ended with {describe_exit(code)}") is not None) == again
    assert rule.gave_up == gave_up


def test_the_number_of_tries_can_be_limited() -> None:
    rule = policy("on-failure", 2)
    assert rule.after_exit(0.0, 1.0, 3, "ended with exit code 3") is not None
    assert rule.after_exit(100.0, 1.0, 3, "ended with exit code 3") is not None
    assert rule.after_exit(200.0, 1.0, 3, "ended with exit code 3") is None
    assert rule.gave_up == "ended with exit code 3 after 2 restarts"


def test_exits_are_told_in_words() -> None:
    assert describe_exit(0) == "exit code 0"
    assert describe_exit(-9) == "SIGKILL"
    assert describe_exit(-60) == "signal 60"
