"""Recordings as rosbags, and rosbags as recordings: through the estimator both are the same flight."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Writer

from jezero.base.codec import encode
from jezero.base.vehicle_config import VehicleConfig
from jezero.cli.main import main
from jezero.recording import RecordingError, open_recording
from jezero.recording.writer import RecordingWriter
from jezero.replay.rosbag import import_bag
from jezero.replay.through import replay_through
from jezero.schemas import topics
from jezero.schemas.estimate import Lease, Relative, SetParameters
from jezero.schemas.goals import TakeoffGoal
from jezero.schemas.sensors import RoverOdometry
from jezero.schemas.state import Odometry
from jezero.services.ros2_bridge import conversions as make
from jezero.services.ros2_bridge.bag import BagWriter, MessageBuilder, write_bag
from jezero.services.ros2_bridge.conversions import Context
from jezero.services.ros2_bridge.exact import from_exact, to_exact
from jezero.services.ros2_bridge.geometry import RosMessage, header
from jezero.services.ros2_bridge.rows import EXACT, ROWS, exact_name
from jezero.trials.flight import fly_virtually
from jezero.trials.missions import FLIGHT
from jezero.trials.stack import build_stack

pytestmark = pytest.mark.xdist_group("rosbag")
"""One worker makes the recordings, once."""

VEHICLE = VehicleConfig()
WALL_NS = 1_700_000_000_000_000_000
"""Time at which somebody's bag begins, by a clock of the wall."""
OTHER_NAMES = {"/odom": "odometry", "/husky/odom": "rover/odometry", "/lidar": "sensor/altimeter"} | {
    f"/uwb/{i}": "sensor/uwb" for i in range(4)
}
LATE_MAX = 2
"""Number of estimates after which the bridge's lease has its effect: it is made from the first one."""
FEW = settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A takeoff, during which the estimator is asked for other parameters, and for other inputs."""
    path = tmp_path_factory.mktemp("flight") / "flight.mcap"
    with RecordingWriter(path, {}) as writer:
        bus = build_stack(3, journal_reader=writer.write)
        bus.observe(writer.write)
        bus.run_for(6.0)
        bus.send_request(topics.SET_PARAMETERS, SetParameters(std_uwb_m=0.11, pos_rover_ned_m=(0.5, 0.0, 0.0)))
        bus.run_for(2.0)
        bus.send_request(topics.TAKEOFF.endpoint, TakeoffGoal(altitude_m=4.0))
        bus.run_for(9.0)
        bus.send_request(topics.LEASE, Lease(goal_id="a-goal", use_uwb=True, use_tag=False))
        bus.run_for(4.0)
        bus.end_journals()
    return path


@pytest.fixture(scope="module")
def bag(flight: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bags") / "bag"
    write_bag(open_recording(flight), folder, VEHICLE, vehicle="uav1", images=False)
    return folder


@pytest.fixture(scope="module")
def foreign(flight: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag that others have recorded, by the clock of the wall, with messages that everybody has."""
    folder = tmp_path_factory.mktemp("bags") / "foreign"
    write_foreign(flight, folder)
    return folder


def write_foreign(flight: Path, folder: Path, left_out: str = "") -> None:
    """Write the flight's measurements, but for one topic, as a bag that nobody of jezero has made."""
    context = Context("robot", VEHICLE)
    names: dict[str, tuple[str, Callable[..., RosMessage]]] = {
        topics.ODOMETRY.name: ("/odom", make.odometry),
        topics.ROVER_ODOMETRY.name: ("/husky/odom", make.rover_odometry),
        topics.ALTIMETER.name: ("/lidar", make.altitude_range),
    }
    with Writer(folder, version=9) as writer:
        writer_of = BagWriter(writer, MessageBuilder(9), "robot")
        for entry in open_recording(flight).messages(topics.UWB, *names):
            at_ns = WALL_NS + entry.logged_ns
            if entry.topic in names:
                name, convert = names[entry.topic]
                if name != left_out:
                    writer_of.write(name, "state", at_ns, convert(entry.message, context))
                continue
            for reading in entry.message.ranges:
                fields = {"header": header(reading.t_ns, f"a{reading.anchor}"), "range": reading.range_m}
                writer_of.write(f"/uwb/{reading.anchor}", "sensor", at_ns, RosMessage("sensor_msgs/msg/Range", fields))


def estimates(path: Path) -> list[bytes]:
    """All that the estimator has published, in its order."""
    entries = open_recording(path).messages(topics.RELATIVE, topics.ROVER_ESTIMATE)
    return [encode(entry.message) for entry in entries]


