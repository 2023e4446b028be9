"""The steps of a mission file: goals, waits, and loops, which are written out."""

from collections.abc import Mapping
from typing import Any

import msgspec

from jezero.base.mistakes import mistake, unknown
from jezero.mission_files.goals import PLACE, Places, goal_fields
from jezero.mission_files.nodes import FileNode
from jezero.mission_files.problems import Problems, listed
from jezero.schemas.mission import STEPS_MAX, WAIT_MAX_S, FailurePolicy, GoalStep, Step, WaitStep
from jezero.schemas.rows import Action

LOOPS = ("wait", "for_each", "repeat")
TIMES_MAX = 100
DEPTH_MAX = 10


def failure_policy(node: FileNode, problems: Problems) -> FailurePolicy:
    """Read the reaction to a step that fails. A mistake in it is added to the problems."""
    try:
        return msgspec.convert(node.plain, FailurePolicy)
    except msgspec.ValidationError as error:
        problems.add(
            node.line,
            f"on_failure needs {{retries: 0 to 10, then: stop, skip, return or land}}: {mistake(error, FailurePolicy)}",
        )
        return FailurePolicy()


class Steps:
    """The steps of a mission, loops written out.

    Attributes:
        steps: the steps.
        lines: line of each in the file.
    """

    def __init__(
        self, actions: Mapping[str, Action[Any]], places: Places, policy: FailurePolicy, problems: Problems
    ) -> None:
        self.steps: list[Step] = []
        self.lines: list[int] = []
        self._actions = actions
        self._places = places
        self._policy = policy
        self._problems = problems
        self._full = False

    def read(self, node: FileNode) -> None:
        """Read the list of steps."""
        self._read_list(node, self._places, 0)

    def _read_list(self, node: FileNode, places: Places, depth: int) -> None:
        if not isinstance(node.value, list) or not node.value:
            self._problems.add(node.line, f"steps are a list with one step or more, not {node.in_words}")
            return
        if depth > DEPTH_MAX:
            self._problems.add(node.line, f"loops stand in one another {DEPTH_MAX} times at most")
            return
        for step in node.value:
            self._read_step(step, places, depth)

    def _read_step(self, node: FileNode, places: Places, depth: int) -> None:
        if isinstance(node.value, str):  # a goal without fields
            node = FileNode(node.line, {node.value: FileNode(node.line, None)})
        if not isinstance(node.value, dict):
            self._problems.add(node.line, f"a step is `action: {{field: value}}`, not {node.in_words}")
            return
        parts: dict[str, FileNode] = {name: part for name, part in node.value.items() if name != "on_failure"}
        if len(parts) != 1:
            self._problems.add(
                node.line, f"a step has one action, not {listed(parts)}: begin each step with `- `, indent its fields"
            )
            return
        ((name, below),) = parts.items()
        policy = self._policy
        if "on_failure" in node.value:
            policy = failure_policy(node.value["on_failure"], self._problems)
            if name in LOOPS:
                self._problems.add(node.value["on_failure"].line, f"{name} has no on_failure: give it to its steps")
        if name == "wait":
            self._wait(below)
        elif name == "repeat":
            self._repeat(below, places, depth)
        elif name == "for_each":
            self._for_each(below, places, depth)
        else:
            self._goal(name, below, places, policy)

    def _goal(self, name: str, node: FileNode, places: Places, policy: FailurePolicy) -> None:
        action = self._actions.get(name)
        if action is None:
            self._problems.add(node.line, unknown("action", name, (*self._actions, *LOOPS)))
            return
        if action.mission_refusal:
            self._problems.add(node.line, action.mission_refusal)
            return
        fields = {} if node.value is None else node.value
        if not isinstance(fields, dict):
            self._problems.add(node.line, f"{name} needs fields, as in `{name}: {{field: value}}`, not {node.in_words}")
            return
        goal = goal_fields(action, fields, node.line, places, self._problems)
        self._add(
            node.line, GoalStep(label=_label(name, fields, goal, places), action=name, goal=goal, on_failure=policy)
        )

    def _wait(self, node: FileNode) -> None:
        duration_s = node.value
        number = isinstance(duration_s, int | float) and not isinstance(duration_s, bool)
        if not number or not 0.0 <= duration_s <= WAIT_MAX_S:
            self._problems.add(node.line, f"wait needs seconds, 0 to {WAIT_MAX_S:g}, not {node.in_words}")
            return
        self._add(node.line, WaitStep(label=f"wait {duration_s:g} s", duration_s=float(duration_s)))

    def _repeat(self, node: FileNode, places: Places, depth: int) -> None:
        parts = node.value if isinstance(node.value, dict) else {}
        times = parts["times"].value if "times" in parts else None
        if (
            set(parts) != {"times", "steps"}
            or not isinstance(times, int)
            or isinstance(times, bool)
            or not 1 <= times <= TIMES_MAX
        ):
            self._problems.add(node.line, f"repeat needs {{times: 1 to {TIMES_MAX}, steps: [...]}}")
            return
        for _ in range(times):
            before = len(self._problems.found)
            self._read_list(parts["steps"], places, depth + 1)
            if len(self._problems.found) > before or self._full:
                return  # the next turn has the same mistakes

    def _for_each(self, node: FileNode, places: Places, depth: int) -> None:
        parts = node.value if isinstance(node.value, dict) else {}
        names = [name for name in parts if name != "steps"]
        if len(names) != 1 or "steps" not in parts or not isinstance(parts[names[0]].value, list):
            self._problems.add(node.line, "for_each needs {NAME: [point, point, ...], steps: [...]}")
            return
        name, points = names[0], parts[names[0]].value
        if name in places.names:
            self._problems.add(parts[name].line, f"{name!r} is a point or an area already: choose another name")
            return
        if not points:
            self._problems.add(parts[name].line, "for_each has no points")
        for point in points:
            point_m = self._point(point, places)
            before = len(self._problems.found)
            if point_m is not None:
                shown = point.value if isinstance(point.value, str) else _coordinates(point_m)
                inside = places.in_loop(name, point_m, places.shown.get(shown, shown))
                self._read_list(parts["steps"], inside, depth + 1)
            if len(self._problems.found) > before or self._full:
                return

    def _point(self, node: FileNode, places: Places) -> list[float] | None:
        value = node.plain
        if isinstance(value, str) and value in places.points:
            return places.points[value]
        if isinstance(value, str):
            self._problems.add(node.line, unknown("point", value, places.points))
            return None
        try:
            return list(msgspec.convert(value, tuple[float, float, float]))
        except msgspec.ValidationError:
            self._problems.add(node.line, "a point is a name, or [north, east, down] in metres; 3 m up is -3")
            return None

    def _add(self, line: int, step: Step) -> None:
        if len(self.steps) == STEPS_MAX and not self._full:
            self._full = True
            self._problems.add(line, f"the mission has more than {STEPS_MAX} steps, loops written out")
        if not self._full:
            self.steps.append(step)
            self.lines.append(line)


def _label(name: str, fields: Mapping[str, FileNode], goal: Mapping[str, Any], places: Places) -> str:
    """The label of a step for people: the action's name and its place."""
    named = next((node.value for field, node in fields.items() if field.endswith(PLACE) and node.value in places), None)
    point = next((goal[field] for field in ("target_ned_m", "center_ned_m") if field in goal), None)
    words = name.replace("_", " ")
    if named is not None:
        return f"{words} ({places.shown.get(named, named)})"
    return f"{words} ({_coordinates(point)})" if isinstance(point, list) else words


def _coordinates(point: list[Any]) -> str:
    return ", ".join(f"{part:g}" if isinstance(part, int | float) else str(part) for part in point)
