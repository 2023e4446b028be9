"""Noise settings that make the innovations of recorded flights consistent, found by repeated replays."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import exp, log, sqrt
from pathlib import Path

import msgspec

from jezero.recording.mcap_file import RecordingError
from jezero.replay.errors import Errors, has_valid_estimates, relative_errors, true_relative
from jezero.runtime.service import Service
from jezero.services.estimator.innovations import Innovation, Sensor
from jezero.tuning.consistency import COUNT_MIN, Consistency, fit_setting, judge, setting_in_use
from jezero.tuning.observation import ObservedFlight, observe, runs_of_files
from jezero.tuning.sensors import SENSORS, limits
from jezero.tuning.statistics import ConsistentSetting

ROUNDS_MAX = 10
CONVERGED = 0.02
"""The search ends when no setting changes by more than this share between two replays."""
VALID_LOST_MAX = 0.01
"""Share of the estimates that a recommendation may make invalid."""
UNCHANGED = 0.02
"""A sensor whose suggestion differs by less from the setting in use is not replayed by itself."""


class TuningError(ValueError):
    """The flights can't be used for tuning; the text says why, and what to give."""


class Suggestion(msgspec.Struct, frozen=True, kw_only=True):
    """Noise setting of one sensor.

    Attributes:
        setting: name of the setting in `[tuning]` of estimator.toml.
        in_use: value that the filter used; more than the setting where the filter found more noise itself.
        value: the suggested value, which makes the innovations consistent; where the predicted error of the state hides
            the noise, the smaller one of `in_use` and `bound`.
        std: standard error of `value`; the true value lies within twice this error with a probability of 95 %.
        bound: the greatest value that the innovations allow, where the predicted error of the state hides the noise;
            else None.
        at_limit: `value` is the least or the greatest that the setting may have.
        used: value that the filter used when it was replayed with the suggestions.
        rms_alone_m: root of the mean square error of the position with this suggestion alone; None without truth.
    """

    setting: str
    in_use: float
    value: float
    std: float
    bound: float | None
    at_limit: bool
    used: float | None
    rms_alone_m: float | None = None

    @property
    def keeps(self) -> bool:
        """Whether the setting in use stays, because it can't be judged better."""
        return self.bound is not None and self.bound >= self.in_use


class SensorTuning(msgspec.Struct, frozen=True, kw_only=True):
    """What was found about one sensor.

    Attributes:
        sensor: the sensor.
        label: its name for people.
        in_use: its innovations with the settings in use.
        suggested: its innovations with all suggestions.
        suggestion: the suggested setting; None for a sensor without one.
    """

    sensor: Sensor
    label: str
    in_use: Consistency
    suggested: Consistency | None
    suggestion: Suggestion | None


class Accuracy(msgspec.Struct, frozen=True, kw_only=True):
    """Errors of the relative position against the truth, over all flights, at the times at which both are valid.

    Attributes:
        compared: number of estimates.
        rms_in_use_m: root of the mean square error with the settings in use.
        rms_suggested_m: the same with the suggestions.
        valid_in_use: share of the estimates that are valid with the settings in use.
        valid_suggested: the same with the suggestions.
    """

    compared: int
    rms_in_use_m: float
    rms_suggested_m: float
    valid_in_use: float
    valid_suggested: float

    @property
    def is_better(self) -> bool:
        """Whether the error is smaller with the suggestions, and not because fewer estimates are valid."""
        keeps_valid = self.valid_suggested >= self.valid_in_use - VALID_LOST_MAX
        return keeps_valid and self.rms_suggested_m < self.rms_in_use_m