def relative(path: Path) -> dict[int, Relative]:
    return {entry.message.t_ns: entry.message for entry in open_recording(path).messages(topics.RELATIVE)}


def run(*words: str | Path) -> Result:
    return CliRunner().invoke(main, [str(word) for word in words])


@pytest.mark.parametrize("options", [{}, {"mcap": True}, {"version": 8}])
def test_a_flight_that_went_through_a_bag_has_the_same_estimates_bit_by_bit(
    flight: Path, tmp_path: Path, options: dict[str, Any]
) -> None:
    write_bag(open_recording(flight), tmp_path / "bag", VEHICLE, vehicle="uav1", images=False, **options)
    done = import_bag(tmp_path / "bag", tmp_path / "again.mcap", namespace="uav1")
    assert done.has_settings and not done.left_out
    before = estimates(flight)
    assert len(before) > 500
    assert estimates(tmp_path / "again.mcap") == before


def test_what_came_out_of_a_bag_is_replayed_as_the_flight_is(flight: Path, bag: Path, tmp_path: Path) -> None:
    again = tmp_path / "again.mcap"
    import_bag(bag, again, namespace="uav1")
    replay = replay_through(again, "estimator")
    assert replay.identical and replay.outputs > 500
    assert replay.published == replay_through(flight, "estimator").published
    changes = {"std_uwb_m": "0.05"}
    changed = replay_through(again, "estimator", changes)
    assert changed.different and changed.published == replay_through(flight, "estimator", changes).published


def test_the_requests_to_the_estimator_are_in_the_bag(bag: Path, tmp_path: Path) -> None:
    import_bag(bag, tmp_path / "again.mcap", namespace="uav1")
    found = relative(tmp_path / "again.mcap").values()
    assert {each.parameters_version for each in found} == {0, 1}
    assert {each.goal_id for each in found} == {"", "a-goal"}
    assert all(each.use_tag is (each.goal_id != "a-goal") for each in found)


def test_the_selection_that_the_bridge_has_seen_is_that_of_the_estimator_that_reads_the_bag(
    flight: Path, tmp_path: Path
) -> None:
    context, rows = Context("uav1", VEHICLE), [row for row in ROWS if row.name.startswith(EXACT)]
    with Writer(tmp_path / "bag", version=9) as writer:
        recorded = BagWriter(writer, MessageBuilder(9), "uav1")
        # A latched message comes first, and a bag of `ros2 bag record` has the times of the wall's clock.
        parameters = to_exact(SetParameters(std_uwb_m=0.11))
        recorded.write(exact_name(topics.SET_PARAMETERS), "latched", WALL_NS, parameters)
        for entry in open_recording(flight).messages():
            for row in rows:
                if row.source.name == entry.topic and (made := row.convert(entry.message, context)) is not None:
                    recorded.write(row.name, row.quality, WALL_NS + entry.logged_ns, made)
    done = import_bag(tmp_path / "bag", tmp_path / "again.mcap", namespace="uav1")
    assert not done.left_out and not done.has_settings
    before, again = relative(flight), relative(tmp_path / "again.mcap")
    assert {each.parameters_version for each in again.values()} == {1}
    differ = [t_ns for t_ns in before if t_ns in again and again[t_ns].goal_id != before[t_ns].goal_id]
    assert len(differ) <= 2 * LATE_MAX, "where the lease begins and where it ends"
    leased = {t_ns for t_ns, each in again.items() if each.goal_id}
    assert len(leased) > 100
    assert all(each.use_tag is (t_ns not in leased) for t_ns, each in again.items())


@pytest.mark.long
def test_a_landing_on_the_rover_comes_back_whole(tmp_path: Path) -> None:
    path, again = tmp_path / "flight.mcap", tmp_path / "again.mcap"
    assert fly_virtually(FLIGHT, 1, path).result == "succeeded"
    write_bag(open_recording(path), tmp_path / "bag", VEHICLE, vehicle="uav1", images=False)
    import_bag(tmp_path / "bag", again, namespace="uav1")
    assert estimates(again) == estimates(path)
    truth = [[encode(e.message) for e in open_recording(each).messages(topics.TRUTH)] for each in (path, again)]
    assert truth[0] == truth[1]


