"""The pictures of README.md and docs/, from one demonstration and the camera's renderer.

`python -m benchmarks.docs_images [--run FOLDER]` flies `jezero demo --fast`, or takes the run in FOLDER, flies the
landings of docs/how-to/tune-the-estimator.md, and writes docs/images/.
"""

import argparse
import shutil
import subprocess
import sys
from math import pi, radians
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from PIL import Image as Pillow

from jezero.base.config import load_config
from jezero.base.frames import quat_from_euler
from jezero.base.vehicle_config import VehicleConfig
from jezero.cli.survey import M_PER_PX
from jezero.mapping.alignment import align
from jezero.mapping.ground import fit_ground
from jezero.mapping.matching import find_matches
from jezero.mapping.projection import Grid, fit_grid, project
from jezero.mapping.survey import read_survey
from jezero.schemas.state import Scene
from jezero.schemas.topics import AREA_COVERAGE, GET_IMAGES
from jezero.services.simulator.camera.config import CameraConfig
from jezero.services.simulator.camera.making import make_renderer
from jezero.services.simulator.camera.view import view_of
from jezero.services.simulator.config import SimulatorConfig

Picture = Pillow.Image
IMAGES = Path(__file__).parents[1] / "docs" / "images"
WIDTH_PX = 1280
"""Twice the width at which a page shows them on most screens, or a little less."""
GAP_PX = 8
MAP_SHARE = 0.56
"""Of the width, beside the touchdown."""
JPEG_QUALITY = 88
ROVER_NED_M = (5.0, -3.0, -0.5)
"""Of the rover in the demonstration: the middle of its platform."""
AROUND_ROVER_M = 4.0
"""Width of the part of a map that is shown enlarged."""
COLORS = 64
"""Of a drawing with thousands of dots, which is a third as large as with all colours."""


def demonstration(run: Path) -> Picture:
    """Four pictures of the rover in a row; below them the map and the touchdown."""
    pictures = [Pillow.open(path) for path in sorted((run / GET_IMAGES.name / "images").glob("*.jpg"))]
    width_px = (WIDTH_PX - GAP_PX * (len(pictures) - 1)) // len(pictures)
    top = row([_with_width(picture, width_px) for picture in pictures])
    left = _with_width(map_of(run), round(MAP_SHARE * WIDTH_PX))
    right = _with_width(on_white(Pillow.open(run / "touchdown.png")), WIDTH_PX - GAP_PX - left.width)
    return column(top, row([left, right]))


def column(top: Picture, bottom: Picture) -> Picture:
    """A picture of full width above another."""
    sheet = Pillow.new("RGB", (WIDTH_PX, top.height + GAP_PX + bottom.height), "white")
    sheet.paste(top, (0, 0))
    sheet.paste(bottom, (0, top.height + GAP_PX))
    return sheet


