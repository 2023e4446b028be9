"""Errors of the tag detector on rendered pictures, against the true corners of the tags.

`python -m benchmarks.quality.camera_errors` fits the settings `[projection]` of camera.toml, by which mode
"projected" makes corners without rendering.
"""

import argparse
import sys
from collections.abc import Iterator
from itertools import pairwise
from math import exp, log, pi
from typing import NamedTuple

import msgspec
import numpy as np
from scipy.optimize import minimize

from jezero.base.arrays import Array
from jezero.base.config import load_config
from jezero.base.frames import quat_from_euler
from jezero.base.vehicle_config import VehicleConfig
from jezero.schemas.sensors import CameraFrame
from jezero.schemas.state import Scene
from jezero.services.estimator.tag_detector.config import TagDetectorConfig
from jezero.services.estimator.tag_detector.finder import Finder
from jezero.services.simulator.camera.config import CameraConfig, ProjectionConfig
from jezero.services.simulator.camera.detections import (
    BoardGeometry,
    blurs,
    in_shadow,
    probability_found,
    sizes,
    tags_in_picture,
)
from jezero.services.simulator.camera.making import make_renderer
from jezero.services.simulator.camera.service import Renderer
from jezero.services.simulator.camera.view import view_of
from jezero.services.simulator.config import SimulatorConfig

SIZES_PX = (0, 12, 16, 20, 24, 28, 32, 40, 60, 100, 200, 1000)
BLURS_PX = (0.0, 0.3, 1.0, 2.0, 3.0, 5.0, 8.0, 20.0)
LARGE_PX = 32.0
ERRORS_FROM_PX = 20.0
"""Smaller tags are found too rarely to use their errors."""
SHOWN_FROM = 5
"""A class with fewer tags found is not printed."""
SHARE_STILL = 0.4
"""Fraction of the pictures in which the vehicle stands still."""


class Seen(NamedTuple):
    """One tag that is in a picture with its whole margin.

    Attributes:
        dark: whether the vehicle's shadow touches the tag.
        true_px: (4, 2) true corners.
        found_px: (4, 2) detected corners, None when the tag was not detected.
    """

    picture: int
    size_px: float
    blur_px: float
    dark: bool
    true_px: Array
    found_px: Array | None


class Errors(NamedTuple):
    """Errors of one detected tag in pixels: its size, its position (2,), and the rest of its corners (4, 2)."""

    size_px: float
    shift_px: Array
    corners_px: Array


def errors_of(tag: Seen) -> Errors | None:
    """Errors of a tag, or None when it was not detected."""
    if tag.found_px is None:
        return None
    errors_px = tag.found_px - tag.true_px
    shift_px = errors_px.mean(axis=0)
    arms_px = tag.true_px - tag.true_px.mean(axis=0)
    scale = float(((errors_px - shift_px) * arms_px).sum() / (arms_px**2).sum())
    return Errors(scale * tag.size_px, shift_px, errors_px - shift_px - scale * arms_px)


def random_scene(rng: np.random.Generator) -> Scene:
    """Random state over the rover as in a landing: the lower, the slower and the nearer to the centre; or still."""
    above_m = exp(rng.uniform(log(0.12), log(10.5)))
    reach_m = min(0.1 + 0.4 * above_m, 3.0)
    still = rng.random() < SHARE_STILL
    std_vel_mps, std_rates_rps = (0.0, 0.0) if still else (min(0.1 + 0.3 * above_m, 1.5), 0.25)
    roll_rad, pitch_rad = rng.normal(0.0, 0.06, 2)
    north_m, east_m = rng.uniform(-reach_m, reach_m, 2)
    pos_rover_ned_m = (5.0, -3.0, -0.5)
    return Scene(
        t_ns=0,
        epoch_id=0,
        pos_uav_ned_m=(pos_rover_ned_m[0] + north_m, pos_rover_ned_m[1] + east_m, pos_rover_ned_m[2] - above_m),
        vel_uav_ned_mps=tuple(rng.normal(0.0, std_vel_mps, 3)),
        q_ned_from_frd=quat_from_euler(roll_rad, pitch_rad, rng.uniform(-pi, pi)),
        rates_uav_frd_rps=tuple(rng.normal(0.0, std_rates_rps, 3)),
        pos_rover_ned_m=pos_rover_ned_m,
        vel_rover_ned_mps=(0.0, 0.0, 0.0),
        yaw_rover_rad=rng.uniform(-pi, pi),
    )