def test_a_bag_of_others_finds_the_rover_where_the_flight_did(flight: Path, foreign: Path, tmp_path: Path) -> None:
    done = import_bag(foreign, tmp_path / "theirs.mcap", namespace="uav1", names=OTHER_NAMES)
    assert not done.has_settings and not done.left_out
    before, after = relative(flight), relative(tmp_path / "theirs.mcap")
    valid = [t_ns for t_ns in before.keys() & after.keys() if before[t_ns].valid and after[t_ns].valid]
    assert len(valid) > 50
    away_m = [
        np.linalg.norm(np.subtract(before[t_ns].pos_uav_rel_rover_ned_m, after[t_ns].pos_uav_rel_rover_ned_m))
        for t_ns in valid
    ]
    assert max(away_m) < 1.0, "without the requests and the tags of the flight"
    rounds = [entry.message for entry in open_recording(tmp_path / "theirs.mcap").messages(topics.UWB)]
    assert max(len(each.ranges) for each in rounds) == 4, "single ranges become rounds"
    assert replay_through(tmp_path / "theirs.mcap", "estimator").identical


def test_odometry_of_nav_msgs_changes_the_estimate_by_rounding_only(flight: Path, bag: Path, tmp_path: Path) -> None:
    """The whole messages of the odometries become standard ones, at the same times."""
    context = Context("uav1", VEHICLE)
    standard: dict[str, tuple[str, Any, Callable[..., RosMessage]]] = {
        "/uav1/jezero/odometry": ("odometry", Odometry, make.odometry),
        "/uav1/jezero/rover/odometry": ("rover/odometry", RoverOdometry, make.rover_odometry),
    }
    with AnyReader([bag]) as reader, Writer(tmp_path / "bag", version=9) as writer:
        theirs, connections = BagWriter(writer, MessageBuilder(9), "uav1"), {}
        for connection, t_ns, data in reader.messages():
            if connection.topic in standard:
                name, struct, convert = standard[connection.topic]
                whole = from_exact(struct, reader.deserialize(data, connection.msgtype))
                theirs.write(name, "state", t_ns, convert(whole, context))
            elif "/jezero/" in connection.topic:
                if connection.topic not in connections:
                    connections[connection.topic] = writer.add_connection(
                        connection.topic, connection.msgtype, typestore=reader.typestore
                    )
                writer.write(connections[connection.topic], t_ns, data)
    import_bag(tmp_path / "bag", tmp_path / "again.mcap", namespace="uav1")
    before, after = relative(flight), relative(tmp_path / "again.mcap")
    both = [t_ns for t_ns in before.keys() & after.keys() if before[t_ns].valid]
    assert len(both) > 100
    for t_ns in both:
        assert after[t_ns].valid
        assert after[t_ns].pos_uav_rel_rover_ned_m == pytest.approx(before[t_ns].pos_uav_rel_rover_ned_m, abs=1e-6)


@pytest.mark.parametrize(
    ("left_out", "sentence"),
    [
        ("/odom", "/odom=odometry: .* has no messages of /odom"),
        ("/husky/odom", "/husky/odom=rover/odometry: .* has no messages"),
    ],
)
def test_a_topic_that_the_bag_lacks_is_named(flight: Path, tmp_path: Path, left_out: str, sentence: str) -> None:
    write_foreign(flight, tmp_path / "bag", left_out)
    with pytest.raises(RecordingError, match=sentence):
        import_bag(tmp_path / "bag", tmp_path / "x.mcap", namespace="uav1", names=OTHER_NAMES)
    names = {ros: source for ros, source in OTHER_NAMES.items() if ros != left_out}
    with pytest.raises(RecordingError, match=f"lacks the {'rover' if 'husky' in left_out else 'vehicle'}'s odometry"):
        import_bag(tmp_path / "bag", tmp_path / "x.mcap", namespace="uav1", names=names)
    assert [each.name for each in tmp_path.iterdir()] == ["bag"]


def test_a_bag_without_any_needed_topic_is_refused_with_all_of_them_and_what_it_has(
    foreign: Path, tmp_path: Path
) -> None:
    done = run("recording", "import", foreign, tmp_path / "x.mcap")
    assert done.exit_code == 1
    for part in ("vehicle's odometry (/uav1/jezero/odometry or /uav1/odometry)", "rover's odometry", "UWB ranges"):
        assert part in done.output
    assert "/husky/odom (nav_msgs/msg/Odometry)" in done.output
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("mapping", "sentence"),
    [
        ("/odom=odo", "'odo' is no input of the estimator; there are clock, odometry"),
        ("/lidar=odometry", "/lidar has the type sensor_msgs/msg/Range; odometry is made from jezero_interfaces"),
        ("/odom", "give the bag's name and jezero's, such as --topic /odom=odometry"),
        ("=odometry", "give the bag's name and jezero's"),
    ],
)
def test_a_wrong_mapping_is_refused(foreign: Path, tmp_path: Path, mapping: str, sentence: str) -> None:
    done = run("recording", "import", foreign, tmp_path / "x.mcap", "--topic", mapping)
    assert done.exit_code != 0
    assert sentence in done.output
    assert not list(tmp_path.iterdir())


