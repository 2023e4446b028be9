"""Rendered pictures: what is where, what a detector finds, and that both renderers show the same world."""

from collections.abc import Callable
from functools import lru_cache
from math import pi
from typing import Any

import cv2
import msgspec
import numpy as np
import numpy.typing as npt
import pytest

from jezero.base.config import ConfigError
from jezero.base.frames import Vec3, quat_from_euler
from jezero.base.vehicle_config import PlatformConfig, VehicleConfig
from jezero.schemas.landing_board import BIG_ID
from jezero.schemas.state import Scene
from jezero.services.simulator.camera.board import TEXELS_PER_M, board_picture
from jezero.services.simulator.camera.config import CameraConfig
from jezero.services.simulator.camera.detections import BoardGeometry, tags_in_picture
from jezero.services.simulator.camera.egl_renderer import EglRenderer
from jezero.services.simulator.camera.exposure import PixelNoise
from jezero.services.simulator.camera.making import make_renderer
from jezero.services.simulator.camera.service import NoEglError, Renderer
from jezero.services.simulator.camera.tiny_renderer import TinyRenderer
from jezero.services.simulator.camera.view import CameraView, project, view_of
from jezero.services.simulator.config import BoxConfig, PoleConfig, RoverConfig, SimulatorConfig, TerrainConfig

Image = npt.NDArray[np.uint8]
CONFIG = CameraConfig(std_pixel=0.0)
SIMULATOR = SimulatorConfig()
VEHICLE = VehicleConfig()
BOARD = BoardGeometry(VEHICLE.platform.board)
INFO = VEHICLE.camera.info(0)
DOWN_RAD = -0.5 * pi
ROVER_NED_M = (5.0, -3.0, -0.5)


@lru_cache(maxsize=2)
def renderer(kind: str) -> Renderer:
    try:
        return make_renderer(msgspec.structs.replace(CONFIG, renderer=kind), SIMULATOR.terrain, VEHICLE, seed=1)
    except NoEglError as error:
        pytest.skip(str(error))


@pytest.fixture
def egl() -> EglRenderer:
    found = renderer("egl")
    assert isinstance(found, EglRenderer)
    return found


def scene(above_m: float, beside_m: tuple[float, float] = (0.0, 0.0), attitude_rad: Vec3 = (0.0, 0.0, 0.3)) -> Scene:
    zero = (0.0, 0.0, 0.0)
    return Scene(
        t_ns=0,
        epoch_id=1,
        pos_uav_ned_m=(ROVER_NED_M[0] + beside_m[0], ROVER_NED_M[1] + beside_m[1], ROVER_NED_M[2] - above_m - 0.03),
        vel_uav_ned_mps=zero,
        q_ned_from_frd=quat_from_euler(*attitude_rad),
        rates_uav_frd_rps=zero,
        pos_rover_ned_m=ROVER_NED_M,
        vel_rover_ned_mps=zero,
        yaw_rover_rad=0.5,
    )


def view(at: Scene, pitch_rad: float = DOWN_RAD) -> CameraView:
    return view_of(at, VEHICLE.camera.pos_camera_frd_m, (pitch_rad, 0.0))


def photograph(by: Renderer, at: Scene, pitch_rad: float = DOWN_RAD) -> Image:
    still = view(at, pitch_rad)
    pixels = by.picture(at, (still, still, still))
    return np.frombuffer(pixels, dtype=np.uint8).reshape(INFO.height_px, INFO.width_px, 3)


def find_tags(picture: Image) -> dict[int, npt.NDArray[np.float64]]:
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    corners, ids, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(grey)
    return {} if ids is None else {int(i): c[0] for i, c in zip(ids.ravel(), corners, strict=True)}


@pytest.mark.parametrize(("kind", "largest_px"), [("egl", 0.6), ("tiny", 1.2)])
def test_tags_are_where_they_are_projected(kind: str, largest_px: float) -> None:
    errors_px = []
    for turn in range(8):
        at = scene(3.0, (0.4 - 0.1 * turn, -0.3), (0.05, -0.05, 0.8 * turn))
        found = find_tags(photograph(renderer(kind), at))
        corners_px, _ = tags_in_picture(BOARD, view(at), INFO)
        if BIG_ID in found:
            errors_px.append(found[BIG_ID] - corners_px[0])
    assert len(errors_px) >= 6
    assert np.abs(errors_px).max() < largest_px
    assert np.abs(np.mean(errors_px, axis=(0, 1))).max() < 0.15


GREEN, BLUE = (0.1, 0.8, 0.2), (0.1, 0.2, 0.9)


