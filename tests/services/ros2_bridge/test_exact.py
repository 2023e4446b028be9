"""Whole messages of jezero in ROS, there and back through the bytes that ROS has."""

import re
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import inspect as types

from jezero.base.codec import encode
from jezero.base.frames import quat_normalize
from jezero.schemas.estimate import SetParameters
from jezero.schemas.sensors import CameraPreview, RoverOdometry
from jezero.services.estimator.service import SPEC
from jezero.services.ros2_bridge.bag import MessageBuilder
from jezero.services.ros2_bridge.exact import NotExactError, exact_fields, from_exact, to_exact
from jezero.services.ros2_bridge.rows import EXACT_ROWS, REQUESTS, exact_structs

BUILDERS = {8: MessageBuilder(8), 9: MessageBuilder(9)}
TIME_MAX_NS = 2**31 * 1_000_000_000 - 1
NAME = re.compile(r"[a-z][a-z0-9_]*")
rotations = st.tuples(*(st.floats(-1.0, 1.0),) * 4).filter(lambda q: sum(c * c for c in q) > 0.1).map(quat_normalize)


def values(name: str, kind: types.Type) -> st.SearchStrategy[Any]:  # noqa: PLR0911 - one for each kind
    """Any value that a field may have."""
    if name == "t_ns":
        return st.integers(0, TIME_MAX_NS)
    if name.startswith("q_"):
        return rotations
    match kind:
        case types.UnionType(several):
            return st.one_of(*(values(name, each) for each in several))
        case types.NoneType():
            return st.none()
        case types.BoolType():
            return st.booleans()
        case types.IntType():
            return st.integers(-(2**63) if kind.ge is None else kind.ge, 2**63 - 1 if kind.le is None else kind.le)
        case types.FloatType():
            above = kind.ge if kind.gt is None else kind.gt
            return st.floats(above, kind.le, exclude_min=kind.gt is not None)
        case types.StrType():
            return st.text("abc-._9", min_size=1, max_size=kind.max_length or 20)
        case types.TupleType(items):
            return st.tuples(*(values(name, each) for each in items))
        case types.VarTupleType(item):
            return st.lists(values(name, item), max_size=min(kind.max_length or 5, 5)).map(tuple)
        case types.StructType(cls):
            return messages(cls)
    raise NotImplementedError(name)


def messages(struct: Any) -> st.SearchStrategy[Any]:
    info = types.type_info(struct)
    assert isinstance(info, types.StructType)
    return st.builds(struct, **{field.name: values(field.name, field.type) for field in info.fields})


EVERY = st.one_of(*(messages(struct) for struct in exact_structs().values()))


@given(EVERY, st.sampled_from([8, 9]))
def test_a_whole_message_comes_back_bit_by_bit(message: Any, version: int) -> None:
    ros, builder = to_exact(message), BUILDERS[version]
    back = from_exact(type(message), builder.typestore.deserialize_cdr(builder.serialized(ros), ros.type))
    assert encode(back) == encode(message)


def test_everything_that_the_estimator_reads_travels_whole() -> None:
    assert {topic.name for topic in SPEC.inputs} == {row.source.name for row in EXACT_ROWS}
    changing = {endpoint.name for endpoint in SPEC.serves if not endpoint.name.endswith("/get")}
    assert changing == {request.name for request in REQUESTS}


@pytest.mark.parametrize("struct", exact_structs().values())
def test_names_of_fields_are_names_in_ros(struct: Any) -> None:
    names = [field.name for field in exact_fields(struct)]
    assert all(NAME.fullmatch(name) and "__" not in name and not name.endswith("_") for name in names)
    assert len(set(names)) == len(names)


def test_a_value_that_may_be_none_is_an_empty_sequence() -> None:
    ros = to_exact(SetParameters(pos_rover_ned_m=(1.0, 2.0, 3.0), use_tag=False))
    assert ros.fields["pos_rover_ned_m"] == [1.0, 2.0, 3.0]
    assert ros.fields["use_tag"] == [False]
    assert ros.fields["std_uwb_m"] == []


def test_a_value_out_of_its_range_is_refused() -> None:
    good = RoverOdometry(
        t_ns=1, pos_odom_m=(0.0, 0.0), yaw_rover_rad=100.0, speed_rover_body_mps=0.0, yaw_rate_rover_rps=0.0
    )
    ros, builder = to_exact(good), BUILDERS[9]
    read = builder.typestore.deserialize_cdr(builder.serialized(ros), ros.type)
    with pytest.raises(ValueError, match="yaw_rover_rad"):
        from_exact(RoverOdometry, read)


def test_a_type_without_a_rule_is_an_error() -> None:
    with pytest.raises(NotExactError, match="jpeg: there is no rule"):
        exact_fields(CameraPreview)
