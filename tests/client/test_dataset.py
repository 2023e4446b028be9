"""A dataset on disk is what other programs expect."""

import json
from datetime import UTC, datetime, timedelta
from math import degrees, pi, radians
from pathlib import Path
from typing import Any, Literal

import msgspec
import pytest
from PIL import Image as Pillow

from jezero.base.frames import q_frd_from_camera, quat_from_euler, quat_multiply, quat_normalize
from jezero.client.dataset import Dataset, exif_of
from jezero.client.images import Picture
from jezero.schemas.images import LISTING, Image, QuatNedFromCamera
from jezero.schemas.sensors import Gnss

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


@pytest.mark.parametrize("kind", ["jpg", "png"])
def test_pictures_carry_their_position(kind: Literal["jpg", "png"], tmp_path: Path) -> None:
    with Dataset(tmp_path, kind) as dataset:
        path = dataset.add(picture(0, latitude=-45.5, longitude=-7.25))
    assert path == tmp_path / "images" / f"0000.{kind}"
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


def gps_of(image: Image) -> Any:
    return exif_of(image, datetime.now(UTC)).get_ifd(0x8825)


ALMOST_ZERO = (0.0, 1e-14, -1e-14, 1e-9, -1e-9, -4e-5, 4e-5, -8e-5, -1e-4)


@pytest.mark.parametrize("yaw_rad", [*ALMOST_ZERO, pi, -pi, radians(359.995), radians(359.9949), radians(-0.005)])
def test_a_direction_is_at_least_0_and_less_than_360_degrees(yaw_rad: float) -> None:
    direction = float(gps_of(msgspec.structs.replace(picture(0).image, yaw_rad=yaw_rad))[17])
    assert 0.0 <= direction < 360.0
    error_deg = (direction - degrees(yaw_rad) + 180.0) % 360.0 - 180.0
    assert abs(error_deg) <= 0.0051


@pytest.mark.parametrize("near", [0.0, 1 / 60, 7.0, 7.1, 12 + 59 / 60, 44.99, 45.0, 89.0, 59 + 59 / 60])
@pytest.mark.parametrize("away", ALMOST_ZERO)
@pytest.mark.parametrize("sign", [1, -1])
def test_minutes_and_seconds_are_less_than_60(near: float, away: float, sign: int) -> None:
    angle_deg = sign * (near + away)
    gps = gps_of(picture(0, latitude=angle_deg, longitude=2.0 * angle_deg).image)
    for parts, reference, expected in ((gps[2], gps[1], angle_deg), (gps[4], gps[3], 2.0 * angle_deg)):
        whole, minutes, seconds = (float(part) for part in parts)
        assert 0.0 <= seconds < 60.0 and 0.0 <= minutes < 60.0
        read = (whole + minutes / 60.0 + seconds / 3600.0) * (-1.0 if reference in "SW" else 1.0)
        assert read == pytest.approx(expected, abs=1e-9)


def test_the_focal_length_is_exact_and_in_pixels_too() -> None:
    image = msgspec.structs.replace(picture(0).image, width_px=640, focal_px=381.4)
    camera = exif_of(image, datetime.now(UTC)).get_ifd(0x8769)
    assert camera[0xA210] == 3  # pixels per centimetre
    assert float(camera[0x920A]) / 10.0 * float(camera[0xA20E]) == pytest.approx(381.4, abs=1e-3)
    assert camera[0xA20F] == camera[0xA20E] == 1000
    assert 0xA405 not in camera  # the 35 mm equivalent, in whole millimetres


def test_numbers_have_the_types_of_their_tags() -> None:
    """Types as they are written: 2 is text, 3 a short integer, 5 a fraction of integers."""
    written = exif_of(picture(0).image, datetime.now(UTC)).tobytes()[6:]
    assert written[:4] == b"MM\0*"

    def entries(offset: int) -> dict[int, tuple[int, int]]:
        """Type, and value or its offset, of each tag of a directory."""
        starts = range(offset + 2, offset + 2 + 12 * integer(offset, 2), 12)
        return {integer(at, 2): (integer(at + 2, 2), integer(at + 8, 4)) for at in starts}

    def integer(at: int, length: int) -> int:
        return int.from_bytes(written[at : at + length], "big")

    main = entries(integer(4, 4))
    camera, gps = entries(main[0x8769][1]), entries(main[0x8825][1])
    assert {tag: kind for tag, (kind, _) in camera.items()} == {
        0x829A: 5, 0x9003: 2, 0x9011: 2, 0x9290: 2, 0x9291: 2, 0x920A: 5, 0xA20E: 5, 0xA20F: 5, 0xA210: 3,
    }  # fmt: skip
    assert {tag: kind for tag, (kind, _) in gps.items()} == {0: 1, 1: 2, 2: 5, 3: 2, 4: 5, 5: 1, 6: 5, 16: 2, 17: 5}


def taken_utc(path: Path) -> datetime:
    """The date in a picture."""
    with Pillow.open(path) as read:
        camera = read.getexif().get_ifd(0x8769)
    assert camera[0x9011] == "+00:00"
    assert len(camera[0x9291]) == 3 and camera[0x9290] == camera[0x9291][0]
    whole = datetime.strptime(camera[0x9003], "%Y:%m:%d %H:%M:%S").replace(tzinfo=UTC)
    return whole + timedelta(milliseconds=int(camera[0x9291]))


