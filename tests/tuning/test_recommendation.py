"""Which of the suggestions are recommended: the set with the least error of all that were replayed."""

from collections.abc import Mapping
from typing import Any

import pytest

from jezero.tuning import tuner
from jezero.tuning.tuner import Accuracy, _Trials

ERRORS_M: dict[frozenset[str], tuple[float, float]] = {
    frozenset("abc"): (0.20, 0.9),
    frozenset("a"): (0.08, 0.9),
    frozenset("b"): (0.09, 0.9),
    frozenset("c"): (0.30, 0.9),
    frozenset("ab"): (0.07, 0.9),
}
"""Error and share of valid estimates with some settings; 0.1 m and 0.9 with those in use."""


def recommended(monkeypatch: pytest.MonkeyPatch, errors_m: Mapping[frozenset[str], tuple[float, float]]) -> Any:
    """What is recommended after a replay of all settings, of each alone, and of the better ones."""

    def accuracy(in_use: Any, flights: frozenset[str]) -> Accuracy:
        rms_m, valid = errors_m[flights]
        return Accuracy(compared=9, rms_in_use_m=0.1, rms_suggested_m=rms_m, valid_in_use=0.9, valid_suggested=valid)

    monkeypatch.setattr(tuner, "_accuracy", accuracy)
    replay: Any = frozenset
    trials = _Trials([], replay, lambda text: None)
    all_flights: Any = frozenset("abc")
    trials.add(dict.fromkeys("abc", 1.0), all_flights)
    for name in "abc":
        trials.replay({name: 1.0})
    trials.try_the_better_ones()
    return trials.best()


def test_those_that_are_better_alone_are_tried_together(monkeypatch: pytest.MonkeyPatch) -> None:
    assert recommended(monkeypatch, ERRORS_M) == ({"a": 1.0, "b": 1.0}, 0.07)


def test_the_best_single_one_is_recommended_where_all_sets_are_worse(monkeypatch: pytest.MonkeyPatch) -> None:
    assert recommended(monkeypatch, {**ERRORS_M, frozenset("ab"): (0.11, 0.9)}) == ({"a": 1.0}, 0.08)


def test_all_are_recommended_where_they_are_best(monkeypatch: pytest.MonkeyPatch) -> None:
    settings, rms_m = recommended(monkeypatch, {**ERRORS_M, frozenset("abc"): (0.05, 0.9)})
    assert set(settings) == set("abc") and rms_m == 0.05


def test_nothing_is_recommended_where_nothing_is_better(monkeypatch: pytest.MonkeyPatch) -> None:
    assert recommended(monkeypatch, dict.fromkeys(ERRORS_M, (0.1, 0.9))) == ({}, None)


def test_an_error_that_is_smaller_because_fewer_estimates_are_valid_does_not_count(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    errors_m = {**ERRORS_M, frozenset("a"): (0.01, 0.5)}
    assert recommended(monkeypatch, errors_m) == ({"b": 1.0}, 0.09)