@pytest.mark.parametrize("kind", ["egl", "tiny"])
def test_obstacles_are_in_the_picture_where_they_stand(kind: str) -> None:
    """The camera looks down from 6 m. A green box stands 2 m north of the rover, a blue pole 1.5 m east of it."""
    north_m, east_m, _ = ROVER_NED_M
    terrain = TerrainConfig(
        std_ground_m=0.0,
        craters=0,
        rocks=0,
        boxes=(BoxConfig(north_m=north_m + 2.0, east_m=east_m, size_m=(0.6, 0.6, 0.5), colour=GREEN),),
        poles=(PoleConfig(north_m=north_m, east_m=east_m + 1.5, length_m=0.5, radius_m=0.2, colour=BLUE),),
    )
    try:
        by = make_renderer(msgspec.structs.replace(CONFIG, renderer=kind), terrain, VEHICLE, seed=1)
    except NoEglError as error:
        pytest.skip(str(error))
    at = scene(6.0)
    picture = photograph(by, at).astype(float)
    for colour, place_ned_m in ((1, (north_m + 2.0, east_m, -0.5)), (2, (north_m, east_m + 1.5, -0.5))):
        others = [channel for channel in range(3) if channel != colour]
        dominant = picture[..., colour] > 1.25 * picture[..., others].max(axis=2)
        rows, columns = np.nonzero(dominant)
        expected_px = project(np.array(place_ned_m), view(at), INFO)
        assert (columns.mean(), rows.mean()) == pytest.approx(tuple(expected_px), abs=6.0)


CALIBRATED = {"fx_px": 380.0, "fy_px": 399.0, "cx_px": 335.0, "cy_px": 230.0}
EQUIDISTANT = {"distortion_model": "equidistant", "distortion": (-0.02, 0.01, -0.004, 0.001)}
RATIONAL = {
    "distortion_model": "rational_polynomial",
    "distortion": (0.5, 0.05, 0.0005, -0.0004, 0.002, 0.9, 0.15, 0.01),
}


@pytest.mark.parametrize(
    "fields",
    [{"distortion": (-0.2, 0.06, 0.001, -0.002, 0.0)}, CALIBRATED, {**CALIBRATED, **EQUIDISTANT}, RATIONAL],
    ids=["plumb_bob", "pixels that are no squares", "equidistant", "rational_polynomial"],
)
def test_tags_are_where_they_are_projected_through_a_lens_too(egl: EglRenderer, fields: dict[str, Any]) -> None:
    lens = msgspec.structs.replace(VEHICLE.camera, turn_rad=0.4, **fields)
    vehicle = msgspec.structs.replace(VEHICLE, camera=lens)
    distorting = make_renderer(msgspec.structs.replace(CONFIG, renderer="egl"), SIMULATOR.terrain, vehicle, seed=1)
    errors_px = []
    for beside_m in ((0.9, -0.3), (-0.7, 0.6), (0.0, 0.0), (0.5, 0.5), (-0.5, -0.4), (0.8, 0.3)):
        at = scene(2.0, beside_m)
        seen = view_of(at, lens.pos_camera_frd_m, (DOWN_RAD, 0.0), turn_camera_rad=lens.turn_rad)
        pixels = np.frombuffer(distorting.picture(at, (seen, seen, seen)), dtype=np.uint8)
        found = find_tags(pixels.reshape(INFO.height_px, INFO.width_px, 3))
        corners_px, inside = tags_in_picture(BOARD, seen, lens.info(0))
        assert inside[0]
        if BIG_ID in found:  # the vehicle's shadow hides it at times, through every lens
            errors_px.append(np.abs(found[BIG_ID] - corners_px[0]).max())
    assert len(errors_px) >= 3
    assert max(errors_px) < 0.8


def test_a_lens_that_no_pinhole_can_render_is_refused_with_what_to_do() -> None:
    wide = {"fx_px": 290.0, "fy_px": 290.0, "cx_px": 319.5, "cy_px": 239.5, **EQUIDISTANT}
    vehicle = msgspec.structs.replace(VEHICLE, camera=msgspec.structs.replace(VEHICLE.camera, **wide))
    with pytest.raises(ConfigError, match='set mode = "projected" in camera'):
        make_renderer(CONFIG, SIMULATOR.terrain, vehicle, seed=1)