def look(
    number: int, scene: Scene, config: CameraConfig, vehicle: VehicleConfig, renderer: Renderer, finder: Finder
) -> Iterator[Seen]:
    """Render one scene and compare the detected tags with the true ones."""
    camera, board = vehicle.camera, BoardGeometry(vehicle.platform.board)
    info = camera.info(0)
    half_s = 0.5 * config.exposure_s
    begin, middle, end = (
        view_of(scene, camera.pos_camera_frd_m, (camera.pitch_rest_rad, 0.0), ahead_s=ahead_s)
        for ahead_s in (-half_s, 0, half_s)
    )
    frame = CameraFrame(
        t_ns=0,
        sequence=0,
        width_px=camera.width_px,
        height_px=camera.height_px,
        pitch_camera_rad=camera.pitch_rest_rad,
        exposure_s=config.exposure_s,
        pixels=renderer.picture(scene, (begin, middle, end)),
    )
    found = {tag.tag_id: np.array(tag.corners_px) for tag in finder.find(frame)}
    corners_px, inside = tags_in_picture(board, middle, info)
    tags = np.flatnonzero(inside)
    numbers = zip(
        sizes(corners_px[tags]).tolist(),
        blurs(board, tags, (begin, middle, end), info).tolist(),
        in_shadow(board, tags, middle, config.projection.radius_shadow_m).tolist(),
        strict=True,
    )
    for index, (size_px, blur_px, dark) in zip(tags.tolist(), numbers, strict=True):
        tag_id = board.tag_ids[index]
        yield Seen(number, size_px, blur_px, dark, corners_px[index], found.get(tag_id))


def fit(seen: list[Seen]) -> ProjectionConfig:
    """Maximum-likelihood settings for the detected tags."""
    pairs = [(tag.blur_px, errors) for tag in seen if tag.size_px > ERRORS_FROM_PX and (errors := errors_of(tag))]
    blurs2 = np.array([blur_px**2 for blur_px, _ in pairs])
    sizes_px = np.array([errors.size_px for _, errors in pairs])
    shrinks = -float((sizes_px * blurs2).sum() / (blurs2**2).sum())
    # Eight numbers less shift and size leave five; the shift has its share of the corners' errors, so has the size.
    corner, corner_blur = _fit_std(np.array([(e.corners_px**2).sum() / 5.0 for _, e in pairs]) ** 0.5, blurs2)
    shift, shift_blur = _fit_std(np.array([(e.shift_px**2).mean() for _, e in pairs]) ** 0.5, blurs2)
    size, size_blur = _fit_std(np.abs(sizes_px + shrinks * blurs2), blurs2)
    half, width, per_blur, share = _fit_probability(seen)
    return ProjectionConfig(
        size_half_px=round(half, 2),
        size_width_px=round(width, 2),
        size_per_blur=round(per_blur, 2),
        share_in_shadow=round(share, 2),
        std_corner_px=round(corner, 3),
        std_corner_per_blur2=round(corner_blur, 3),
        std_shift_px=round(max(0.0, shift**2 - 0.25 * corner**2) ** 0.5, 3),
        std_shift_per_blur2=round(max(0.0, shift_blur**2 - 0.25 * corner_blur**2) ** 0.5, 3),
        std_size_px=round(max(0.0, size**2 - 0.5 * corner**2) ** 0.5, 3),
        std_size_per_blur2=round(max(0.0, size_blur**2 - 0.5 * corner_blur**2) ** 0.5, 3),
        shrinks_per_blur2=round(max(0.0, shrinks), 3),
    )


def _fit_std(errors_px: Array, blurs2: Array) -> tuple[float, float]:
    """Maximum-likelihood standard deviation, and its increase per square pixel of blur."""

    def loss(x: Array) -> float:
        std_px = exp(x[0]) + exp(x[1]) * blurs2
        return float(np.mean(np.log(std_px) + 0.5 * (errors_px / std_px) ** 2))

    best = minimize(loss, np.log((0.06, 0.01)), method="Nelder-Mead")
    return float(exp(best.x[0])), float(exp(best.x[1]))


