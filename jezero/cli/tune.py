"""`jezero tune`: noise settings of the estimator from recorded flights."""

import json
import shlex
from collections.abc import Mapping, Sequence
from math import sqrt
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import msgspec
from rich.console import Console

from jezero.cli.options import RECORDING_PATH
from jezero.cli.replay import changed_settings, own_class

if TYPE_CHECKING:
    from jezero.tuning.consistency import Consistency
    from jezero.tuning.tuner import SensorTuning, Suggestion, TuningResult

FIGURE = "tuning.png"
FORMATS = (".png", ".pdf", ".svg")
DIFFERENT = 0.05
"""A setting in use counts as another one than suggested when it differs by more than this share."""
SIGMAS = 2.0
"""Suggestions are printed with this number of standard errors, which holds with a probability of 95 %."""


@click.command()
@click.argument("files", nargs=-1, required=True, type=RECORDING_PATH, metavar="FILE...")
@click.option(
    "--class",
    "own",
    metavar="MODULE:CLASS",
    help="The class of an estimator of one's own, which has a method observe_innovations.",
)
@click.option("--set", "settings", multiple=True, metavar="NAME=VALUE",
              help="A setting in use other than recorded; may be given several times.")  # fmt: skip
@click.option("--figure", type=click.Path(path_type=Path, dir_okay=False),
              help="File of the figure, PNG, PDF or SVG [default: tuning.png beside the first recording].")  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def tune(
    files: tuple[Path, ...], own: str | None, settings: tuple[str, ...], figure: Path | None, as_json: bool
) -> None:
    """Find the noise settings of the estimator that fit the flights in FILES.

    FILE is a recording, or the folder of a run. The flights are replayed through the estimator. For each of its
    sensors the command compares the innovations with the spread that the filter predicts, and searches the noise
    setting that makes both agree. A recording needs no truth; with truth, the errors that the suggested settings give
    are printed too, and only what lowers the error is recommended.

    A FILE that was flown with another estimator is left out.
    """
    from jezero.recording import RecordingError, open_recording
    from jezero.replay.rebuild import SettingError
    from jezero.tuning.figure import draw_tuning
    from jezero.tuning.tuner import TuningError
    from jezero.tuning.tuner import tune as tune_flights

    changes = changed_settings(settings)
    if figure is not None:
        if figure.suffix not in FORMATS:
            raise click.UsageError(f"--figure {figure}: give a file that ends in {', '.join(FORMATS)}")
        figure.parent.mkdir(parents=True, exist_ok=True)
    try:
        with Console(stderr=True).status("reading …") as status, own_class(own) as made_from:
            paths = [open_recording(file).path for file in files]
            result = tune_flights(paths, changes, made_from, lambda text: status.update(f"{text} …"))
    except (RecordingError, SettingError, TuningError) as error:
        raise click.ClickException(str(error)) from None
    if not as_json:
        _print(result, changes, own)
    path = draw_tuning(result, figure or result.paths[0].parent / FIGURE)
    click.echo(json.dumps(_as_dict(result, changes, path)) if as_json else f"\nwrote {path}")


def _as_dict(result: "TuningResult", changes: Mapping[str, str], figure: Path) -> dict[str, Any]:
    return {
        "files": [str(path) for path in result.paths],
        "left_out": {str(path): reason for path, reason in result.left_out.items()},
        "set": dict(changes),
        "sensors": msgspec.to_builtins(result.sensors),
        "too_few": result.too_few,
        "accuracy": msgspec.to_builtins(result.accuracy),
        "settings": result.settings,
        "recommended": result.recommended,
        "rms_recommended_m": result.rms_recommended_m,
        "rounds": result.rounds,
        "converged": result.converged,
        "figure": str(figure),
    }


def _print(result: "TuningResult", changes: Mapping[str, str], own: str | None) -> None:
    from jezero.tuning.tuner import left_out_in_words

    for path, reason in result.left_out.items():
        click.echo(f"left out: {left_out_in_words(path, reason)}", err=True)
    number = len(result.paths)
    click.echo(f"{number} flight{'s' if number > 1 else ''}; innovations with the settings in use:\n")
    header = ("sensor", "number", "rejected", "mean", "std", "predicted", "NIS", "95 % band", "lag 1")
    _print_table([header, *(_innovation_row(each) for each in result.sensors)])
    suggestions = [each for each in result.sensors if each.suggestion is not None]
    click.echo("\nnoise settings that make the innovations consistent:\n")
    with_error = result.accuracy is not None
    titles = ("setting", "in use", "consistent", "NIS after", *(("error alone",) if with_error else ()))
    _print_table([titles, *(_setting_row(each, with_error) for each in suggestions)])
    click.echo()
    for text in _remarks(result):
        click.echo(click.wrap_text(f"- {text}", 118, subsequent_indent="  "))
    if result.recommended:
        click.echo(f"\nsettings for deploy/config/estimator.toml:\n\n{_toml(result.recommended)}\n")
        click.echo(f"to check them on a flight:\n\n{_replay_command(result, changes, own)}")
    else:
        click.echo("\nno settings are recommended: those in use stay")


