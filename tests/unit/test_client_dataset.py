"""A dataset on disk is what other programs expect."""

import json
from math import degrees, pi, radians
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from PIL import Image as Pillow

from jezero.client.dataset import Dataset, omega_phi_kappa
from jezero.client.images import Picture
from jezero.frames import q_frd_from_camera, quat_from_euler, quat_multiply, quat_normalize
from jezero.schemas.images import Image, QuatNedFromCamera

DOWN_RAD = -0.5 * pi
WIDTH_PX, HEIGHT_PX = 8, 6


def attitude(yaw_deg: float, pitch_camera_rad: float, roll_deg: float = 0.0) -> QuatNedFromCamera:
    vehicle = quat_from_euler(radians(roll_deg), 0.0, radians(yaw_deg))
    return quat_normalize(quat_multiply(vehicle, q_frd_from_camera(pitch_camera_rad)))


def picture(index: int, *, latitude: float = 45.0, longitude: float = 7.0, where: bool = True) -> Picture:
    image = Image(
        index=index,
        t_ns=1_000_000_000 * index,
        pos_uav_ned_m=(1.0, 2.0, -4.0),
        q_ned_from_frd=(1.0, 0.0, 0.0, 0.0),
        yaw_rad=radians(-90.0),
        pos_camera_ned_m=(1.0, 2.0, -3.97),
        q_ned_from_camera=attitude(0.0, DOWN_RAD),
        position_camera_deg=(latitude, longitude, 303.97) if where else None,
        pitch_camera_rad=DOWN_RAD,
        exposure_s=0.004,
        width_px=WIDTH_PX,
        height_px=HEIGHT_PX,
        focal_px=5.0,
        center_px=(3.5, 2.5),
    )
    return Picture(image, bytes(range(3 * WIDTH_PX * HEIGHT_PX)))


def opk_deg(q: QuatNedFromCamera) -> tuple[float, ...]:
    return tuple(degrees(angle) for angle in omega_phi_kappa(q))


def test_angles_are_those_of_photogrammetry() -> None:
    assert opk_deg(attitude(0.0, DOWN_RAD)) == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)
    # The top of the picture to the east: the image turned clockwise as seen from above.
    assert opk_deg(attitude(90.0, DOWN_RAD)) == pytest.approx((0.0, 0.0, -90.0), abs=1e-6)
    # Looking north and 30 degrees above straight down: about the east axis, positive.
    assert opk_deg(attitude(0.0, DOWN_RAD + radians(30.0))) == pytest.approx((30.0, 0.0, 0.0), abs=1e-6)
    # Right side of the vehicle down: the camera looks to the left, which is west.
    assert opk_deg(attitude(0.0, DOWN_RAD, roll_deg=10.0)) == pytest.approx((0.0, 10.0, 0.0), abs=1e-6)


def test_angles_make_the_rotation_again() -> None:
    q = attitude(37.0, radians(-55.0), roll_deg=6.0)
    omega, phi, kappa = omega_phi_kappa(q)
    c, s = np.cos, np.sin
    rx = np.array([[1, 0, 0], [0, c(omega), -s(omega)], [0, s(omega), c(omega)]])
    ry = np.array([[c(phi), 0, s(phi)], [0, 1, 0], [-s(phi), 0, c(phi)]])
    rz = np.array([[c(kappa), -s(kappa), 0], [s(kappa), c(kappa), 0], [0, 0, 1]])
    w, x, y, z = q
    ned_from_camera = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    enu_from_ned = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
    camera_from_image = np.diag((1, -1, -1))
    assert rx @ ry @ rz == pytest.approx(enu_from_ned @ ned_from_camera @ camera_from_image, abs=1e-12)


@pytest.mark.parametrize("kind", ["jpg", "png"])
def test_pictures_carry_their_position(kind: Literal["jpg", "png"], tmp_path: Path) -> None:
    with Dataset(tmp_path, kind) as dataset:
        path = dataset.add(picture(0, latitude=-45.5, longitude=-7.25))
    assert path.name == f"0000.{kind}"
    with Pillow.open(path) as read:
        gps = read.getexif().get_ifd(0x8825)
        assert read.size == (WIDTH_PX, HEIGHT_PX)
        camera = read.getexif().get_ifd(0x8769)
    assert (gps[1], gps[3]) == ("S", "W")
    assert [float(part) for part in gps[2]] == [45.0, 30.0, 0.0]
    assert [float(part) for part in gps[4]] == [7.0, 15.0, 0.0]
    assert float(gps[6]) == pytest.approx(303.97)
    assert float(gps[17]) == pytest.approx(270.0)
    assert float(camera[0x829A]) == pytest.approx(0.004)
    assert float(camera[0x920A]) == pytest.approx(4.0)


def test_png_keeps_every_pixel(tmp_path: Path) -> None:
    with Dataset(tmp_path, "png") as dataset:
        path = dataset.add(picture(0))
    with Pillow.open(path) as read:
        assert read.tobytes() == picture(0).pixels


def test_geo_txt_is_longitude_latitude_altitude_and_angles(tmp_path: Path) -> None:
    with Dataset(tmp_path) as dataset:
        dataset.add(picture(1, longitude=7.123456789))
        dataset.add(picture(0))
        dataset.add(picture(2, where=False))
    lines = (tmp_path / "geo.txt").read_text().splitlines()
    assert lines[0] == "EPSG:4326"
    assert [line.split()[0] for line in lines[1:]] == ["0000.jpg", "0001.jpg"]
    numbers = [float(part) for part in lines[2].split()[1:]]
    assert numbers[:3] == [7.123456789, 45.0, 303.97]
    assert numbers[3:] == pytest.approx([0.0, 0.0, 0.0], abs=1e-4)


def test_images_json_tells_everything_and_takes_later_corrections(tmp_path: Path) -> None:
    with Dataset(tmp_path, goal_id="g") as dataset:
        dataset.add(picture(3))
        dataset.update([picture(3, latitude=46.0).image, picture(4).image])
    told = json.loads((tmp_path / "images.json").read_text())
    assert told["goal_id"] == "g"
    assert [image["file"] for image in told["images"]] == ["0003.jpg"]
    assert told["images"][0]["position_camera_deg"][0] == 46.0
    assert told["images"][0]["focal_px"] == 5.0


def test_what_was_taken_is_listed_also_when_something_goes_wrong(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError), Dataset(tmp_path) as dataset:
        dataset.add(picture(0))
        raise RuntimeError
    assert len((tmp_path / "geo.txt").read_text().splitlines()) == 2