def test_a_folder_with_pictures_of_another_dataset_is_left_alone(tmp_path: Path) -> None:
    with Dataset(tmp_path) as dataset:
        dataset.add(picture(5))
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    with pytest.raises(FileExistsError, match=r"has pictures already, e\.g\. 0005\.jpg: choose another folder"):
        Dataset(tmp_path, "png")
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_a_dataset_that_nothing_was_written_to_leaves_no_folder(tmp_path: Path) -> None:
    Dataset(tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_dates_begin_with_the_wall_clock_and_follow_vehicle_time(tmp_path: Path) -> None:
    before = datetime.now(UTC) - timedelta(milliseconds=1)
    with Dataset(tmp_path) as dataset:
        first = taken_utc(dataset.add(picture(5)))
        assert before <= first <= datetime.now(UTC)
        assert taken_utc(dataset.add(picture(65))) - first == timedelta(seconds=60)
        assert taken_utc(dataset.add(picture(4))) - first == timedelta(seconds=-1)
    told = json.loads((tmp_path / LISTING).read_text())
    assert abs(datetime.fromisoformat(told["t0_utc"]) + timedelta(seconds=5) - first) < timedelta(milliseconds=1)


def test_dates_go_on_in_a_dataset_that_is_reopened(tmp_path: Path) -> None:
    with Dataset(tmp_path, "png") as dataset:
        first = taken_utc(dataset.add(picture(5)))
    with Dataset.reopen(tmp_path) as dataset:
        assert taken_utc(dataset.add(picture(3600))) - first == timedelta(seconds=3595)
    with Dataset.reopen(tmp_path) as dataset:
        assert taken_utc(dataset.add(picture(3601))) - first == timedelta(seconds=3596)
    assert len((tmp_path / "geo.txt").read_text().splitlines()) == 4


def test_vehicle_time_that_began_anew_has_another_date(tmp_path: Path) -> None:
    with Dataset(tmp_path) as dataset:
        dataset.add(picture(3600))
    before = datetime.now(UTC) - timedelta(milliseconds=1)
    with Dataset.reopen(tmp_path) as dataset:
        first = taken_utc(dataset.add(picture(5)))
        assert before <= first <= datetime.now(UTC)
        assert taken_utc(dataset.add(picture(4))) - first == timedelta(seconds=-1)


def test_png_keeps_every_pixel(tmp_path: Path) -> None:
    with Dataset(tmp_path, "png") as dataset:
        path = dataset.add(picture(0))
    with Pillow.open(path) as read:
        assert read.tobytes() == picture(0).pixels


def test_geo_txt_is_longitude_latitude_altitude_no_angles_and_the_accuracy(tmp_path: Path) -> None:
    fix = Gnss(
        t_ns=1,
        position_deg=(45.0, 7.0, 300.0),
        vel_uav_ned_mps=(0.0, 0.0, 0.0),
        std_horizontal_m=0.27,
        std_vertical_m=0.3811,
        satellites=14,
    )
    image, pixels = picture(1, longitude=7.123456789)
    with Dataset(tmp_path) as dataset:
        dataset.add(Picture(msgspec.structs.replace(image, gnss=fix), pixels))
        dataset.add(picture(0))
        dataset.add(picture(2, where=False))
    assert (tmp_path / "geo.txt").read_text().splitlines() == [
        "EPSG:4326",
        "0000.jpg 7.000000000 45.000000000 303.970 nan nan nan",
        "0001.jpg 7.123456789 45.000000000 303.970 nan nan nan 0.270 0.381",
    ]


def test_the_folder_holds_nothing_that_opendronemap_would_take_for_its_own(tmp_path: Path) -> None:
    with Dataset(tmp_path) as dataset:
        dataset.add(picture(0))
    assert {file.name for file in tmp_path.iterdir()} == {"images", "geo.txt"}
    assert {file.name for file in (tmp_path / "images").iterdir()} == {"0000.jpg", "images.json"}


def test_images_json_tells_everything_and_takes_later_corrections(tmp_path: Path) -> None:
    with Dataset(tmp_path, goal_id="g") as dataset:
        dataset.add(picture(3))
        dataset.update([picture(3, latitude=46.0).image, picture(4).image])
    told = json.loads((tmp_path / LISTING).read_text())
    assert told["goal_id"] == "g"
    assert [image["file"] for image in told["images"]] == ["0003.jpg"]
    assert told["images"][0]["position_camera_deg"][0] == 46.0
    assert told["images"][0]["focal_px"] == 5.0


def test_the_lists_are_complete_after_each_image(tmp_path: Path) -> None:
    with Dataset(tmp_path, goal_id="g") as dataset:
        assert json.loads((tmp_path / LISTING).read_text())["images"] == []
        for index in range(3):
            dataset.add(picture(index))
            listed = json.loads((tmp_path / LISTING).read_text())
            assert (listed["goal_id"], len(listed["images"])) == ("g", index + 1)
            assert len((tmp_path / "geo.txt").read_text().splitlines()) == index + 2


def test_a_list_that_cannot_be_written_leaves_the_one_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with Dataset(tmp_path) as dataset:
        dataset.add(picture(0))
    before = (tmp_path / LISTING).read_bytes()

    def fill_up(path: Path, data: bytes) -> int:
        path.open("wb").close()
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", fill_up)
    with pytest.raises(OSError, match=r"No space left on device: '.*images\.json'"):
        dataset.add(picture(1))
    assert (tmp_path / LISTING).read_bytes() == before


def test_what_was_taken_is_listed_also_when_something_goes_wrong(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError), Dataset(tmp_path) as dataset:
        dataset.add(picture(0))
        raise RuntimeError
    assert len((tmp_path / "geo.txt").read_text().splitlines()) == 2
