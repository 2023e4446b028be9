"""The changes that the benchmark of the tests makes, and that it finds those which no test notices."""

import subprocess
import tomllib
from pathlib import Path

import pytest

from benchmarks.quality.mutants import (
    HARMLESS,
    ROOT,
    Mutant,
    all_mutants,
    find_survivors,
    load_harmless,
    mutants_of,
    named,
    with_scenarios,
)

pytestmark = pytest.mark.process

SOURCE = '''"""Not even - this + text or 3."""

SPEED_MAX: Annotated[float, 5] = 2.5


def step(a: int, b: int) -> int:
    if not (a < b) and b is not None:
        return f"{a + 1} m"
    return max(-a, b - 1)
'''
CHANGED = [
    "SPEED_MAX: Annotated[float, 5] = (2 * 2.5)",
    "    if False:",
    "    if  (a < b) and b is not None:",
    "    if not (a >= b) and b is not None:",
    "    if not (a < b) or b is not None:",
    "    if not (a < b) and b is None:",
    "        return None",
    "    return min(-a, b - 1)",
    "    return None",
    "    return max(a, b - 1)",
    "    return max(-a, b + 1)",
    "    return max(-a, b - (2 * 1))",
]


def test_each_mutant_changes_one_operator_number_condition_or_result_and_neither_text_nor_annotation() -> None:
    lines = SOURCE.splitlines()
    found = []
    for mutant in mutants_of("a.py", "tests", SOURCE.encode()):
        after = mutant.apply(SOURCE.encode()).decode().splitlines()
        (changed,) = [line for before, line in zip(lines, after, strict=True) if before != line]
        found.append(changed)
    assert sorted(found) == sorted(CHANGED)


def test_every_part_of_the_safety_code_has_mutants_and_tests_that_exist() -> None:
    for mutant in (found := all_mutants(ROOT)):
        for path in (*mutant.tests, *with_scenarios(mutant).tests):
            assert (ROOT / path).exists()
    assert len({mutant.path.rpartition("/")[0] for mutant in found}) >= 9


def test_a_harmless_change_is_known_by_its_line_before_and_after(tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text(SOURCE)
    (tmp_path / "harmless.toml").write_text(
        """["a.py"]\n'return max(-a, b - 1) => return min(-a, b - 1)' = "a is never above b"\n"""
    )
    harmless = load_harmless(tmp_path / "harmless.toml")
    (known,) = [m for m in mutants_of("a.py", "tests", SOURCE.encode()) if named(tmp_path, m) in harmless]
    assert (known.text, known.begin) == ("min", SOURCE.index("max"))


def test_harmless_changes_are_of_the_safety_code_and_have_reasons() -> None:
    paths = {mutant.path for mutant in all_mutants(ROOT)}
    for path, reasons in tomllib.loads(HARMLESS.read_text()).items():
        assert path in paths
        assert all(len(reason.split()) > 3 and " => " in change for change, reason in reasons.items())


def git_tree(folder: Path, **files: str) -> Path:
    subprocess.run(["git", "init", "-q", str(folder)], check=True)
    for name, text in files.items():
        (folder / f"{name}.py").write_text(text)
    return folder


CODE = "def larger(a, b):\n    return max(a, b)\n\n\ndef smaller(a, b):\n    return min(a, b)\n"


def test_a_mutant_that_a_test_notices_is_killed_and_another_is_shown_while_the_tree_stays(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    test = "from code_under_test import larger\n\n\ndef test_larger():\n    assert larger(1, 2) == 2\n"
    tree = git_tree(tmp_path, code_under_test=CODE, test_code=test)
    sample = [
        mutant for mutant in mutants_of("code_under_test.py", ".", CODE.encode()) if mutant.text in ("min", "max")
    ]
    (survivor,) = find_survivors(tree, sample, jobs=2)
    assert survivor.text == "max"
    printed = capsys.readouterr().out
    assert "noticed  code_under_test.py:2\n" in printed
    assert "SURVIVED code_under_test.py:6\n" in printed
    assert "-    return min(a, b)\n  +    return max(a, b)\n" in printed
    assert (tree / "code_under_test.py").read_text() == CODE


def test_tests_that_fail_without_a_change_say_nothing_of_a_mutant(tmp_path: Path) -> None:
    tree = git_tree(tmp_path, code_under_test=CODE, test_code="def test_nothing():\n    assert False\n")
    with pytest.raises(SystemExit, match="fails without a change"):
        find_survivors(tree, [Mutant("code_under_test.py", (".",), 0, 0, "")], jobs=1)


def test_tests_that_last_too_long_notice_nothing(tmp_path: Path) -> None:
    test = "import time\n\n\ndef test_endless():\n    time.sleep(1000)\n"
    tree = git_tree(tmp_path, code_under_test=CODE, test_code=test)
    sample = [Mutant("code_under_test.py", (".",), 0, 0, "")]
    assert find_survivors(tree, sample, jobs=1, timeout_s=0.5) == sample