def row(pictures: list[Picture]) -> Picture:
    """Pictures side by side, centred vertically."""
    height_px = max(picture.height for picture in pictures)
    sheet = Pillow.new("RGB", (sum(picture.width + GAP_PX for picture in pictures) - GAP_PX, height_px), "white")
    left_px = 0
    for picture in pictures:
        sheet.paste(picture, (left_px, (height_px - picture.height) // 2))
        left_px += picture.width + GAP_PX
    return sheet


def map_of(run: Path) -> Picture:
    """The map without empty margins."""
    picture = Pillow.open(run / AREA_COVERAGE.name / "map.png")
    return on_white(picture.crop(picture.getchannel("A").getbbox()))


def seams(run: Path) -> Picture:
    """The mean of all pictures beside the map; below them the same around the rover."""
    folder = run / AREA_COVERAGE.name
    grid, mean = mean_of_pictures(folder)
    maps = [on_white(mean), on_white(Pillow.open(folder / "map.png"))]
    width_px = (WIDTH_PX - GAP_PX) // 2
    row_px, column_px = (grid.north_m - ROVER_NED_M[0]) / M_PER_PX, (ROVER_NED_M[1] - grid.east_m) / M_PER_PX
    half_px = 0.5 * AROUND_ROVER_M / M_PER_PX
    left, right = round(column_px - half_px), round(column_px + half_px)
    top, bottom = round(row_px - 0.7 * half_px), round(row_px + 0.7 * half_px)
    details = [picture.crop((left, top, right, bottom)) for picture in maps]
    return column(*(row([_with_width(picture, width_px) for picture in pictures]) for pictures in (maps, details)))


def mean_of_pictures(folder: Path) -> tuple[Grid, Picture]:
    """Grid of the map of a coverage's folder, and the plain mean of the same aligned pictures on it."""
    survey = read_survey(folder, load_config(VehicleConfig, "vehicle"))
    ground = fit_ground(survey.spots_m)
    survey = align(survey, ground, find_matches(survey, ground)).survey
    grid = fit_grid(survey, ground, M_PER_PX)
    total, count = np.zeros((grid.rows, grid.columns, 3)), np.zeros((grid.rows, grid.columns, 1))
    for number in range(len(survey)):
        if (patch := project(survey, ground, number, grid)) is not None:
            seen = patch.seen[:, :, None]
            total[patch.place] += seen * patch.colours
            count[patch.place] += seen
    pixels = np.concatenate((total / np.maximum(count, 1.0), 255.0 * (count > 0.0)), axis=2)
    return grid, Pillow.fromarray(np.rint(pixels).astype(np.uint8))


def on_white(picture: Picture) -> Picture:
    """A picture without transparency."""
    sheet = Pillow.new("RGBA", picture.size, "white")
    sheet.alpha_composite(picture.convert("RGBA"))
    return sheet.convert("RGB")


def _with_width(picture: Picture, width_px: int) -> Picture:
    size = (width_px, round(picture.height * width_px / picture.width))
    return picture.resize(size, Pillow.Resampling.LANCZOS)


def camera() -> Picture:
    """The rover from the side, and from above as a landing vehicle sees it."""
    simulator, vehicle = load_config(SimulatorConfig, "simulator"), load_config(VehicleConfig, "vehicle")
    renderer = make_renderer(load_config(CameraConfig, "camera"), simulator.terrain, vehicle, 0)
    pictures = []
    for behind_m, above_m, pitch_rad in ((3.2, 1.0, radians(-20.0)), (0.05, 1.7, -0.5 * pi)):
        scene = Scene(
            t_ns=0,
            epoch_id=0,
            pos_uav_ned_m=(5.0 - behind_m, -3.0, -0.5 - above_m),
            vel_uav_ned_mps=(0.0, 0.0, 0.0),
            q_ned_from_frd=quat_from_euler(0.0, 0.0, 0.0),
            rates_uav_frd_rps=(0.0, 0.0, 0.0),
            pos_rover_ned_m=ROVER_NED_M,
            vel_rover_ned_mps=(0.0, 0.0, 0.0),
            yaw_rover_rad=radians(25.0),
        )
        view = view_of(scene, vehicle.camera.pos_camera_frd_m, (pitch_rad, 0.0))
        size = (vehicle.camera.width_px, vehicle.camera.height_px)
        pictures.append(Pillow.frombytes("RGB", size, renderer.picture(scene, (view, view, view))))
    return row(pictures)


def write_images(run: Path) -> None:
    pictures = {"demonstration": demonstration(run), "map": map_of(run), "seams": seams(run), "camera": camera()}
    for name, picture in pictures.items():
        picture.save(IMAGES / f"{name}.jpg", quality=JPEG_QUALITY)
    shutil.copyfile(run / "relative_error.png", IMAGES / "relative_error.png")


def draw_innovations(folder: Path) -> None:
    """Fly three landings into a folder, and draw their innovations."""
    run_jezero("bench", "landing", "--case", "uwb+tag", "--n", "3", "--rover", "zigzag", "--record", str(folder))
    path = IMAGES / "innovations.png"
    run_jezero("tune", *map(str, sorted(folder.iterdir())), "--figure", str(path))
    _with_width(Pillow.open(path).convert("RGB"), WIDTH_PX).quantize(COLORS).save(path, optimize=True)


def run_jezero(*words: str) -> None:
    subprocess.run([sys.executable, "-m", "jezero.cli.main", *words], check=True)


def main() -> None:
    parser = argparse.ArgumentParser(description="Write the pictures of the documentation.")
    parser.add_argument("--run", type=Path, help="folder of a demonstration, instead of a new flight")
    arguments = parser.parse_args()
    with TemporaryDirectory() as temporary:
        runs, landings = Path(temporary) / "runs", Path(temporary) / "landings"
        if arguments.run is None:
            run_jezero("demo", "--fast", "--runs", str(runs))
        write_images(arguments.run or next(runs.iterdir()))
        draw_innovations(landings)


if __name__ == "__main__":
    main()
