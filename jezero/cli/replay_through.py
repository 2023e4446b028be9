"""`jezero replay --through`: a recorded service runs again on its recorded inputs."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import msgspec
from rich.console import Console

from jezero.cli.exit_codes import FAILED

if TYPE_CHECKING:
    from jezero.replay.errors import Errors
    from jezero.replay.through import Replay

OUTPUT_LENGTH_MAX = 300
"""Characters of an output that are shown."""


def replay_through(file: Path, service: str, settings: Sequence[str], *, as_json: bool) -> None:
    """Replay a service, and print what has changed.

    Args:
        file: the recording, or the folder of a run.
        service: name of the service.
        settings: changes, each `NAME=VALUE`.

    Raises:
        ClickException: the recording or a setting is wrong.
        Exit: the output is not the recorded one, although no setting was changed.
    """
    from jezero.recording import RecordingError, open_recording
    from jezero.replay.errors import relative_errors
    from jezero.replay.rebuild import SettingError
    from jezero.replay.through import replay_through

    changes = changed_settings(settings)
    try:
        with Console(stderr=True).status(f"replaying {service} …"):
            replay = replay_through(open_recording(file).path, service, changes)
            errors = relative_errors(replay.published_before, replay.published, replay.files)
    except (RecordingError, SettingError) as error:
        raise click.ClickException(str(error)) from None
    if as_json:
        click.echo(json.dumps(_as_dict(replay, errors)))
    else:
        _print(replay, errors)
    if not (replay.identical or changes):
        raise click.exceptions.Exit(FAILED)


def changed_settings(texts: Sequence[str]) -> dict[str, str]:
    """Settings and their values as TOML, from texts such as `std_uwb_m=0.05`.

    Raises:
        UsageError: a text is no such pair.
    """
    changes: dict[str, str] = {}
    for text in texts:
        name, _, value = (part.strip() for part in text.partition("="))
        if not (name and value):
            raise click.UsageError(f"--set {text}: give a setting and its value, such as --set std_uwb_m=0.05")
        changes[name] = value
    return changes


def _as_dict(replay: "Replay", errors: "tuple[Errors, Errors] | None") -> dict[str, Any]:
    before, after = errors or (None, None)
    return {
        "service": replay.service,
        "files": [str(file) for file in replay.files],
        "identical": replay.identical,
        "first_difference": msgspec.to_builtins(replay.first_difference),
        "runs": replay.runs,
        "steps": replay.steps,
        "outputs": replay.outputs,
        "different_steps": replay.different,
        "gap_s": replay.gap_s,
        "lossy_images": replay.lossy_images,
        "errors_recorded": msgspec.to_builtins(before),
        "errors_replayed": msgspec.to_builtins(after),
    }


def _print(replay: "Replay", errors: "tuple[Errors, Errors] | None") -> None:
    runs = f"{replay.runs} run{'s' if replay.runs > 1 else ''}"
    click.echo(f"{replay.service}: {runs}, {replay.steps} steps, {replay.outputs} recorded outputs")
    if replay.gap_s is not None:
        click.echo(
            f"the replay ends {replay.gap_s:.1f} s from the start: from there on a part of the journal is missing"
        )
    if replay.lossy_images:
        click.echo(
            f"{replay.lossy_images} images are not exactly those that the service read: JPEG loses detail. For an "
            'exact replay, record with `images = "png"` in recorder.toml'
        )
    if replay.first_difference is None:
        click.echo("identical: all outputs are bit by bit the recorded ones")
    else:
        difference = replay.first_difference
        click.echo(f"different: the outputs of {replay.different} steps; the first at {difference.t_s:.3f} s")
        click.echo(f"  recorded  {_shown(difference.recorded)}")
        click.echo(f"  replayed  {_shown(difference.replayed)}")
    if replay.service == "estimator":
        _print_errors(errors)


def _print_errors(errors: "tuple[Errors, Errors] | None") -> None:
    if errors is None:
        click.echo("no errors: the recording has no truth, or no estimate is valid both as recorded and as replayed")
        return
    click.echo(
        f"error of the relative position against the truth, root mean square of the {errors[0].compared} estimates "
        "that are valid both as recorded and as replayed:"
    )
    for name, each in zip(("recorded", "replayed"), errors, strict=True):
        north_cm, east_cm, down_cm = (100.0 * rms_m for rms_m in each.rms_m)
        axes = f"north {north_cm:.1f}, east {east_cm:.1f}, down {down_cm:.1f}"
        valid = f"{each.valid} of {each.estimates} estimates are valid"
        click.echo(f"  {name}  {100.0 * each.rms_3d_m:5.1f} cm ({axes}); {valid}")


def _shown(output: str) -> str:
    if not output:
        return "nothing"
    return output if len(output) <= OUTPUT_LENGTH_MAX else f"{output[:OUTPUT_LENGTH_MAX]}…"
