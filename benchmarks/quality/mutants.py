"""Random changes of one line of the safety code, and the share of them that a unit test notices.

`python -m benchmarks.quality.mutants [--sample N] [--seed N] [--jobs N]` prints each change that no test notices, and
exits with 1 when the tests notice less than 85 %. The tests run in copies of the tree, never in the tree itself.

mutmut and cosmic-ray were left out: mutmut knows a module by the path of its file, which `jezero/services`, a link to
`services`, breaks; cosmic-ray has one command of tests for all changes, so that ten packages would be ten sessions.
"""

import argparse
import ast
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from difflib import unified_diff
from functools import partial
from itertools import accumulate, pairwise
from pathlib import Path
from queue import SimpleQueue
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
KILLED_MIN = 0.85
TIMEOUT_S = 60  # a longer test counts as failed: the change may have made an endless loop
SERVICES = ("vehicle_bridge", "estimator", "actions/lifecycle", "actions/land_on_spot", "mission", "preflight")
TESTS = {f"services/{name}": f"tests/services/{name}" for name in SERVICES} | {
    "services/autopilot/failsafes.py": "tests/services/autopilot",
    "jezero/base/frames.py": "tests/base",
    "jezero/base/fence.py": "tests/base",
    "jezero/keys/rights.py": "tests/keys/test_rights.py",
}
"""The safety code, and the unit tests that must notice a change of it."""
OPPOSITES = {
    "<": ">=", "<=": ">", ">": "<=", ">=": "<", "==": "!=", "!=": "==", "is": "is not", "is not": "is",
    "in": "not in", "not in": "in", "and": "or", "or": "and", "+": "-", "-": "+", "min": "max", "max": "min",
}  # fmt: skip
UNCHANGED = ("annotation", "returns")
OPERATOR = re.compile(r"<=|>=|==|!=|[<>+-]|\b(?:is not|is|not in|in|and|or)\b")


class Mutant(NamedTuple):
    """One change of one line: the bytes from `begin` to `end` of the file at `path` become `text`."""

    path: str
    tests: str
    begin: int
    end: int
    text: str

    def apply(self, source: bytes) -> bytes:
        return source[: self.begin] + self.text.encode() + source[self.end :]


class Changes:
    """All changes of one file, as (begin, end, text).

    Annotations stay, because they do nothing in flight; so do f-strings, in which Python 3.11 knows no places.
    """

    def __init__(self, source: bytes) -> None:
        self.found: list[tuple[int, int, str]] = []
        self._source = source
        self._line_begins = [0, *accumulate(map(len, source.splitlines(keepends=True)))]
        self.visit(ast.parse(source))

    def visit(self, node: ast.AST) -> None:
        match node:
            case ast.Compare(left=left, comparators=others):
                self._turn_operators([left, *others])
            case ast.BoolOp(values=operands):
                self._turn_operators(operands)
            case ast.BinOp(op=ast.Add() | ast.Sub(), left=left, right=right):
                self._turn_operators([left, right])
            case ast.UnaryOp(op=ast.Not() | ast.USub()):
                begin = self._place(node)[0]
                self.found.append((begin, begin + (3 if isinstance(node.op, ast.Not) else 1), ""))
            case ast.Call(func=ast.Name(id="min" | "max" as function)):
                self._replace(node.func, OPPOSITES[function])
            case ast.Constant(value=int() | float()) if node.value and not isinstance(node.value, bool):
                self._replace(node, f"(2 * {node.value!r})")
            case ast.If() | ast.IfExp() | ast.While():
                self._replace(node.test, "False")
            case ast.Return(value=ast.expr()) if not (isinstance(node.value, ast.Constant) and not node.value.value):
                self._replace(node.value, "None")
        for name, value in ast.iter_fields(node):
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST) and not (isinstance(child, ast.JoinedStr) or name in UNCHANGED):
                    self.visit(child)

    def _place(self, node: ast.expr) -> tuple[int, int]:
        """First byte of an expression, and the one behind its last."""
        begin = self._line_begins[node.lineno - 1] + node.col_offset
        return begin, self._line_begins[(node.end_lineno or node.lineno) - 1] + (node.end_col_offset or 0)

    def _replace(self, node: ast.expr | None, text: str) -> None:
        if node is not None and node.lineno == node.end_lineno:
            self.found.append((*self._place(node), text))

    def _turn_operators(self, operands: list[ast.expr]) -> None:
        for left, right in pairwise(operands):
            begin = self._place(left)[1]
            between = self._source[begin : self._place(right)[0]].decode()
            if "#" not in between and (found := OPERATOR.search(between)):
                self.found.append((begin + found.start(), begin + found.end(), OPPOSITES[found[0]]))


