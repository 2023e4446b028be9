"""How often topics arrive, and their numbers over the last minute."""

from math import nan
from typing import Any

import pytest

from jezero.schemas import topics
from jezero.schemas.sensors import Altimeter
from jezero.services.ground_station.topic_data import (
    PLOT_SPAN_S,
    SERIES_VALUES_MAX,
    LinkTable,
    PlotSeries,
    fields_of,
    plottable_topics,
)
from tests.services.ground_station.messages import Flight


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


STATUS_FIELDS = {field.label: field for field in fields_of(topics.STATUS)}


def test_the_fields_and_units_of_a_topic_are_those_of_its_schema() -> None:
    assert [(field.label, field.unit) for field in fields_of(topics.ALTIMETER)] == [("range_m", "m")]
    assert STATUS_FIELDS["odometry.vel_uav_ned_mps.north"].unit == "m/s"
    assert STATUS_FIELDS["battery.voltage_v"].unit == "V"
    assert STATUS_FIELDS["code"].unit == ""
    assert topics.CAMERA.name not in plottable_topics()


def test_every_field_has_a_name_of_its_own_and_no_topic_lists_its_time() -> None:
    for name in plottable_topics():
        topic = next(topic for topic in topics.TOPICS if topic.name == name)
        labels = [field.label for field in fields_of(topic)]
        assert len(labels) == len(set(labels)), name
        assert "t_ns" not in labels


def test_a_value_is_read_through_structs_and_lists() -> None:
    status = Flight((1.0, 2.0, -3.0)).status()
    assert STATUS_FIELDS["odometry.pos_uav_ned_m.down"].value_in(status) == -3.0
    assert STATUS_FIELDS["battery.voltage_v"].value_in(status) == 16.0


@pytest.mark.parametrize("fields", [{"odometry": None}, {"battery": None}])
def test_what_is_absent_has_no_value(fields: dict[str, None]) -> None:
    status = Flight().status(**fields)
    label = "battery.voltage_v" if "battery" in fields else "odometry.pos_uav_ned_m.down"
    assert STATUS_FIELDS[label].value_in(status) is None


def test_a_series_leaves_out_what_is_absent_or_not_finite_and_gives_only_what_is_new() -> None:
    (field,) = fields_of(topics.ALTIMETER)
    series = PlotSeries(field)
    for t_s, range_m in ((1.0, 4.0), (2.0, None), (3.0, nan), (4.0, 5.0)):
        series.on_message(t_s, Altimeter(t_ns=0, range_m=range_m))
    assert series.since(0.0) == [(1.0, 4.0), (4.0, 5.0)]
    assert series.since(1.0) == [(4.0, 5.0)]
    assert series.since(4.0) == []


def test_a_series_is_bounded_at_any_rate_and_holds_the_last_minute() -> None:
    (field,) = fields_of(topics.ALTIMETER)
    series = PlotSeries(field)
    for number in range(100 * 100):  # 100 Hz for 100 s
        series.on_message(0.01 * number, Altimeter(t_ns=0, range_m=1.0))
    values = series.since(0.0)
    assert len(values) <= SERIES_VALUES_MAX
    assert values[-1][0] - values[0][0] >= PLOT_SPAN_S - 0.1
