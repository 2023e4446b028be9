"""Intrinsics from files of ROS and Kalibr, and into the settings."""

from pathlib import Path

import msgspec
import pytest
from click.testing import CliRunner

from jezero.base.vehicle_config import VehicleConfig
from jezero.calibration.intrinsics import (
    CameraIntrinsics,
    IntrinsicsError,
    read_intrinsics,
    ros_yaml,
    toml_lines,
    with_intrinsics,
)
from jezero.cli.camera import camera
from jezero.deploy.launcher.compose import shipped_compose_file

ROS = """
image_width: 640
image_height: 480
camera_name: head
camera_matrix: {rows: 3, cols: 3, data: [421.5, 0, 318.2, 0, 422.5, 241.7, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [-0.2, 0.05, 0.001, -0.002, 0.0]}
projection_matrix: {rows: 3, cols: 4, data: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]}
"""
KALIBR = """
cam0:
  cam_overlaps: []
  camera_model: pinhole
  distortion_coeffs: [-0.01, 0.02, -0.003, 0.001]
  distortion_model: equidistant
  intrinsics: [461.6, 460.3, 362.7, 248.1]
  resolution: [752, 480]
  rostopic: /cam0/image_raw
cam1:
  camera_model: pinhole
  distortion_coeffs: [-0.28, 0.07, 0.0002, 0.00002]
  distortion_model: radtan
  intrinsics: [457.5, 456.1, 379.9, 255.2]
  resolution: [752, 480]
"""
SHIPPED = shipped_compose_file().parent / "config" / "vehicle.toml"


def written(folder: Path, text: str) -> Path:
    path = folder / "camera.yaml"
    path.write_text(text)
    return path


def test_a_file_of_ros_is_read(tmp_path: Path) -> None:
    assert read_intrinsics(written(tmp_path, ROS)) == CameraIntrinsics(
        (640, 480), (421.5, 422.5), (318.2, 241.7), "plumb_bob", (-0.2, 0.05, 0.001, -0.002, 0.0)
    )


def test_a_rational_lens_of_ros_is_read_and_written_back(tmp_path: Path) -> None:
    eight = (0.5, 0.05, 0.0005, -0.0004, 0.002, 0.9, 0.15, 0.01)
    found = CameraIntrinsics((640, 480), (421.5, 422.5), (318.2, 241.7), "rational_polynomial", eight)
    assert read_intrinsics(written(tmp_path, ros_yaml(found, "head"))) == found


def test_both_cameras_of_kalibr_are_read_and_radtan_gets_its_k3(tmp_path: Path) -> None:
    path = written(tmp_path, KALIBR)
    first, second = read_intrinsics(path), read_intrinsics(path, "cam1")
    assert (first.model, first.distortion) == ("equidistant", (-0.01, 0.02, -0.003, 0.001))
    assert (second.model, second.distortion) == ("plumb_bob", (-0.28, 0.07, 0.0002, 0.00002, 0.0))
    assert (second.size_px, second.focal_px, second.center_px) == ((752, 480), (457.5, 456.1), (379.9, 255.2))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "neither a camera_info file of ROS nor a camchain of Kalibr"),
        ("- 1", "neither a camera_info"),
        ("a: [", "is not YAML"),
        ("x: " + "[" * 5000, "is not YAML"),
        (ROS.replace("plumb_bob", "thin_prism"), "'thin_prism' is none of"),
        (ROS.replace("-0.002, 0.0]", "-0.002]"), None),
        (ROS.replace("-0.002, 0.0]", "]"), "plumb_bob has 5 coefficients, not 3"),
        (ROS.replace("[421.5, 0,", "[nan, 0,"), "expected"),
        (ROS.replace("[421.5, 0,", "[.nan, 0,"), "fx_px"),
        (ROS.replace("[421.5, 0,", "[-5.0, 0,"), "fx_px"),
        (ROS.replace("image_width: 640", "image_width: wide"), "image_width"),
        (ROS.replace(", 0, 0, 1]", "]"), "camera_matrix has 6 numbers"),
        (KALIBR.replace("pinhole", "omni"), "'omni' is not known here"),
        (KALIBR.replace("equidistant", "fov"), "'fov' is none of radtan, equidistant"),
        (KALIBR.replace("resolution: [752, 480]\n  ros", "ros"), "resolution"),
    ],
)
def test_what_is_no_calibration_is_refused_with_a_reason(tmp_path: Path, text: str, words: str | None) -> None:
    path = written(tmp_path, text)
    if words is None:
        read_intrinsics(path)  # four coefficients of plumb_bob have no k3
        return
    with pytest.raises(IntrinsicsError, match=words):
        read_intrinsics(path)


