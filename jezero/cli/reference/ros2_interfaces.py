"""The definitions of jezero's actions in ROS: `python -m jezero.cli.reference.ros2_interfaces` writes them anew.

They are the files of `deploy/ros2/jezero_interfaces/action`, made from the structs of goals, feedback and results by
the rules of `jezero.services.ros2_bridge.fields`.
"""

import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec

from jezero.cli.reference.words import Field, description_of, fields_of
from jezero.schemas.rows import Action
from jezero.services.ros2_bridge.fields import AS_JSON, ROS_ACTIONS, RosField, interface_name, ros_fields

FOLDER = Path(__file__).parents[3] / "deploy" / "ros2" / "jezero_interfaces" / "action"
WIDTH = 118
MADE = "Made from jezero's contract by `python -m jezero.cli.reference.ros2_interfaces`: don't change it by hand."
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


def definitions() -> dict[str, str]:
    """All .action files of jezero's own actions, by their names."""
    return {f"{interface_name(name)}.action": definition(action) for name, action in ROS_ACTIONS.items()}


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
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name, text in definitions().items():
        (FOLDER / name).write_text(text)


if __name__ == "__main__":
    main()
