"""Tables and cells in Markdown."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

from jezero.plugins import action_names


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Rows as a table, whose columns are the keys of the first row."""
    names = list(rows[0])
    lines = [names, ["---"] * len(names), *([escape(cell(row[name])) for name in names] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def cell(value: Any) -> str:
    """A value for people; a list that holds all action servers names them together."""
    if isinstance(value, list):
        if set(action_names()) <= set(value):
            value = [*(name for name in value if name not in action_names()), "actions"]
        return ", ".join(value)
    return f"{value:g}" if isinstance(value, float) else str(value)


def escape(text: str) -> str:
    """Text within a table or a paragraph: `|` and, outside of code, `<` would be taken for Markdown."""
    parts = re.split(r"(`[^`]*`)", text)
    return "".join(part if part.startswith("`") else part.replace("<", "&lt;") for part in parts).replace("|", "\\|")