def test_a_camera_that_the_file_lacks_is_named_with_those_there_are(tmp_path: Path) -> None:
    with pytest.raises(IntrinsicsError, match="no camera cam7; there are cam0, cam1"):
        read_intrinsics(written(tmp_path, KALIBR), "cam7")
    with pytest.raises(IntrinsicsError, match="can't be read: No such file"):
        read_intrinsics(tmp_path / "lost.yaml")


@pytest.mark.parametrize("times", [1, 2])
def test_the_settings_get_the_lens_and_keep_every_other_line(tmp_path: Path, times: int) -> None:
    found = read_intrinsics(written(tmp_path, KALIBR))
    text = SHIPPED.read_text()
    for _ in range(times):
        text = with_intrinsics(text, found)
    made = msgspec.toml.decode(text, type=VehicleConfig).camera
    assert (made.focal_px, made.center_px, made.width_px) == (461.6, (362.7, 248.1), 752)
    assert (made.distortion_model, made.distortion) == ("equidistant", found.distortion)
    lines = set(toml_lines(found))
    names = {line.partition(" ")[0] for line in lines}
    kept = [line for line in SHIPPED.read_text().splitlines() if line.lstrip("# ").partition(" ")[0] not in names]
    assert [line for line in text.splitlines() if line not in lines] == kept


def test_a_lens_that_is_set_already_is_replaced_where_it_stands() -> None:
    found = CameraIntrinsics((640, 480), (421.5, 422.5), (318.2, 241.7), "plumb_bob", (-0.2, 0.05, 0.001, -0.002, 0.0))
    before = (
        "[camera]\nrate_hz = 10.0 # slow\ndistortion = [\n  0.1, 0, 0,\n  0, 0,\n]\nwidth_px = 320 # small\n\n"
        "[uwb]\nrange_max_m = 9.0\n"
    )
    text = with_intrinsics(before, found)
    made = msgspec.toml.decode(text, type=VehicleConfig)
    assert made.camera.distortion == found.distortion and made.camera.rate_hz == 10.0 and made.uwb.range_max_m == 9.0
    assert "width_px = 640 # small" in text and "rate_hz = 10.0 # slow" in text
    alone = with_intrinsics("[uwb]\nrange_max_m = 9.0\n", found)
    assert msgspec.toml.decode(alone, type=VehicleConfig).camera.fx_px == 421.5


def test_the_command_prints_the_lines_or_writes_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path, ROS)
    (tmp_path / "vehicle.toml").write_text(SHIPPED.read_text())
    monkeypatch.setenv("JEZERO_CONFIG_DIR", str(tmp_path))
    done = CliRunner().invoke(camera, ["intrinsics", str(path)])
    assert done.exit_code == 0 and "fx_px = 421.5\nfy_px = 422.5" in done.output
    assert (tmp_path / "vehicle.toml").read_text() == SHIPPED.read_text()
    done = CliRunner().invoke(camera, ["intrinsics", str(path), "--write"])
    assert done.exit_code == 0, done.output
    assert "\nfx_px = 421.5\n" in (tmp_path / "vehicle.toml").read_text()
    done = CliRunner().invoke(camera, ["intrinsics", str(tmp_path / "lost.yaml")])
    assert done.exit_code == 1 and "can't be read" in done.output
