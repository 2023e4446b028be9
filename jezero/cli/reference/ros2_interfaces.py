"""Definitions of actions and messages in ROS: `python -m jezero.cli.reference.ros2_interfaces` writes them.

The files of `deploy/ros2/jezero_interfaces/action` are made from the structs of goals, feedback and results by the
rules of `jezero.services.ros2_bridge.fields`; those of `msg` are whole messages of jezero, by the rules of `exact`.
"""

import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec

from jezero.cli.reference.words import Field, description_of, fields_of
from jezero.schemas.rows import Action
from jezero.services.ros2_bridge.exact import STAMP, ExactField, exact_fields
from jezero.services.ros2_bridge.fields import AS_JSON, ROS_ACTIONS, RosField, interface_name, ros_fields
from jezero.services.ros2_bridge.rows import exact_structs

FOLDER = Path(__file__).parents[3] / "deploy" / "ros2" / "jezero_interfaces"
WIDTH = 118
MADE = "Made from jezero's contract by `python -m jezero.cli.reference.ros2_interfaces`: don't change it by hand."
EXACT_ABOUT = "A whole message of jezero, with its names, axes and units: NED, body FRD, quaternions w, x, y, z."
END = """# How the goal ended: `succeeded`, `canceled`, `aborted`; or `lost`: the bridge lost the vehicle, and the goal
# may still run.
string outcome
# Why it was canceled, aborted or lost, for people; "" after a success.
string outcome_reason
"""
PROGRESS = """# Time to the goal's end by its plan, in seconds. Empty where it is unknown.
float64[<=1] remaining_s
# The goal is paused, and the vehicle hovers.
bool paused
"""


def definition(action: Action[Any]) -> str:
    """The .action file of an action."""
    about = "\n\n".join((description_of(action.goal_type), MADE))
    parts = (
        "".join(_fields(action.goal_type)),
        END + "".join(_fields(action.result_type)),
        PROGRESS + "".join(_fields(action.feedback_type)),
    )
    return f"{_comment(about)}\n" + "---\n".join(parts)


def message_definition(struct: Any) -> str:
    """The .msg file of a struct."""
    about = "\n\n".join(part for part in (description_of(struct), EXACT_ABOUT, MADE) if part)
    meanings = {field.name: field for field in fields_of(struct)}
    fields = (
        _comment(_exact_about(field, meanings[field.source])) + f"{field.type} {field.name}\n"
        for field in exact_fields(struct)
    )
    return f"{_comment(about)}\n" + "".join(fields)


def definitions() -> dict[str, str]:
    """All .action files of jezero's own actions and all .msg files, by their paths in the package."""
    actions = {f"action/{interface_name(name)}.action": definition(action) for name, action in ROS_ACTIONS.items()}
    return actions | {f"msg/{name}.msg": message_definition(struct) for name, struct in exact_structs().items()}


def _exact_about(field: ExactField, contract: Field) -> str:
    """Meaning of a field of a whole message."""
    if field.name == STAMP:
        return "Vehicle time at which the content was true."
    meaning = contract.meaning.rstrip(".")
    sentences = [f"{meaning[0].upper()}{meaning[1:]}."] if meaning else []
    if contract.range:
        sentences.append(f"Range: {contract.range}.")
    return " ".join([*sentences, *(["Empty for none."] if field.optional else [])])


def _fields(struct: Any) -> Iterator[str]:
    meanings = {field.name: field for field in fields_of(struct)}
    for field in ros_fields(struct):
        yield _comment(_about(field, meanings[field.source])) + f"{field.type} {field.name}{_default(field)}\n"


def _about(field: RosField, contract: Field) -> str:
    """Meaning of a field, with what is other in ROS."""
    meaning = contract.meaning if contract.meaning.endswith(".") else f"{contract.meaning}."
    if field.rule.about:
        sentences = [f"`{field.source}` of jezero: {meaning}", f"\nHere: {field.rule.about}."]
    else:
        sentences = [meaning[0].upper() + meaning[1:], *([f"Range: {contract.range}."] if contract.range else [])]
    if field.optional:
        sentences.append('"" for none.' if field.rule is AS_JSON else "Empty for none.")
    return " ".join(sentences)


def _default(field: RosField) -> str:
    """Default of a field, where ROS can have one."""
    if field.default is msgspec.NODEFAULT or field.many or field.optional or field.rule is AS_JSON:
        return ""
    value = field.to_ros(field.default)
    return f" {msgspec.json.encode(value).decode()}" if isinstance(value, bool | int | float | str) else ""


def _comment(text: str) -> str:
    lines = (line for part in text.split("\n") for line in textwrap.wrap(part, WIDTH) or [""])
    return "".join(f"# {line}".rstrip() + "\n" for line in lines)


def main() -> None:
    for name, text in definitions().items():
        path = FOLDER / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


if __name__ == "__main__":
    main()
