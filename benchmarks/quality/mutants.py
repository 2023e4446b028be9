"""Random changes of one line of the safety code, and the share of them that a unit test notices.

`python -m benchmarks.quality.mutants [--sample N] [--seed N] [--jobs N]` prints each change that no test notices, and
exits with 1 when the tests notice less than 85 %. With `--scenarios`, flights in virtual time then try the changes that
the unit tests have not noticed; both together must notice 95 %. The tests run in copies of the tree, never in the tree
itself. Changes that harmless.toml lists are not tried and don't count: each of them once survived, and somebody has
written there why no test should notice it.

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
import tomllib
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from difflib import unified_diff
from functools import partial
from itertools import accumulate, pairwise
from pathlib import Path
from queue import SimpleQueue
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
HARMLESS = Path(__file__).with_name("harmless.toml")
KILLED_MIN = 0.85
KILLED_WITH_SCENARIOS_MIN = 0.95
TIMEOUT_S = 60  # a longer test counts as failed: the change may have made an endless loop
SCENARIOS_TIMEOUT_S = 300  # scenarios that have not failed until then have noticed nothing
SERVICES = ("vehicle_bridge", "estimator", "actions/lifecycle", "actions/land_on_spot", "mission", "preflight")
TESTS = {f"services/{name}": f"tests/services/{name}" for name in SERVICES} | {
    "services/autopilot/failsafes.py": "tests/services/autopilot",
    "jezero/base/frames.py": "tests/base",
    "jezero/base/fence.py": "tests/base",
    "jezero/keys/rights.py": "tests/keys/test_rights.py",
}
"""The safety code, and the unit tests that must notice a change of it."""
SCENARIOS = {
    "services/vehicle_bridge": ("mission", "foreign", "fence", "bridge_restarts", "failsafes", "modifications"),
    "services/estimator": ("landing", "tilted_platform", "landing_with_wrong_sensors", "rover_frame", "wedge"),
    "services/actions/lifecycle": ("mission", "modifications", "mission_commands", "rover_frame", "pauses", "edges"),
    "services/actions/land_on_spot": ("landing", "contact", "tilted_platform", "landing_in_wind", "edges"),
    "services/mission": ("mission_commands", "missions", "coming_home"),
    "services/preflight": ("preflight", "missions", "coming_home"),
    "services/autopilot/failsafes.py": ("failsafes", "autopilot_modes", "autopilot_landing"),
    "jezero/base/frames.py": ("mission", "landing", "area_coverage"),
    "jezero/base/fence.py": ("fence", "modifications", "missions"),
    "jezero/keys/rights.py": (),  # in virtual time there is no router
}
"""The scenario tests that fly the same code, quick ones first: parts of the names of files in `tests/scenario`."""
OPPOSITES = {
    "<": ">=", "<=": ">", ">": "<=", ">=": "<", "==": "!=", "!=": "==", "is": "is not", "is not": "is",
    "in": "not in", "not in": "in", "and": "or", "or": "and", "+": "-", "-": "+", "min": "max", "max": "min",
}  # fmt: skip
UNCHANGED = ("annotation", "returns")
OPERATOR = re.compile(r"<=|>=|==|!=|[<>+-]|\b(?:is not|is|not in|in|and|or)\b")


class Mutant(NamedTuple):
    """One change of one line: the bytes from `begin` to `end` of the file at `path` become `text`.

    Attributes:
        tests: paths of the tests that try it.
    """

    path: str
    tests: tuple[str, ...]
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
    return [Mutant(path, (tests,), *change) for change in sorted(set(Changes(source).found))]


def with_scenarios(mutant: Mutant) -> Mutant:
    """The same mutant, for the scenario tests that fly the changed package."""
    place = next(place for place in TESTS if mutant.path.startswith(place))
    return mutant._replace(tests=tuple(f"tests/scenario/test_{name}.py" for name in SCENARIOS[place]))


def all_mutants(root: Path) -> list[Mutant]:
    """All mutants of the safety code, but for `__main__.py`, which only real processes run."""
    found: list[Mutant] = []
    for place, tests in TESTS.items():
        for file in sorted((root / place).rglob("*.py")) or [root / place]:
            if file.name != "__main__.py":
                found += mutants_of(str(file.relative_to(root)), tests, file.read_bytes())
    return found


def named(root: Path, mutant: Mutant) -> tuple[str, str]:
    """The path of a mutant, and "line => changed line" without indentation, as in harmless.toml."""
    source = (root / mutant.path).read_bytes()
    number = source[: mutant.begin].count(b"\n")
    before, after = (text.split(b"\n")[number].decode().strip() for text in (source, mutant.apply(source)))
    return mutant.path, f"{before} => {after}"


def load_harmless(path: Path) -> set[tuple[str, str]]:
    """The harmless changes that a file lists, as `named`."""
    return {(name, change) for name, reasons in tomllib.loads(path.read_text()).items() for change in reasons}


def copy_tree(root: Path, to: Path) -> Path:
    """Copy what git lists or would add; links stay links."""
    listed = subprocess.check_output(["git", "ls-files", "-coz", "--exclude-standard"], cwd=root, text=True)
    for name in filter(None, listed.split("\0")):
        if os.path.lexists(root / name):  # git still lists a file that was deleted
            (to / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(root / name, to / name, follow_symlinks=False)
    return to


def passes(tree: Path, tests: Sequence[str], selection: str, timeout_s: float | None) -> bool:
    """Whether the tests pass in a tree; their random inputs are the same each time.

    Args:
        selection: of tests, by their markers.
        timeout_s: tests that have not failed until then pass.
    """
    options = f"-q -x -p no:cacheprovider --hypothesis-seed=0 --timeout={TIMEOUT_S}".split()
    command = [sys.executable, "-B", "-m", "pytest", *options, "-m", selection, *tests]
    environment = os.environ | {"PYTHONPATH": str(tree)}
    try:
        done = subprocess.run(
            command, cwd=tree, env=environment, capture_output=True, text=True, timeout=timeout_s, check=False
        )
    except subprocess.TimeoutExpired:
        return True
    if done.returncode not in (0, 1, 2):  # 2: the tests can't be imported
        raise SystemExit(f"{' '.join(command)} has ended with {done.returncode}:\n{done.stdout}{done.stderr}")
    return done.returncode == 0


def survives(tree: Path, root: Path, mutant: Mutant, try_tests: Callable[[Path, Sequence[str]], bool]) -> bool:
    """Whether no test notices a mutant, which is printed; the tree is as before afterwards."""
    source = (root / mutant.path).read_bytes()
    mutated = mutant.apply(source)
    (tree / mutant.path).write_bytes(mutated)
    survived = try_tests(tree, mutant.tests)
    (tree / mutant.path).write_bytes(source)
    diff = list(unified_diff(source.decode().splitlines(), mutated.decode().splitlines(), n=0, lineterm=""))[3:]
    place = f"{mutant.path}:{source[: mutant.begin].count(bytes([10])) + 1}"
    print("\n  ".join([f"SURVIVED {place}", *diff]) if survived else f"noticed  {place}", flush=True)
    return survived


def find_survivors(
    root: Path,
    sample: Sequence[Mutant],
    jobs: int,
    selection: str = "not long and not slow",
    timeout_s: float | None = None,
) -> list[Mutant]:
    """The mutants that no test notices; raises SystemExit when tests fail without a change. See `passes`."""
    try_tests = partial(passes, selection=selection, timeout_s=timeout_s)
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

        groups = sorted({mutant.tests for mutant in sample})
        unchanged = pool.map(in_a_tree, [partial(try_tests, tests=tests) for tests in groups])
        if failed := [" ".join(tests) for tests, passed in zip(groups, unchanged, strict=True) if not passed]:
            raise SystemExit(f"{', '.join(failed)} fails without a change: mend that, or wait for a quiet machine")
        tries = [partial(survives, root=root, mutant=mutant, try_tests=try_tests) for mutant in sample]
        return [mutant for mutant, survived in zip(sample, pool.map(in_a_tree, tries), strict=True) if survived]


def report(survivors: Sequence[Mutant], sample: Sequence[Mutant], wanted: float, by: str) -> bool:
    """Print the share that was noticed; returns whether it is as large as wanted."""
    noticed = len(sample) - len(survivors)
    print(f"{noticed} of {len(sample)} changes noticed by {by}, {noticed / len(sample):.1%}")
    return noticed >= wanted * len(sample)


def main() -> None:
    parser = argparse.ArgumentParser(description="Share of random changes of the safety code that a test notices.")
    parser.add_argument("--sample", type=int, default=150, help="number of changes")
    parser.add_argument("--seed", type=int, default=1, help="of the sample")
    parser.add_argument("--jobs", type=int, default=2, help="number of changes that are tested at the same time")
    parser.add_argument(
        "--scenarios",
        action="store_true",
        help=f"fly the changes that no unit test notices too, for up to {SCENARIOS_TIMEOUT_S} s each",
    )
    arguments = parser.parse_args()
    found = all_mutants(ROOT)
    if not 1 <= arguments.sample <= len(found) or arguments.jobs < 1:
        parser.error(f"--sample must be 1 to {len(found)}, and --jobs at least 1")
    harmless, names = load_harmless(HARMLESS), {mutant: named(ROOT, mutant) for mutant in found}
    for path, change in sorted(harmless.difference(names.values())):
        print(f"{HARMLESS.name}: {path} has no such line any more, delete the entry: {change}")
    drawn = random.Random(arguments.seed).sample(found, arguments.sample)
    sample = [mutant for mutant in drawn if names[mutant] not in harmless]
    print(f"{len(drawn)} changes drawn from {len(found)}, {len(drawn) - len(sample)} of them harmless", flush=True)
    survivors = find_survivors(ROOT, sample, arguments.jobs)
    enough = report(survivors, sample, KILLED_MIN, "unit tests")
    if arguments.scenarios:
        flown = [with_scenarios(mutant) for mutant in survivors]
        survivors = [mutant for mutant in flown if not mutant.tests]
        survivors += find_survivors(
            ROOT, [mutant for mutant in flown if mutant.tests], arguments.jobs, "not slow", SCENARIOS_TIMEOUT_S
        )
        enough &= report(survivors, sample, KILLED_WITH_SCENARIOS_MIN, "unit tests and scenarios")
    if not enough:
        sys.exit(
            f"less than {KILLED_MIN:.0%} by unit tests, or than {KILLED_WITH_SCENARIOS_MIN:.0%} by scenarios too: "
            "write tests for the changes above that would hurt in flight"
        )


if __name__ == "__main__":
    main()
