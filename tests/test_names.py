"""Each name stands for one class."""

import ast
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).parents[1]
MIRROR = ROOT / "jezero" / "aio"
"""The classes of the client once more, with the same names, for asyncio."""
OF_PEOPLE = ("Goal", "Refused")
"""Names of the Python SDK, which people read: a goal that was sent, and the error of a refusal. Messages share them."""


def test_each_name_stands_for_one_class() -> None:
    places: dict[str, list[str]] = defaultdict(list)
    for folder in ("jezero", "services", "schemas", "deploy"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            if path.is_relative_to(MIRROR) or "templates" in path.parts:
                continue
            for node in ast.parse(path.read_text()).body:
                if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                    places[node.name].append(str(path.relative_to(ROOT)))
    several = {name: paths for name, paths in places.items() if len(paths) > 1 and name not in OF_PEOPLE}
    assert several == {}
