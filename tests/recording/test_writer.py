"""Recordings as other programs read them: the rules that `mcap doctor` and viewers check."""

import json
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from jezero.base.camera_preview import preview_of
from jezero.base.codec import encode
from jezero.recording import open_recording
from jezero.recording.channels import json_schema, keys_without_images, schema_name
from jezero.recording.images import ImageFormat
from jezero.recording.writer import RecordingWriter
from jezero.schemas import topics
from jezero.schemas.sensors import Altimeter, CameraFrame
from tests.recording.doctor import chunks_of, examine
from tests.recording.rig import ABOUT, SECOND_NS, record

FRAME = CameraFrame(
    t_ns=7, sequence=1, width_px=64, height_px=48, pitch_camera_rad=-1.5, exposure_s=0.004, pixels=bytes([120]) * 9216
)


def test_a_finished_file_has_a_summary_with_every_channel_schema_and_chunk(tmp_path: Path) -> None:
    path = record(tmp_path / "flight.mcap")
    assert examine(path) == {"clock": 3, "odometry": 3, "sensor/altimeter": 30, "status": 3}
    with path.open("rb") as file:
        assert next(make_reader(file).iter_metadata()).metadata == ABOUT


def test_times_never_decrease_and_every_message_comes_after_its_channel_and_schema(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    with RecordingWriter(path, {}) as writer:
        for t_ns in (5, 9, 7, 20 * SECOND_NS, 8):
            writer.write(t_ns, topics.ALTIMETER.name, encode(Altimeter(t_ns=t_ns, range_m=1.0)))
    examine(path)
    with path.open("rb") as file:
        times_ns = [message.log_time for _, _, message in make_reader(file).iter_messages()]
    assert times_ns == [5, 9, 9, 20 * SECOND_NS, 20 * SECOND_NS]


def test_a_chunk_is_closed_once_a_second(tmp_path: Path) -> None:
    chunks = chunks_of(record(tmp_path / "flight.mcap", seconds=10))
    assert len(chunks) == 10
    assert all(chunk.message_end_time - chunk.message_start_time < SECOND_NS for chunk in chunks)


def test_the_same_messages_give_the_same_bytes(tmp_path: Path) -> None:
    assert record(tmp_path / "a.mcap").read_bytes() == record(tmp_path / "b.mcap").read_bytes()


def test_an_image_is_recorded_as_a_jpeg_that_viewers_show_and_its_other_fields_beside_it(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    with RecordingWriter(path, {}, image_format=ImageFormat("jpeg", 90)) as writer:
        writer.write(7, topics.CAMERA.name, encode(FRAME))
    with path.open("rb") as file:
        header, image = make_reader(file).iter_messages()
    assert header[1].topic == "sensor/camera/header" and json.loads(header[2].data)["width_px"] == 64
    assert image[0] is not None and image[0].name == "foxglove.CompressedImage"
    assert json.loads(image[2].data)["format"] == "jpeg"
    ((frame, pixels),) = open_recording(path).images()
    assert frame.t_ns == 7
    assert pixels.shape == (48, 64, 3)
    assert np.abs(pixels.astype(int) - 120).max() < 5


def test_previews_are_left_out_as_the_images_show_more(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    with RecordingWriter(path, {}, image_format=ImageFormat("jpeg", 90)) as writer:
        writer.write(7, topics.CAMERA.name, encode(FRAME))
        writer.write(8, topics.CAMERA_PREVIEW.name, encode(preview_of(FRAME)))
    with path.open("rb") as file:
        found = {message[1].topic for message in make_reader(file).iter_messages()}
    assert found == {"sensor/camera", "sensor/camera/header"}


def test_live_viewers_are_sent_neither_images_nor_previews_without_asking() -> None:
    keys = keys_without_images()
    assert topics.CAMERA_INFO.name in keys
    assert not {topics.CAMERA.name, topics.CAMERA_PREVIEW.name, "sensor/camera/header"} & set(keys)


def test_an_image_recorded_as_a_png_has_every_pixel_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    noise = np.random.default_rng(0).integers(0, 256, (48, 64, 3), np.uint8)
    with RecordingWriter(path, {}, image_format=ImageFormat("png")) as writer:
        writer.write(7, topics.CAMERA.name, encode(FRAME.with_attachment(noise.tobytes())))
    ((_, pixels),) = open_recording(path).images()
    assert np.array_equal(pixels, noise)


def test_without_a_format_images_are_recorded_without_pixels(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    with RecordingWriter(path, {}) as writer:
        writer.write(7, topics.CAMERA.name, encode(FRAME))
    assert open_recording(path).summary().counts == {"sensor/camera/header": 1}


@pytest.mark.parametrize("topic", [key for key in keys_without_images() if "*" not in key])
def test_each_topic_has_a_schema_of_an_object_without_references(topic: str) -> None:
    schema = json.loads(json_schema(topic))
    assert schema["type"] == "object" and schema["properties"]["t_ns"]["type"] == "integer"
    assert b"$ref" not in json_schema(topic) and b"prefixItems" not in json_schema(topic)


def test_health_and_unknown_topics_have_a_schema_too() -> None:
    assert schema_name("health/estimator") == "jezero.ServiceHealth"
    assert schema_name("mine/own") == "jezero.Message"
    assert json.loads(json_schema("mine/own")) == {"type": "object", "properties": {}}