@dataclass(frozen=True)
class TuningResult:
    """Outcome of a tuning.

    Attributes:
        paths: the recordings that were used, one for each run of the estimator.
        left_out: the recordings that can't be used, with the reason.
        sensors: the sensors with enough measurements.
        too_few: number of measurements of each sensor that has some, but too few.
        accuracy: errors against the truth with all suggestions; None without truth, or without valid estimates.
        judged: whether a flight shows what the suggestions are worth: by its truth, or without truth by estimates that
            are valid, with the settings in use and with all suggestions.
        recommended: the settings with the least error of all sets of suggestions that were replayed, by name; none
            where no set has a smaller error than the settings in use, or nothing is judged. All suggestions without
            truth.
        rms_recommended_m: root of the mean square error with them; None without truth, or without recommended settings.
        rounds: number of replays of each flight until the settings stayed.
        converged: whether they stayed.
        flights_in_use: the flights, replayed with the settings in use.
        flights_suggested: the flights, replayed with the suggestions.
    """

    paths: list[Path]
    left_out: dict[Path, str]
    sensors: list[SensorTuning]
    too_few: dict[Sensor, int]
    accuracy: Accuracy | None
    judged: bool
    recommended: dict[str, float]
    rms_recommended_m: float | None
    rounds: int
    converged: bool
    flights_in_use: list[ObservedFlight]
    flights_suggested: list[ObservedFlight]

    @property
    def settings(self) -> dict[str, float]:
        """Suggested settings by name, without those that stay."""
        return _settings(self.sensors)


def tune(
    paths: Sequence[Path],
    changes: Mapping[str, str],
    own: type[Service] | None = None,
    on_progress: Callable[[str], None] = lambda text: None,
) -> TuningResult:
    """Find the noise settings that make the innovations of recorded flights consistent.

    Each round replays all flights with the settings of the round before, because the predicted error of the state
    depends on all of them.

    Args:
        paths: recordings of flights; those that can't be used are left out.
        changes: settings in use other than recorded, as TOML by name.
        own: class of an estimator of one's own, see `observe`; None: jezero's.
        on_progress: called with a sentence before each round of replays.

    Raises:
        SettingError: a change is wrong.
        OwnClassError: `own` can't be tuned.
        TuningError: no flight can be used, or they are too short.
    """
    on_progress("replaying with the settings in use")
    in_use, left_out = _observe_all(paths, changes, own)

    def replay(settings: Mapping[str, str]) -> list[ObservedFlight]:
        return [observe(path, {**changes, **settings}, own) for path in in_use]

    flights = list(in_use.values())
    counts = {sensor: sum(map(len, _series(flights, sensor))) for sensor in SENSORS}
    if max(counts.values()) < COUNT_MIN:
        raise TuningError(
            f"no sensor has {COUNT_MIN} measurements that the estimator can use: give a longer recording, in which "
            "the vehicle flies near the rover"
        )
    search, suggested, converged = _Search(), flights, False
    while not (converged := search.advance(suggested)) and search.rounds < ROUNDS_MAX:
        on_progress(f"round {search.rounds}: replaying with {search.as_text()}")
        suggested = replay(search.as_toml())
    sensors = [found for sensor in SENSORS if (found := _sensor_tuning(sensor, search, flights, suggested)) is not None]
    trials = _Trials(flights, replay, on_progress)
    accuracy = trials.add(_settings(sensors), suggested)
    if accuracy is not None:
        sensors = [_with_error_alone(each, trials) for each in sensors]
        trials.try_the_better_ones()
    judged = accuracy is not None or any(map(_is_valid_without_truth, flights, suggested))
    recommended, rms_recommended_m = trials.best() if accuracy else (_settings(sensors) if judged else {}, None)
    return TuningResult(
        paths=list(in_use),
        left_out=left_out,
        sensors=sensors,
        too_few={sensor: count for sensor, count in counts.items() if 0 < count < COUNT_MIN},
        accuracy=accuracy,
        judged=judged,
        recommended=recommended,
        rms_recommended_m=rms_recommended_m,
        rounds=search.rounds,
        converged=converged,
        flights_in_use=flights,
        flights_suggested=suggested,
    )


def _observe_all(
    paths: Sequence[Path], changes: Mapping[str, str], own: type[Service] | None
) -> tuple[dict[Path, ObservedFlight], dict[Path, str]]:
    """The flights with the settings in use, and the recordings that can't be used, with the reason.

    Raises:
        TuningError: none can be used.
    """
    left_out: dict[Path, str] = {}
    flights: dict[Path, ObservedFlight] = {}
    for path in runs_of_files(paths, left_out):
        try:
            flights[path] = observe(path, changes, own)
        except RecordingError as error:
            left_out[path] = str(error)
    if not flights:
        raise TuningError("; ".join(map(left_out_in_words, left_out, left_out.values())))
    return flights, left_out


