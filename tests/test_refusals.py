"""A refusal is a sentence, "" where nothing is refused; or a `Refusal` in place of what was wanted."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

pytestmark = pytest.mark.xdist_group("refusals")
"""One worker parses the modules, once."""

ROOT = Path(__file__).parents[1]
NAMED = re.compile(r"^(?!is_)(.*_)?(refusal|reason)$")
DESCRIBED = re.compile(r"\b(reason|why|refus\w+)\b", re.IGNORECASE)
CLASSES = {
    "services/actions/motion/behaviour.py: Refusal",  # in place of a plan
    "schemas/actions.py: Rejected",  # reply to a goal
    "schemas/journal.py: Refused",  # entry of the journal: a request that could not be decoded
    "jezero/client/errors.py: Refused",  # exception of the Python SDK
}


@cache
def modules() -> list[tuple[str, ast.Module]]:
    return [
        (str(path.relative_to(ROOT)), ast.parse(path.read_text()))
        for folder in ("jezero", "services", "schemas", "deploy")
        for path in sorted((ROOT / folder).rglob("*.py"))
    ]


def form_problem(function: ast.FunctionDef | ast.AsyncFunctionDef) -> str:
    """What is wrong with the form in which a function returns a refusal or another reason, or ""."""
    returned = "None" if function.returns is None else ast.unparse(function.returns)
    name = function.name
    if NAMED.search(name) and returned not in ("str", "None"):
        return f'{name} returns {returned}: return a sentence, "" for none'
    described = NAMED.search(name) or DESCRIBED.search(ast.get_docstring(function) or "")
    members = returned.split(" | ")
    if described and "str" in members and len(members) > 1:
        advice = 'a sentence, "" for none' if set(members) == {"str", "None"} else "the value or a `Refusal`"
        return f"{name} returns {returned}: return {advice}"
    return ""


def test_a_function_returns_a_reason_as_a_sentence_or_as_a_refusal_in_place_of_its_value() -> None:
    problems = [
        f"{path}:{node.lineno}: {problem}"
        for path, module in modules()
        for node in ast.walk(module)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and (problem := form_problem(node))
    ]
    assert problems == []


def test_no_other_class_is_a_refusal() -> None:
    found = {
        f"{path}: {node.name}"
        for path, module in modules()
        for node in ast.walk(module)
        if isinstance(node, ast.ClassDef) and re.search("Refus|Reject", node.name)
    }
    assert found == CLASSES