def test_messages_that_are_not_usable_are_counted_and_named(flight: Path, tmp_path: Path) -> None:
    write_foreign(flight, tmp_path / "bag")
    with Writer(tmp_path / "worse", version=9) as writer:
        theirs = BagWriter(writer, MessageBuilder(9), "robot")
        empty = RosMessage("nav_msgs/msg/Odometry", {"header": header(1, "odom")})
        for i, name in enumerate(("/odom", "/husky/odom")):
            theirs.write(name, "state", WALL_NS + i, empty)
        theirs.write("/uwb/0", "sensor", WALL_NS, RosMessage("sensor_msgs/msg/Range", {"header": header(1, "a0")}))
    names = [word for ros, source in OTHER_NAMES.items() if ros in ("/odom", "/husky/odom", "/uwb/0")
             for word in ("--topic", f"{ros}={source}")]  # fmt: skip
    done = run("recording", "import", tmp_path / "worse", tmp_path / "x.mcap", *names)
    assert done.exit_code == 1
    assert (
        "has no usable message of the vehicle's odometry: /odom: its orientation is no unit quaternion" in done.output
    )
    assert not list(tmp_path.glob("*.mcap*"))


def test_neither_a_recording_nor_a_bag_is_written_over(bag: Path, flight: Path, tmp_path: Path) -> None:
    target = tmp_path / "flight.mcap"
    target.write_bytes(b"mine")
    assert "exists already" in run("recording", "import", bag, target).output
    assert target.read_bytes() == b"mine"


def test_a_bag_in_the_place_of_a_recording_is_refused_with_what_to_do(bag: Path, flight: Path, tmp_path: Path) -> None:
    done = run("replay", bag, "--through", "estimator")
    assert done.exit_code == 1
    assert f"is a rosbag2: `jezero recording import {bag}" in done.output
    for other in (flight, flight.parent):
        done = run("recording", "import", other, tmp_path / "x.mcap")
        assert done.exit_code == 1 and "no rosbag2" in done.output


@pytest.mark.parametrize("mcap", [True, False])
def test_the_one_file_of_a_bag_is_a_bag_too(flight: Path, tmp_path: Path, mcap: bool) -> None:
    write_bag(open_recording(flight), tmp_path / "bag", VEHICLE, vehicle="uav1", images=False, mcap=mcap)
    (file,) = (each for each in (tmp_path / "bag").iterdir() if each.suffix in (".mcap", ".db3"))
    done = import_bag(file, tmp_path / "x.mcap", namespace="uav1")
    assert done.counts["estimate/relative"] > 500


@FEW
@given(st.data(), st.booleans())
def test_a_damaged_bag_is_a_sentence_or_a_recording(
    damaged_bags: dict[bool, Path], tmp_path_factory: pytest.TempPathFactory, data: Any, mcap: bool
) -> None:
    folder = tmp_path_factory.mktemp("damaged")
    shutil.copytree(damaged_bags[mcap], folder / "bag")
    files = sorted(each for each in (folder / "bag").iterdir())
    file = data.draw(st.sampled_from(files))
    content = bytearray(file.read_bytes())
    at = data.draw(st.integers(0, len(content) - 1))
    if data.draw(st.booleans()):
        content = content[:at]
    else:
        content[at : at + 8] = data.draw(st.binary(min_size=1, max_size=8))
    file.write_bytes(content)
    target = folder / "x.mcap"
    try:
        import_bag(folder / "bag", target, namespace="uav1")
    except RecordingError as error:
        assert str(folder) in str(error)
        assert sorted(each.name for each in folder.iterdir()) == ["bag"], "nothing half-written stays"
    else:
        assert open_recording(target).summary().problem == ""
    shutil.rmtree(folder)


@pytest.fixture(scope="module")
def damaged_bags(tmp_path_factory: pytest.TempPathFactory) -> dict[bool, Path]:
    """Short bags, by whether they are MCAP files."""
    folder = tmp_path_factory.mktemp("short")
    with RecordingWriter(folder / "flight.mcap", {}) as writer:
        bus = build_stack(3, journal_reader=writer.write)
        bus.observe(writer.write)
        bus.run_for(2.0)
        bus.end_journals()
    recording = open_recording(folder / "flight.mcap")
    for mcap in (True, False):
        write_bag(recording, folder / f"bag-{mcap}", VEHICLE, vehicle="uav1", images=False, mcap=mcap)
    return {mcap: folder / f"bag-{mcap}" for mcap in (True, False)}