def left_out_in_words(path: Path, reason: str) -> str:
    """A recording that can't be used, and why."""
    return reason if reason.startswith(str(path)) else f"{path}: {reason}"


def _settings(sensors: Sequence[SensorTuning]) -> dict[str, float]:
    found = [each.suggestion for each in sensors if each.suggestion is not None]
    return {each.setting: each.value for each in found if not each.keeps}


class _Trials:
    """Sets of suggestions that were replayed, with their errors.

    Args:
        in_use: the flights with the settings in use.
        replay: replays them with other settings.
        on_progress: called with a sentence before a replay.
    """

    def __init__(
        self,
        in_use: Sequence[ObservedFlight],
        replay: Callable[[Mapping[str, str]], list[ObservedFlight]],
        on_progress: Callable[[str], None],
    ) -> None:
        self._in_use = in_use
        self._replay = replay
        self._on_progress = on_progress
        self._tried: list[tuple[dict[str, float], Accuracy]] = []

    def add(self, settings: dict[str, float], flights: Sequence[ObservedFlight]) -> Accuracy | None:
        """Add a set that was replayed; returns its errors, None without truth."""
        accuracy = _accuracy(self._in_use, flights)
        if accuracy is not None:
            self._tried.append((settings, accuracy))
        return accuracy

    def replay(self, settings: dict[str, float]) -> Accuracy | None:
        """Replay a set; returns its errors, None without truth."""
        toml = {name: f"{value:g}" for name, value in settings.items()}
        self._on_progress(f"replaying with only {', '.join(f'{name} = {text}' for name, text in toml.items())}")
        return self.add(settings, self._replay(toml))

    def try_the_better_ones(self) -> None:
        """Replay those suggestions together that lower the error alone, if these are several and not all."""
        together: dict[str, float] = {}
        for settings, accuracy in self._tried:
            if len(settings) == 1 and accuracy.is_better:
                together |= settings
        if len(together) > 1 and all(together.keys() != settings.keys() for settings, _ in self._tried):
            self.replay(together)

    def best(self) -> tuple[dict[str, float], float | None]:
        """The set with the least error and this error; none where none is better than the settings in use."""
        better = [each for each in self._tried if each[0] and each[1].is_better]
        if not better:
            return {}, None
        settings, accuracy = min(better, key=lambda each: each[1].rms_suggested_m / each[1].rms_in_use_m)
        return settings, accuracy.rms_suggested_m


class _Search:
    """Fixed-point iteration of all settings at once.

    Attributes:
        rounds: number of replays that were judged.
        values: settings for the next replay, by sensor.
        fits: what the last replay suggests, by sensor.
    """

    def __init__(self) -> None:
        self.rounds = 0
        self.values: dict[Sensor, float] = {}
        self.fits: dict[Sensor, ConsistentSetting] = {}
        self._in_use: dict[Sensor, float] = {}
        self._tried: dict[Sensor, tuple[float, float]] = {}
        """Logarithm of the setting of the replay before, and the correction of it that this replay suggested."""

    def advance(self, flights: Sequence[ObservedFlight]) -> bool:
        """Judge a replay with `values`, and correct them; whether they were right, and stay."""
        self.rounds += 1
        corrected: dict[Sensor, float] = {}
        changed = False
        for sensor, info in SENSORS.items():
            series = _series(flights, sensor)
            consistency = judge(series) if info.setting else None
            fit = None if consistency is None else fit_setting(series, consistency.effective_count)
            if fit is None:
                continue
            self.fits[sensor] = fit
            in_use = setting_in_use(series)
            assert in_use is not None
            in_use = self._in_use.setdefault(sensor, in_use)
            before = self.values.get(sensor, in_use)
            fitting = min(fit.value, in_use) if fit.is_bound else fit.value
            correction = log(_rounded(fitting, info.setting) / before)
            changed |= abs(correction) > CONVERGED
            corrected[sensor] = _rounded(self._next(sensor, before, correction), info.setting)
        if changed and self.rounds < ROUNDS_MAX:
            self.values |= corrected
        else:  # those that were replayed stay, so that the last replay shows what they do
            self.values = {**corrected, **self.values}
        return not changed

    def _next(self, sensor: Sensor, value: float, missing: float) -> float:
        """The next setting to try: where two replays err in opposite directions, the one between them."""
        tried, self._tried[sensor] = self._tried.get(sensor), (log(value), missing)
        if tried is None or tried[1] * missing >= 0.0:
            return value * exp(missing)
        before, missing_before = tried
        return exp(log(value) - missing * (log(value) - before) / (missing - missing_before))

    def as_toml(self) -> dict[str, str]:
        """The settings by name."""
        return {SENSORS[sensor].setting: f"{value:g}" for sensor, value in self.values.items()}

    def as_text(self) -> str:
        """The settings for people."""
        return ", ".join(f"{name} = {value}" for name, value in self.as_toml().items())


