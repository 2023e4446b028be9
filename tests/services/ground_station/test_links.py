"""How often topics arrive."""

from typing import Any

from jezero.schemas import topics
from jezero.services.ground_station.links import LinkTable


def row(table: LinkTable, now_s: float, name: str) -> dict[str, Any]:
    """The row of a topic."""
    return next(row for row in table.rows(now_s) if row["name"] == name)


def test_the_rate_that_is_seen_stands_beside_the_one_expected() -> None:
    table = LinkTable(0.0)
    for number in range(100):
        table.on_message(0.1 * number, topics.STATUS.name)
    status = row(table, 9.95, topics.STATUS.name)
    assert (status["expected"], status["seen"], status["age"], status["late"]) == ("10", "10.0", "50 ms", False)


def test_a_topic_that_is_too_rare_or_silent_is_marked_and_one_of_a_goal_is_not() -> None:
    table = LinkTable(0.0)
    for number in range(8):
        table.on_message(float(number), topics.STATUS.name)
    assert row(table, 8.0, topics.STATUS.name)["late"]
    assert row(table, 8.0, topics.ODOMETRY.name)["late"]
    assert row(table, 8.0, topics.ODOMETRY.name)["age"] == "never"
    assert not row(table, 8.0, topics.SETPOINT.name)["late"]
    assert not row(table, 8.0, topics.ROVER_COMMAND.name)["late"]


def test_nothing_is_marked_before_there_was_time_to_count() -> None:
    assert not any(row["late"] for row in LinkTable(0.0).rows(1.0))


def test_a_rate_falls_to_zero_after_the_last_message() -> None:
    table = LinkTable(0.0)
    table.on_message(1.0, topics.STATUS.name)
    status = row(table, 80.0, topics.STATUS.name)
    assert (status["seen"], status["age"]) == ("0.0", "1 min 19 s")