@pytest.mark.parametrize("kind", ["egl", "tiny"])
def test_the_nose_is_at_the_top_and_red_is_the_first_colour(kind: str) -> None:
    picture = photograph(renderer(kind), scene(6.0, (4.0, 0.0), (0.0, 0.0, 0.0)))
    bright = picture.min(axis=2) > 160
    assert bright[INFO.height_px // 2 :].sum() > 4 * bright[: INFO.height_px // 2].sum()
    ground = picture[:100].reshape(-1, 3).mean(axis=0)
    assert ground[0] > ground[1] > ground[2]


@pytest.mark.parametrize("above_m", [0.12, 0.2, 0.4, 0.8, 1.5, 3.0, 6.0, 10.0])
def test_a_tag_is_found_at_every_height_from_standing_to_10_m(egl: EglRenderer, above_m: float) -> None:
    beside_m = 0.05 * min(1.0, above_m)
    found = find_tags(photograph(egl, scene(above_m, (beside_m, -beside_m))))
    assert set(found) & set(BOARD.tag_ids), f"nothing at {above_m} m"
    if above_m >= 3.0:
        assert BIG_ID in found


def test_the_horizon_is_where_a_level_camera_has_its_middle(egl: EglRenderer) -> None:
    picture = photograph(egl, scene(3.0, (-8.0, 3.0), (0.0, 0.0, 2.0)), pitch_rad=0.0).astype(float)
    steps = np.abs(np.diff(picture.mean(axis=(1, 2))))
    assert abs(int(np.argmax(steps)) - INFO.height_px / 2) < 8


def test_the_vehicle_throws_a_shadow_and_is_not_in_its_own_picture(egl: EglRenderer) -> None:
    low = photograph(egl, scene(1.0, (-5.0, 3.0))).mean(axis=2)
    assert (low < 0.62 * np.median(low)).mean() > 0.01


def test_what_moves_is_smeared_along_its_way(egl: EglRenderer) -> None:
    at = msgspec.structs.replace(scene(3.0, attitude_rad=(0.0, 0.0, 0.5)), vel_uav_ned_mps=(0.0, 4.0, 0.0))
    at = msgspec.structs.replace(at, q_ned_from_frd=(1.0, 0.0, 0.0, 0.0), yaw_rover_rad=0.0)
    views = tuple(
        view_of(at, VEHICLE.camera.pos_camera_frd_m, (DOWN_RAD, 0.0), ahead_s=ahead_s) for ahead_s in (-0.01, 0.0, 0.01)
    )
    moving = np.frombuffer(egl.picture(at, (views[0], views[1], views[2])), dtype=np.uint8).reshape(480, 640, 3)
    still = photograph(egl, at)

    def sharpness(picture: Image, axis: int) -> float:
        return float(np.abs(np.diff(picture[200:280, 280:360].astype(float), axis=axis)).mean())

    assert sharpness(moving, 1) < 0.7 * sharpness(still, 1)
    assert sharpness(moving, 0) > 0.8 * sharpness(still, 0)


def test_the_same_scene_gives_the_same_picture(egl: EglRenderer) -> None:
    assert (photograph(egl, scene(2.0)) == photograph(egl, scene(2.0))).all()


def test_the_orthophoto_shows_the_ground_that_the_camera_sees(egl: EglRenderer) -> None:
    simulator = msgspec.structs.replace(SIMULATOR, rover=RoverConfig())
    assert simulator.terrain == SIMULATOR.terrain
    at = scene(7.5, (-20.0, 10.0), (0.0, 0.0, 0.0))
    seen = photograph(egl, at)[40:440, 120:520].mean(axis=2)
    m_per_px = 8.0 / INFO.focal_px
    north_m, east_m = at.pos_uav_ned_m[0], at.pos_uav_ned_m[1]
    above = egl.orthophoto((north_m, east_m, 0.0), 400 * m_per_px, 400).mean(axis=2)
    shared = cv2.matchTemplate(above.astype(np.float32), seen[60:340, 60:340].astype(np.float32), cv2.TM_CCOEFF_NORMED)
    _, score, _, place = cv2.minMaxLoc(shared)
    assert score > 0.5
    assert np.abs(np.array(place) - 60).max() < 12  # the ground is up to half a metre off its mean height


def test_without_egl_the_other_renderer_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*args: object, **kwargs: object) -> Callable[..., object]:
        raise Exception("libEGL.so.1 not found")

    monkeypatch.setattr("moderngl.create_context", fail)
    monkeypatch.setattr(TinyRenderer, "__init__", lambda *args: None)
    fallback = make_renderer(CONFIG, SIMULATOR.terrain, VEHICLE, seed=1)
    assert "libegl1" in fallback.description
    with pytest.raises(NoEglError, match="libEGL"):
        make_renderer(msgspec.structs.replace(CONFIG, renderer="egl"), SIMULATOR.terrain, VEHICLE, seed=1)


def test_noise_has_the_given_standard_deviation_and_differs_from_picture_to_picture() -> None:
    noise = PixelNoise(4.0, np.random.default_rng(0))
    grey = np.full((480, 640, 3), 128, dtype=np.uint8)
    first, second = noise.add(grey).astype(float), noise.add(grey).astype(float)
    assert first.std() == pytest.approx(4.0, rel=0.02)
    assert (first - second).std() == pytest.approx(4.0 * 2**0.5, rel=0.02)


@pytest.mark.parametrize("side_tag_m", [0.45, 0.37])
def test_tags_of_another_size_are_painted_as_large_as_the_board_says(side_tag_m: float) -> None:
    platform = PlatformConfig(side_tag_m=side_tag_m)
    painted = board_picture(platform)
    from_afar = np.asarray(cv2.resize(painted, None, fx=0.1, fy=0.1, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    found = find_tags(painted) | {BIG_ID: 10.0 * find_tags(from_afar)[BIG_ID]}
    assert len(found) > 20
    for tag in platform.board:
        if tag.tag_id in found:
            side_px = np.linalg.norm(np.diff(found[tag.tag_id], axis=0), axis=1).mean()
            assert side_px == pytest.approx(tag.side_m * TEXELS_PER_M, rel=0.01, abs=1.0), tag.tag_id
