"""A recording as a rosbag2: readers that are not ours read in it what the recording has."""

from math import inf
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from jezero.base.vehicle_config import VehicleConfig
from jezero.cli.main import main
from jezero.recording import open_recording
from jezero.services.ros2_bridge.bag import MessageBuilder, Version, write_bag
from jezero.services.ros2_bridge.geometry import RosMessage, header
from tests.recording.rig import record

VEHICLE = VehicleConfig()


def run(*words: str) -> Result:
    return CliRunner().invoke(main, words)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("run") / "flight.mcap")


@pytest.mark.parametrize(("version", "store"), [(8, Stores.ROS2_HUMBLE), (9, Stores.ROS2_JAZZY)])
def test_a_bag_has_the_messages_of_the_recording(path: Path, tmp_path: Path, version: Version, store: Stores) -> None:
    bag = tmp_path / "bag"
    counts = write_bag(open_recording(path), bag, VEHICLE, vehicle="uav1", version=version)
    assert counts["/uav1/altimeter"] == 30 and counts["/uav1/odometry"] == 3 and counts["/clock"] == 3
    ranges_m: list[float] = []
    odometry: list[Any] = []
    with AnyReader([bag], default_typestore=get_typestore(store)) as reader:
        assert {c.topic: c.msgcount for c in reader.connections} == counts
        for connection, t_ns, data in reader.messages():
            message: Any = reader.deserialize(data, connection.msgtype)
            if connection.topic == "/uav1/altimeter":
                assert t_ns == message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
                ranges_m.append(message.range)
            elif connection.topic == "/uav1/odometry":
                odometry.append(message)
    assert ranges_m[0] == inf and ranges_m[1:4] == pytest.approx([0.1, 0.2, 0.3])
    at = odometry[0].pose.pose.position
    assert (at.x, at.y, at.z) == pytest.approx((2.0, 1.0, 2.0 + VEHICLE.airframe.height_stand_m))
    assert odometry[0].child_frame_id == "uav1/base_link"


def test_a_bag_in_an_mcap_file_is_read_by_the_library_of_mcap(path: Path, tmp_path: Path) -> None:
    write_bag(open_recording(path), tmp_path / "bag", VEHICLE, vehicle="uav1", mcap=True)
    (file,) = (tmp_path / "bag").glob("*.mcap")
    with file.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        decoded = [(c.topic, m) for _, c, _, m in reader.iter_decoded_messages(topics=["/uav1/altimeter"])]
    assert len(decoded) == 30
    assert decoded[3][1].range == pytest.approx(0.3)


def test_a_bag_is_never_written_over_another(path: Path, tmp_path: Path) -> None:
    done = run("recording", "export", str(path), "--rosbag2", str(tmp_path))
    assert done.exit_code != 0
    assert "exists already" in done.output


def test_tables_or_a_bag_one_of_them(path: Path) -> None:
    done = run("recording", "export", str(path))
    assert "give --csv FOLDER for tables, or --rosbag2 FOLDER" in done.output


def test_a_field_that_a_type_does_not_have_is_an_error() -> None:
    with pytest.raises(ValueError, match="has no field lenght"):
        MessageBuilder(9).build(RosMessage("sensor_msgs/msg/Range", {"header": header(0, ""), "lenght": 1.0}))
