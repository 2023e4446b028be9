"""Goals, feedback and results as fields in ROS, and back; and the definitions that are made from the contract."""

from math import pi, sin
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jezero.cli.reference.ros2_interfaces import FOLDER, definitions
from jezero.schemas.goals import (
    AreaCoverageGoal,
    GetImagesGoal,
    GoToGoal,
    LandFeedback,
    LandOnSpotGoal,
    MoveResult,
    ReturnFeedback,
    ReturnHomeGoal,
    TakeoffGoal,
)
from jezero.services.ros2_bridge.fields import AS_JSON, ROS_ACTIONS, RULES, from_ros, ros_fields, to_ros
from jezero.services.ros2_bridge.geometry import RosMessage

metres = st.floats(-1e3, 1e3)
points = st.tuples(metres, metres, metres)
places = st.tuples(metres, metres)
angles = st.floats(-6.28, 6.28)
frames = st.sampled_from(["world", "rover"])
speeds = st.none() | st.floats(0.1, 5.0)
losses = st.sampled_from(["continue", "cancel"])
polygons = st.lists(places, max_size=5).map(tuple)
GOALS = st.one_of(
    st.builds(
        TakeoffGoal,
        altitude_m=metres,
        override=st.lists(st.sampled_from(["battery", "gnss"]), max_size=2).map(tuple),
        on_client_loss=losses,
    ),
    st.builds(
        GoToGoal,
        target_ned_m=points,
        frame=frames,
        do_takeoff=st.booleans(),
        yaw_rad=st.none() | angles,
        speed_mps=speeds,
        on_client_loss=losses,
    ),
    st.builds(LandOnSpotGoal, landing_spot_ned_m=st.none() | points, use_uwb=st.booleans(), force=st.booleans()),
    st.builds(ReturnHomeGoal, safe_height_m=st.none() | st.floats(0.0, 50.0), rally_points_ned_m=polygons),
    st.builds(
        GetImagesGoal,
        center_ned_m=points,
        radius_m=metres,
        num_images=st.integers(0, 255),
        target_z_ned_m=metres,
        stream_images=st.booleans(),
    ),
    st.builds(
        AreaCoverageGoal,
        polygon_ned_m=polygons,
        holes_ned_m=st.lists(polygons, max_size=2).map(tuple),
        origin_deg=st.none() | st.tuples(st.floats(-90.0, 90.0), st.floats(-180.0, 180.0)),
        z_ned_m=metres,
        start_ned_m=st.none() | places,
        angle_rad=st.none() | angles,
        plan_id=st.sampled_from(["", "a1"]),
    ),
)

STRUCTS: list[Any] = [kind for a in ROS_ACTIONS.values() for kind in (a.goal_type, a.feedback_type, a.result_type)]


def as_received(value: Any) -> Any:
    """A message as rclpy has it: fields are attributes."""
    if isinstance(value, RosMessage):
        return SimpleNamespace(**{name: as_received(each) for name, each in value.fields.items()})
    return [as_received(each) for each in value] if isinstance(value, list) else value


def received(goal: msgspec.Struct) -> Any:
    return SimpleNamespace(**{name: as_received(value) for name, value in to_ros(goal).items()})


def is_same(a: Any, b: Any, name: str) -> bool:
    if name in ("yaw_rad", "angle_rad") and a is not None:
        return abs(sin(0.5 * (a - b))) < 1e-9
    return bool(a == b)


@given(GOALS)
def test_a_goal_is_the_same_after_the_way_into_ros_and_back(goal: Any) -> None:
    back = msgspec.convert(dict(from_ros(type(goal), received(goal))), type(goal))
    for field in msgspec.structs.fields(type(goal)):
        a, b = getattr(goal, field.name), getattr(back, field.name)
        assert is_same(a, b, field.name), f"{field.name}: {a} became {b}"


def test_a_position_has_ros_axes() -> None:
    fields = to_ros(GoToGoal(target_ned_m=(1.0, 2.0, -3.0), yaw_rad=0.0))
    assert fields["target_m"].fields == {"x": 2.0, "y": 1.0, "z": 3.0}
    assert fields["yaw_rad"] == [pytest.approx(pi / 2)], "north is a quarter turn anticlockwise from east"
    assert fields["speed_mps"] == []


def test_a_height_is_positive_up_and_a_place_is_east_and_north() -> None:
    fields = to_ros(AreaCoverageGoal(polygon_ned_m=((1.0, 2.0),), z_ned_m=-5.0, start_ned_m=(3.0, 4.0)))
    assert fields["z_m"] == 5.0
    assert fields["polygon_m"][0].fields == {"x": 2.0, "y": 1.0, "z": 0.0}
    assert fields["start_m"][0].fields == {"x": 4.0, "y": 3.0, "z": 0.0}
    assert fields["origin_deg_json"] == ""


def test_a_result_and_a_feedback_inside_another_one() -> None:
    assert to_ros(MoveResult(completed=True, pos_uav_ned_m=(1.0, 2.0, -3.0)))["completed"] is True
    landing = LandFeedback(pos_uav_ned_m=(0.0, 0.0, -1.0), phase="descent")
    feedback = ReturnFeedback(
        pos_uav_ned_m=(0.0, 0.0, -1.0), phase="landing", place="rover", place_ned_m=(0.0, 0.0, 0.0), landing=landing
    )
    assert '"phase":"descent"' in to_ros(feedback)["landing_json"]


def test_text_that_is_not_json_is_an_error_that_names_the_field() -> None:
    goal = received(AreaCoverageGoal(polygon_ned_m=(), z_ned_m=-5.0))
    goal.holes_ned_m_json = "[[1, 2"
    with pytest.raises(ValueError, match="holes_ned_m_json is not JSON"):
        from_ros(AreaCoverageGoal, goal)


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.jezero)
def test_every_rule_is_the_rule_of_a_field(rule: Any) -> None:
    assert any(field.rule is rule for struct in STRUCTS for field in ros_fields(struct))


def test_only_what_has_no_type_in_ros_travels_as_json() -> None:
    as_json = {field.source for struct in STRUCTS for field in ros_fields(struct) if field.rule is AS_JSON}
    assert as_json == {"holes_ned_m", "origin_deg", "images", "resume", "landing"}


@pytest.mark.parametrize("name", definitions())
def test_a_definition_is_as_the_contract_says(name: str) -> None:
    current = (FOLDER / name).read_text() == definitions()[name]
    assert current, f"{name} is old: `python -m jezero.cli.reference.ros2_interfaces` writes it anew"


def test_each_definition_belongs_to_the_contract() -> None:
    there = {f"{path.parent.name}/{path.name}" for folder in ("action", "msg") for path in (FOLDER / folder).iterdir()}
    assert there == definitions().keys() | {"action/FlyAction.action"}
