"""Goals that take images: their progress, and the dataset that the images are written to."""

import sys
from collections.abc import Callable
from pathlib import Path
from time import strftime
from typing import TYPE_CHECKING, Any

import click

from jezero.cli.goal_keys import GoalKeys
from jezero.cli.shared import Printer, time_to_go

if TYPE_CHECKING:
    from jezero.client.dataset import Dataset
    from jezero.client.images import ImagesGoal
    from jezero.frames import Vec3
    from jezero.schemas.goals import ImagesFeedback

PNG_OR_JPG = click.Choice(["jpg", "png"])


def default_folder() -> Path:
    """New folder for a run, named by the time."""
    return Path("runs") / strftime("%Y-%m-%d_%H-%M-%S")


def take_pictures(
    printer: Printer,
    goal: "ImagesGoal",
    name: str,
    dataset: "Dataset",
    on_end: Callable[[Any], None] = lambda result: None,
) -> None:
    """Follow a goal to its end and write its images. Ctrl+C cancels the goal; a second one ends the command at once.

    The images of a canceled or aborted goal are written too.

    Args:
        on_end: called with the result, however the goal ended.
    """
    import msgspec

    from jezero.client.errors import EndedError
    from jezero.schemas.goals import ImagesResult

    folder, before = dataset.folder, dataset.count
    track: list[Vec3] = []
    printer.event("accepted", f"{name}: accepted (goal {goal.goal_id})", goal_id=goal.goal_id, warning=goal.warning)
    printer.warn(goal.warning)
    with dataset:
        dataset.note(action=name, goal_id=goal.goal_id)
        try:
            _follow(printer, goal, dataset, before, track)
        except KeyboardInterrupt:
            printer.event("canceling", "canceling: the vehicle will hover where it is", goal_id=goal.goal_id)
            goal.cancel()
            _follow(printer, goal, dataset, before, track)
        try:
            result = goal.result()
        except EndedError as error:
            if isinstance(error.result, ImagesResult):
                dataset.update(error.result.images)
                on_end(error.result)
            if dataset.count and not printer.as_json:
                click.echo(f"{dataset.count} images are in {folder}", err=True)
            raise
        dataset.update(result.images)
        on_end(result)
        text = f"{name}: succeeded, {dataset.count} images in {folder}"
    fields: dict[str, Any] = {"outcome": "succeeded", "goal_id": goal.goal_id, "folder": str(folder)}
    printer.event("result", text, **fields, result=msgspec.to_builtins(result))


def _follow(printer: Printer, goal: "ImagesGoal", dataset: "Dataset", before: int, track: "list[Vec3]") -> None:
    """Fetch the images of a goal until it ends.

    Args:
        before: images of the flights that this one goes on with.
        track: positions of this flight so far, which grow.
    """

    def on_feedback(feedback: "ImagesFeedback") -> None:
        track.append(feedback.pos_uav_ned_m)
        dataset.note(track_ned_m=track, track_frame=feedback.frame, planned=feedback.planned)
        north_m, east_m, down_m = feedback.pos_uav_ned_m
        keys.poll()
        there = before + feedback.taken
        where = f"at ({north_m:.2f}, {east_m:.2f}, {down_m:.2f}){time_to_go(goal)}"
        text = f"{'paused, ' if goal.paused else ''}{there} of {feedback.planned} images, {where}"
        fields = {"pos_uav_ned_m": feedback.pos_uav_ned_m, "frame": feedback.frame, "paused": goal.paused}
        counts = {"taken": feedback.taken, "planned": feedback.planned, "remaining_s": goal.remaining_s}
        printer.progress(text, there / max(feedback.planned, 1), goal_id=goal.goal_id, **fields, **counts)

    with GoalKeys(printer, goal) as keys:
        for picture in goal.pictures(on_feedback):
            if not dataset.has(picture.image):
                path = dataset.add(picture)
                if printer.as_json or not sys.stdout.isatty():
                    printer.event("image", f"image {picture.image.index + 1}: {path}", file=str(path))