def _fit_probability(seen: list[Seen]) -> tuple[float, float, float, float]:
    """Maximum-likelihood settings of the probability of detection."""
    found = np.array([tag.found_px is not None for tag in seen])

    def loss(x: Array) -> float:
        half, width, per_blur, share = _probability_settings(x)
        config = ProjectionConfig(size_half_px=half, size_width_px=width, size_per_blur=per_blur, share_in_shadow=share)
        p = np.array([probability_found(tag.size_px, tag.blur_px, tag.dark, config) for tag in seen])
        return float(-np.log(np.clip(np.where(found, p, 1.0 - p), 1e-3, 1.0)).mean())

    best = minimize(loss, (log(20.0), log(1.5), 0.5, 0.5), method="Nelder-Mead", options={"maxiter": 600})
    return _probability_settings(best.x)


def _probability_settings(x: Array) -> tuple[float, float, float, float]:
    """size_half_px, size_width_px, size_per_blur, share_in_shadow from four free numbers."""
    return exp(x[0]), exp(x[1]), abs(float(x[2])), 1.0 / (1.0 + exp(-x[3]))


def print_tables(seen: list[Seen]) -> None:
    """Print detections and errors: of still tags by size, and of large tags by blur."""
    still = [tag for tag in seen if tag.blur_px < 0.3]
    large = [tag for tag in seen if tag.size_px > LARGE_PX]
    print(f"{'':14}tags  found/in shadow %  corner px  shift px  size px (mean)")
    for low, high in pairwise(SIZES_PX):
        _print_row(f"size {low}–{high}", [tag for tag in still if low <= tag.size_px < high])
    for blur_low, blur_high in pairwise(BLURS_PX):
        _print_row(f"blur {blur_low}–{blur_high}", [tag for tag in large if blur_low <= tag.blur_px < blur_high])


def _print_row(name: str, tags: list[Seen]) -> None:
    errors = [error for tag in tags if (error := errors_of(tag))]
    if len(errors) < SHOWN_FROM:
        return
    shares = [
        100.0 * float(np.mean([tag.found_px is not None for tag in part])) if part else float("nan")
        for part in ([tag for tag in tags if not tag.dark], [tag for tag in tags if tag.dark])
    ]
    corner_px = float(np.mean([(e.corners_px**2).sum() / 5.0 for e in errors])) ** 0.5
    shift_px = float(np.mean([(e.shift_px**2).mean() for e in errors])) ** 0.5
    sizes_px = np.array([e.size_px for e in errors])
    print(
        f"{name:14}{len(tags):4d}{shares[0]:11.0f} / {shares[1]:<5.0f}{corner_px:11.3f}{shift_px:10.3f}"
        f"{sizes_px.std():9.3f} ({sizes_px.mean():+.3f})"
    )


def print_common(seen: list[Seen]) -> None:
    """Print the part of a tag's shift that all tags of the same picture have in common."""
    by_picture: dict[int, list[Array]] = {}
    for tag in seen:
        if errors := errors_of(tag):
            by_picture.setdefault(tag.picture, []).append(errors.shift_px)
    groups = [np.array(shifts) for shifts in by_picture.values() if len(shifts) > 2]
    if groups:
        total = float(np.mean([np.mean(g**2) for g in groups]))
        within = float(np.mean([g.var(axis=0, ddof=1).mean() for g in groups]))
        common_px = max(0.0, total - within) ** 0.5
        print(f"shift of a tag {total**0.5:.3f} px, of that common to the picture {common_px:.3f} px")


def main() -> int:
    parser = argparse.ArgumentParser(prog="benchmarks.quality.camera_errors", description=__doc__)
    parser.add_argument("--pictures", type=int, default=400)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--renderer", choices=("auto", "egl", "tiny"), default="auto")
    arguments = parser.parse_args()
    config = msgspec.structs.replace(load_config(CameraConfig, "camera"), renderer=arguments.renderer)
    vehicle = load_config(VehicleConfig, "vehicle")
    renderer = make_renderer(config, load_config(SimulatorConfig, "simulator").terrain, vehicle, arguments.seed)
    finder = Finder(load_config(TagDetectorConfig, "tag_detector"))
    rng = np.random.default_rng(arguments.seed)
    seen = [
        tag
        for number in range(arguments.pictures)
        for tag in look(number, random_scene(rng), config, vehicle, renderer, finder)
    ]
    print(f"{arguments.pictures} pictures, {len(seen)} tags in them; {renderer.description}")
    print_tables(seen)
    print_common(seen)
    print("\n[projection]")
    for name, value in msgspec.to_builtins(fit(seen)).items():
        print(f"{name} = {value}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