def _rounded(value: float, setting: str) -> float:
    """A value within the setting's limits, with three digits."""
    low, high = limits(setting)
    return float(f"{min(max(value, low), high):.3g}")


def _series(flights: Sequence[ObservedFlight], sensor: Sensor) -> list[list[Innovation]]:
    """Innovations of one sensor by flight."""
    return [flight.innovations[sensor] for flight in flights]


def _sensor_tuning(
    sensor: Sensor, search: _Search, in_use: Sequence[ObservedFlight], suggested: Sequence[ObservedFlight]
) -> SensorTuning | None:
    """The result of one sensor; None when it has too few measurements."""
    consistency = judge(_series(in_use, sensor))
    if consistency is None:
        return None
    suggestion = None
    used_before = setting_in_use(_series(in_use, sensor))
    if sensor in search.values and used_before is not None:
        value, fit, setting = search.values[sensor], search.fits[sensor], SENSORS[sensor].setting
        suggestion = Suggestion(
            setting=setting,
            in_use=used_before,
            value=value,
            std=value * fit.std_relative,
            bound=max(value, _rounded(fit.value, setting)) if fit.is_bound else None,
            at_limit=value in limits(setting),
            used=setting_in_use(_series(suggested, sensor)),
        )
    return SensorTuning(
        sensor=sensor,
        label=SENSORS[sensor].label,
        in_use=consistency,
        suggested=judge(_series(suggested, sensor)),
        suggestion=suggestion,
    )


def _with_error_alone(tuning: SensorTuning, trials: _Trials) -> SensorTuning:
    """The result of one sensor, with the error that its suggestion alone gives."""
    suggestion = tuning.suggestion
    if suggestion is None or abs(log(suggestion.value / suggestion.in_use)) < UNCHANGED:
        return tuning
    accuracy = trials.replay({suggestion.setting: suggestion.value})
    rms_m = None if accuracy is None else accuracy.rms_suggested_m
    return msgspec.structs.replace(tuning, suggestion=msgspec.structs.replace(suggestion, rms_alone_m=rms_m))


def _is_valid_without_truth(in_use: ObservedFlight, suggested: ObservedFlight) -> bool:
    times_ns, _ = true_relative(in_use.replay.files)
    return not len(times_ns) and all(has_valid_estimates(each.replay.published) for each in (in_use, suggested))


def _accuracy(in_use: Sequence[ObservedFlight], suggested: Sequence[ObservedFlight]) -> Accuracy | None:
    """Errors over all flights that have the truth."""
    pairs = []
    for before, after in zip(in_use, suggested, strict=True):
        errors = relative_errors(before.replay.published, after.replay.published, before.replay.files)
        if errors is not None:
            pairs.append(errors)
    if not pairs:
        return None
    olds, news = zip(*pairs, strict=True)
    return Accuracy(
        compared=sum(each.compared for each in olds),
        rms_in_use_m=_pooled_rms_m(olds),
        rms_suggested_m=_pooled_rms_m(news),
        valid_in_use=sum(each.valid for each in olds) / sum(each.estimates for each in olds),
        valid_suggested=sum(each.valid for each in news) / sum(each.estimates for each in news),
    )


def _pooled_rms_m(errors: Sequence[Errors]) -> float:
    """Root of the mean square error over flights."""
    return sqrt(sum(each.compared * each.rms_3d_m**2 for each in errors) / sum(each.compared for each in errors))