def _innovation_row(tuning: "SensorTuning") -> tuple[str, ...]:
    from jezero.tuning.sensors import SENSORS

    info, found = SENSORS[tuning.sensor], tuning.in_use

    def shown(values: Sequence[float]) -> str:
        if not values:
            return "–"
        return f"{round(info.per_si * values[0], 2) + 0.0:.2f} {info.unit}"  # + 0.0 turns -0.0 into 0.0

    return (
        tuning.label,
        f"{found.count}",
        f"{100.0 * found.rejected:.1f} %",
        shown(sorted(_known(found.mean), key=abs, reverse=True)),
        shown(_root_mean_square(found.std)),
        shown(_root_mean_square(found.std_predicted)),
        _nis(found),
        f"{found.nis_band[0]:.2f} … {found.nis_band[1]:.2f}",
        f"{found.autocorrelation:.2f}",
    )


def _setting_row(tuning: "SensorTuning", with_error: bool) -> tuple[str, ...]:
    found = tuning.suggestion
    assert found is not None
    error = "–" if found.rms_alone_m is None else f"{100.0 * found.rms_alone_m:.1f} cm"
    row = (found.setting, f"{found.in_use:.3g}", _value(found), _nis(tuning.suggested))
    return (*row, error) if with_error else row


def _value(found: "Suggestion") -> str:
    if found.bound is not None:
        return f"at most {found.bound:g}"
    return f"{found.value:g} ± {SIGMAS * found.std:.1g}"


def _nis(consistency: "Consistency | None") -> str:
    return "–" if consistency is None or consistency.nis is None else f"{consistency.nis:.2f}"


def _known(values: Sequence[float | None]) -> list[float]:
    """The values of the components of which not all measurements are rejected."""
    return [value for value in values if value is not None]


def _root_mean_square(values: Sequence[float | None]) -> list[float]:
    """The root mean square of the known values; empty when there is none."""
    known = _known(values)
    return [sqrt(sum(value * value for value in known) / len(known))] if known else []


def _print_table(rows: Sequence[tuple[str, ...]]) -> None:
    """Print rows with the first column on the left and the others on the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for first, *others in rows:
        cells = (cell.rjust(width) for cell, width in zip(others, widths[1:], strict=True))
        click.echo("  ".join((first.ljust(widths[0]), *cells)))


def _remarks(result: "TuningResult") -> list[str]:
    from jezero.tuning.sensors import SENSORS

    suggestions = [each.suggestion for each in result.sensors if each.suggestion is not None]
    remarks = [_accuracy_text(result)]
    if any(each.bound is not None for each in suggestions):
        remarks.append(
            "at most: the error that the filter predicts for its state is larger than the innovations, so that it "
            "hides the noise of the sensor; a smaller setting in use stays"
        )
    for each in suggestions:
        if each.at_limit:
            remarks.append(f"{each.setting} = {each.value:g} is the limit of the setting")
        if each.used is not None and abs(each.used / each.value - 1.0) > DIFFERENT:
            remarks.append(
                f"with {each.setting} = {each.value:g} the estimator uses {each.used:.3g}, because it finds more noise "
                "itself, or because the setting was changed in flight"
            )
    if result.too_few:
        listed = ", ".join(f"{SENSORS[sensor].label} ({count})" for sensor, count in result.too_few.items())
        remarks.append(f"too few measurements to judge: {listed}")
    if not result.converged:
        remarks.append(f"the settings still change after {result.rounds} replays: give more or longer flights")
    for flight in result.flights_in_use:
        if flight.replay.gap_s is not None:
            end = f"{flight.replay.gap_s:.1f} s from its start, where a part of the journal is missing"
            remarks.append(f"the replay of {flight.replay.files[-1]} ends {end}")
    return remarks


def _accuracy_text(result: "TuningResult") -> str:
    accuracy = result.accuracy
    if not result.judged:
        return (
            "no errors: no estimate of the relative position is valid both with the settings in use and with the "
            "suggestions: give a recording in which the vehicle flies near the rover"
        )
    if accuracy is None:
        return "no errors: the recordings have no truth, as those of real vehicles, so only the consistency is judged"
    before_cm, after_cm = 100.0 * accuracy.rms_in_use_m, 100.0 * accuracy.rms_suggested_m
    text = (
        f"error of the relative position against the truth, root mean square of {accuracy.compared} estimates: "
        f"{before_cm:.1f} cm with the settings in use, {after_cm:.1f} cm with all suggestions; "
        f"{100.0 * accuracy.valid_in_use:.0f} % and {100.0 * accuracy.valid_suggested:.0f} % of the estimates are valid"
    )
    if after_cm > before_cm * (1.0 + DIFFERENT):
        text += (
            ". All suggestions together are worse: innovations don't show errors that stay, such as the bias of an "
            "anchor, for which larger settings allow"
        )
    if result.rms_recommended_m is None:
        return f"{text}. No set of suggestions that was tried lowers the error"
    if result.recommended != result.settings:
        text += (
            f". Of all sets that were tried, {' and '.join(result.recommended)} alone has the least error, "
            f"{100.0 * result.rms_recommended_m:.1f} cm"
        )
    return text


def _toml(settings: Mapping[str, float]) -> str:
    return "\n".join(("[tuning]", *(f"{name} = {value:g}" for name, value in settings.items())))


def _replay_command(result: "TuningResult", changes: Mapping[str, str], own: str | None) -> str:
    values = {**changes, **{name: f"{value:g}" for name, value in result.recommended.items()}}
    made_from = "" if own is None else f" --class {shlex.quote(own)}"
    options = "".join(f" \\\n    --set {shlex.quote(f'{name}={value}')}" for name, value in values.items())
    return f"jezero replay {shlex.quote(str(result.paths[0]))} --through estimator{made_from}{options}"