def mutants_of(path: str, tests: str, source: bytes) -> list[Mutant]:
    """All mutants of one file, in the order of their places."""
    return [Mutant(path, tests, *change) for change in sorted(set(Changes(source).found))]


def all_mutants(root: Path) -> list[Mutant]:
    """All mutants of the safety code, but for `__main__.py`, which only real processes run."""
    found: list[Mutant] = []
    for place, tests in TESTS.items():
        for file in sorted((root / place).rglob("*.py")) or [root / place]:
            if file.name != "__main__.py":
                found += mutants_of(str(file.relative_to(root)), tests, file.read_bytes())
    return found


def copy_tree(root: Path, to: Path) -> Path:
    """Copy what git lists or would add; links stay links."""
    listed = subprocess.check_output(["git", "ls-files", "-coz", "--exclude-standard"], cwd=root, text=True)
    for name in filter(None, listed.split("\0")):
        if os.path.lexists(root / name):  # git still lists a file that was deleted
            (to / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(root / name, to / name, follow_symlinks=False)
    return to


def passes(tree: Path, tests: str) -> bool:
    """Whether the tests pass in a tree; their random inputs are the same each time."""
    options = f"-q -x -p no:cacheprovider --hypothesis-seed=0 --timeout={TIMEOUT_S}".split()
    command = [sys.executable, "-B", "-m", "pytest", *options, "-m", "not long and not slow", tests]
    environment = os.environ | {"PYTHONPATH": str(tree)}
    done = subprocess.run(command, cwd=tree, env=environment, capture_output=True, text=True, check=False)
    if done.returncode not in (0, 1, 2):  # 2: the tests can't be imported
        raise SystemExit(f"{' '.join(command)} has ended with {done.returncode}:\n{done.stdout}{done.stderr}")
    return done.returncode == 0


def survives(tree: Path, root: Path, mutant: Mutant) -> bool:
    """Whether no test notices a mutant, which is printed; the tree is as before afterwards."""
    source = (root / mutant.path).read_bytes()
    mutated = mutant.apply(source)
    (tree / mutant.path).write_bytes(mutated)
    survived = passes(tree, mutant.tests)
    (tree / mutant.path).write_bytes(source)
    diff = list(unified_diff(source.decode().splitlines(), mutated.decode().splitlines(), n=0, lineterm=""))[3:]
    place = f"{mutant.path}:{source[: mutant.begin].count(bytes([10])) + 1}"
    print("\n  ".join([f"SURVIVED {place}", *diff]) if survived else f"noticed  {place}", flush=True)
    return survived


def count_survivors(root: Path, sample: Sequence[Mutant], jobs: int) -> int:
    """Number of the mutants that no test notices; raises SystemExit when tests fail without a change."""
    with tempfile.TemporaryDirectory(prefix="jezero-mutants-") as folder, ThreadPoolExecutor(jobs) as pool:
        trees: SimpleQueue[Path] = SimpleQueue()
        for number in range(jobs):
            trees.put(copy_tree(root, Path(folder, str(number))))

        def in_a_tree(call: Callable[[Path], bool]) -> bool:
            tree = trees.get()
            try:
                return call(tree)
            finally:
                trees.put(tree)

        folders = sorted({mutant.tests for mutant in sample})
        unchanged = pool.map(in_a_tree, [partial(passes, tests=tests) for tests in folders])
        if failed := [tests for tests, passed in zip(folders, unchanged, strict=True) if not passed]:
            raise SystemExit(f"{', '.join(failed)} fails without a change: mend that, or wait for a quiet machine")
        return sum(pool.map(in_a_tree, [partial(survives, root=root, mutant=mutant) for mutant in sample]))


def main() -> None:
    parser = argparse.ArgumentParser(description="Share of random changes of the safety code that a test notices.")
    parser.add_argument("--sample", type=int, default=150, help="number of changes")
    parser.add_argument("--seed", type=int, default=1, help="of the sample")
    parser.add_argument("--jobs", type=int, default=2, help="number of changes that are tested at the same time")
    arguments = parser.parse_args()
    found = all_mutants(ROOT)
    if not 1 <= arguments.sample <= len(found) or arguments.jobs < 1:
        parser.error(f"--sample must be 1 to {len(found)}, and --jobs at least 1")
    sample = random.Random(arguments.seed).sample(found, arguments.sample)
    noticed = len(sample) - count_survivors(ROOT, sample, arguments.jobs)
    print(f"{noticed} of {len(sample)} changes noticed, {noticed / len(sample):.0%}, drawn from {len(found)}")
    if noticed < KILLED_MIN * len(sample):
        sys.exit(f"less than {KILLED_MIN:.0%}: write tests for the changes above that would hurt in flight")


if __name__ == "__main__":
    main()
