"""A rosbag2 as a recording: the estimator runs on what the bag has, and its journal is recorded.

From then on the flight is a recording as any other: it can be replayed, drawn and tuned with.
"""

import sqlite3
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from typing import Any

import msgspec
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader, ReaderError

from jezero.base.codec import decode, encode
from jezero.base.config import load_config
from jezero.base.files import describe_os_error
from jezero.base.vehicle_config import VehicleConfig
from jezero.recording.about import about
from jezero.recording.journals import ServiceRun
from jezero.recording.mcap_file import BAD_BYTES, RecordingError
from jezero.recording.viewer_scene import ViewerScene
from jezero.recording.writer import RecordingWriter
from jezero.replay.rebuild import SettingError, make_service
from jezero.runtime.journal import Journal, class_of
from jezero.runtime.node import Node, SilentTransport
from jezero.runtime.service import Service
from jezero.schemas import topics
from jezero.schemas.rows import Endpoint, Topic
from jezero.schemas.sensors import Uwb, UwbRange
from jezero.schemas.state import Clock, Odometry
from jezero.schemas.units import NS_PER_S
from jezero.services.estimator.config import EstimatorConfig
from jezero.services.estimator.service import Estimator
from jezero.services.ros2_bridge.bag import ESTIMATOR, MADE_WITH, typestore_of
from jezero.services.ros2_bridge.exact import PACKAGE
from jezero.services.ros2_bridge.inputs import INPUTS, NEEDED, RosInput, single_range

BOOT_ID = 1
CLIENT = "rosbag"
SAME_CLOCK_MAX_NS = 10 * NS_PER_S
"""A bag whose times differ by less than this from those in its messages was recorded in vehicle time."""
BAD_BAG = (AnyReaderError, ReaderError, sqlite3.Error, LookupError, TypeError, AssertionError, *BAD_BYTES)
"""What the library raises for a damaged bag."""
ROUND_MAX_NS = 100_000_000
"""Time between the first and the last range of a round of UWB."""
FILES = (".mcap", ".db3")
"""Files of a bag, of which one alone can be read too."""
SHOWN_TOPICS_MAX = 30


@dataclass
class Imported:
    """What became of a bag.

    Attributes:
        has_settings: whether the estimator had the settings of the flight, which bags of `jezero recording export`
            have; else those of this computer.
        sources: topic of ROS and type, for each topic of jezero.
        counts: number of messages of each topic that were recorded, with what the estimator has published.
        left_out: number of messages of each topic of ROS that were not usable.
        reasons: why the first of these was not.
    """

    has_settings: bool = False
    sources: list[tuple[str, str, str]] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)
    left_out: Counter[str] = field(default_factory=Counter)
    reasons: dict[str, str] = field(default_factory=dict)


def import_bag(bag: Path, target: Path, *, namespace: str, names: Mapping[str, str] | None = None) -> Imported:
    """Write a rosbag2 as a recording, with the journal and the estimates of an estimator that read it.

    Args:
        bag: the bag's folder, or its one file.
        target: the new recording.
        namespace: the vehicle's, in the names of the bag's topics.
        names: topics of jezero by those of the bag, for topics with other names than the bridge's.

    Raises:
        RecordingError: the bag can't be read, or lacks what the estimator needs, or a topic is wrong.
        ConfigError: settings of this computer can't be read.
        OSError: the recording can't be written, or exists already.
    """
    if target.exists():
        raise FileExistsError(17, "it exists already: name a new file", str(target))
    if not (bag / "metadata.yaml").is_file() and bag.suffix not in FILES:
        raise RecordingError(f"{bag} is no rosbag2: give the folder in which its metadata.yaml is, or its one file")
    imported = Imported()
    new = target.with_name(f"{target.name}.new")
    try:
        with _opened(bag) as reader:
            chosen = _chosen(bag, reader, namespace, names or {})
            imported.sources = [(each.source.name, c.topic, c.msgtype) for c, each in chosen]
            made_with = _made_with(bag, reader)
            imported.has_settings = made_with is not None
            service, vehicle = _estimator(bag, made_with)
            with RecordingWriter(new, about(bag=bag.name, vehicle=namespace), scene=ViewerScene(vehicle)) as writer:
                _run(_messages(bag, reader, chosen, vehicle, imported), _Player(service, writer, imported.counts))
        for what, sources in NEEDED:
            if not any(imported.counts[source.name] for source in sources):
                raise RecordingError(f"{bag} has no usable message of {what}: {_first_reason(imported)}")
        new.replace(target)
    finally:
        new.unlink(missing_ok=True)
    return imported


@contextmanager
def _opened(bag: Path) -> Iterator[AnyReader]:
    """The bag, opened.

    Raises:
        RecordingError: it can't be read.
    """
    try:
        reader = AnyReader([bag], default_typestore=typestore_of(8))
        reader.open()
    except BAD_BAG as error:
        raise _damaged(bag, error) from None
    except OSError as error:
        raise RecordingError(describe_os_error(error)) from None
    try:
        _check_version(bag, reader)
        yield reader
    finally:
        reader.close()


def _check_version(bag: Path, reader: AnyReader) -> None:
    """Refuse whole messages of jezero that have other fields here."""
    own = typestore_of(9)
    for kind in {connection.msgtype for connection in reader.connections} & own.fielddefs.keys():
        if kind.startswith(f"{PACKAGE}/") and reader.typestore.hash_rihs01(kind) != own.hash_rihs01(kind):
            raise RecordingError(
                f"{bag}: its {kind} is of another version of jezero: import the bag with the version that recorded it"
            )


def _damaged(bag: Path, error: BaseException) -> RecordingError:
    what = " ".join(str(error).split()) or type(error).__name__
    return RecordingError(f"{bag} is damaged, or no rosbag2 that can be read ({what[:300]})")


# -- which topics are read ---------------------------------------------------------------------------------


def _chosen(
    bag: Path, reader: AnyReader, namespace: str, names: Mapping[str, str]
) -> list[tuple[Connection, RosInput]]:
    """The bag's topics that are read, each with the input that is made from it.

    Raises:
        RecordingError: a topic is wrong, or the bag lacks what the estimator needs.
    """
    there = {c.topic: c for c in reader.connections if c.msgcount}
    found = [_mapped(bag, there, ros, source) for ros, source in names.items()]
    taken = {each.source.name for _, each in found}
    for each in INPUTS:
        connection = there.get(f"/{namespace}/{each.name}")
        if each.source.name not in taken and connection is not None and connection.msgtype == each.type:
            taken.add(each.source.name)
            found.append((connection, each))
    missing = [
        f"{what} ({_expected(namespace, sources)})"
        for what, sources in NEEDED
        if not taken & {source.name for source in sources}
    ]
    if missing:
        shown = ", ".join(f"{name} ({c.msgtype})" for name, c in sorted(there.items())[:SHOWN_TOPICS_MAX])
        raise RecordingError(
            f"{bag} lacks {'; '.join(missing)}. Give --vehicle for another namespace than /{namespace}, or --topic for "
            f"a topic of another name, such as --topic /odom=odometry; the bag has {shown or 'no messages'}"
        )
    # The clock belongs to the epoch of whole messages; other odometry has an epoch of its own.
    exact = any(each.source is topics.ODOMETRY and each.type.startswith(PACKAGE) for _, each in found)
    return [(c, each) for c, each in found if exact or each.source is not topics.CLOCK]


def _mapped(bag: Path, there: Mapping[str, Connection], ros: str, source: str) -> tuple[Connection, RosInput]:
    """A topic that the user has named, and the input that is made from it."""
    accepted = [each for each in INPUTS if each.source.name == source]
    if not accepted:
        known = ", ".join(dict.fromkeys(each.source.name for each in INPUTS))
        raise RecordingError(f"--topic {ros}={source}: {source!r} is no input of the estimator; there are {known}")
    if ros not in there:
        raise RecordingError(f"--topic {ros}={source}: {bag} has no messages of {ros}")
    kind = there[ros].msgtype
    fitting = [each for each in accepted if each.type == kind]
    if not fitting:
        types = " or ".join(each.type for each in accepted)
        raise RecordingError(f"--topic {ros}={source}: {ros} has the type {kind}; {source} is made from {types}")
    return there[ros], fitting[0]


def _expected(namespace: str, sources: tuple[Topic[Any], ...]) -> str:
    """Topics from which one of some topics of jezero can be made."""
    names = [f"/{namespace}/{each.name}" for each in INPUTS if each.source in sources and each.name]
    return " or ".join(names)


# -- messages ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Message:
    """One message of a bag.

    Attributes:
        logged_ns: its time in the bag.
        source: topic or request of jezero.
        message: of jezero.
    """

    logged_ns: int
    source: Topic[Any] | Endpoint[Any, Any]
    message: Any


def _messages(
    bag: Path,
    reader: AnyReader,
    chosen: list[tuple[Connection, RosInput]],
    vehicle: VehicleConfig,
    imported: Imported,
) -> Iterator[_Message]:
    """The usable messages in the order of the bag; those that are not are counted.

    Raises:
        RecordingError: the bag is damaged.
    """
    inputs = {connection.id: each for connection, each in chosen}
    rounds = _Rounds(len(vehicle.uwb.pos_anchors_rover_body_m))
    for connection, logged_ns, ros in _deserialized(bag, reader, [connection for connection, _ in chosen]):
        each = inputs[connection.id]
        try:
            message = each.convert(ros, vehicle)
            decode(type(message), encode(message))  # also checks the ranges
        except ValueError as error:
            imported.left_out[connection.topic] += 1
            imported.reasons.setdefault(connection.topic, str(error))
            continue
        if isinstance(message, Uwb) and each.convert is single_range:
            yield from (_Message(logged_ns, each.source, whole) for whole in rounds.add(message))
        else:
            yield _Message(logged_ns, each.source, message)


class _Rounds:
    """Collects single UWB ranges to rounds: together they show which of them can't be.

    Args:
        anchors: number of the anchors.
    """

    def __init__(self, anchors: int) -> None:
        self._anchors = anchors
        self._open: dict[int, UwbRange] = {}

    def add(self, uwb: Uwb) -> Iterator[Uwb]:
        """Add a range; the rounds that are complete now: one that has all anchors, or one that this range is not of."""
        for reading in uwb.ranges:
            oldest_ns = min((each.t_ns for each in self._open.values()), default=reading.t_ns)
            if reading.anchor in self._open or abs(reading.t_ns - oldest_ns) > ROUND_MAX_NS:
                yield self._take()
            self._open[reading.anchor] = reading
            if len(self._open) == self._anchors:
                yield self._take()

    def _take(self) -> Uwb:
        ranges = tuple(self._open.values())
        self._open = {}
        return Uwb(t_ns=max(each.t_ns for each in ranges), ranges=ranges)


def _deserialized(bag: Path, reader: AnyReader, connections: list[Connection]) -> Iterator[tuple[Connection, int, Any]]:
    try:
        for connection, logged_ns, data in reader.messages(connections):
            yield connection, logged_ns, reader.deserialize(data, connection.msgtype)
    except BAD_BAG as error:
        raise _damaged(bag, error) from None
    except OSError as error:
        raise RecordingError(describe_os_error(error)) from None


def _first_reason(imported: Imported) -> str:
    return next((f"{name}: {reason}" for name, reason in imported.reasons.items()), "there is none")


# -- the estimator -----------------------------------------------------------------------------------------


def _made_with(bag: Path, reader: AnyReader) -> dict[str, Any] | None:
    """The recorded arguments of the estimator; None in a bag that jezero has not exported."""
    first = reader.readers[0]
    custom = (first.storage.metadata.custom if isinstance(first, Reader) else None) or {}
    if MADE_WITH not in custom:
        return None
    try:
        return msgspec.json.decode(custom[MADE_WITH], type=dict[str, Any])
    except msgspec.DecodeError as error:
        raise _damaged(bag, error) from None


def _estimator(bag: Path, made_with: dict[str, Any] | None) -> tuple[Service, VehicleConfig]:
    """The estimator, and the vehicle that it is for."""
    if made_with is None:
        config, vehicle = load_config(EstimatorConfig, "estimator"), load_config(VehicleConfig, "vehicle")
        return Estimator(config, vehicle), vehicle
    made_by = f"{Estimator.__module__}:{Estimator.__qualname__}"
    try:
        service = make_service(ServiceRun(ESTIMATOR, BOOT_ID, made_with, made_by), {})
    except SettingError as error:
        raise RecordingError(f"{bag}: the settings of its flight are of another version of jezero: {error}") from None
    return service, msgspec.convert(made_with["vehicle"], VehicleConfig)


class _Player(SilentTransport):
    """Steps the estimator with a bag's messages, and records both; the transport of its node.

    Args:
        service: the estimator.
        writer: of the recording.
        counts: is given the number of messages of each topic.
    """

    def __init__(self, service: Service, writer: RecordingWriter, counts: Counter[str]) -> None:
        self._writer, self._counts = writer, counts
        spec = service.spec
        self._journal = Journal(spec.name, BOOT_ID, spec.made_with, class_of(service))
        self._node = Node(service, self, strict=False, boot_id=BOOT_ID, journal=self._journal)
        self._reads = {topic.name for topic in spec.inputs} | {endpoint.name for endpoint in spec.serves}
        self._logged_ns = 0
        self._requests = 0
        self._epoch_id: int | None = None

    def step(self, logged_ns: int, t_ns: int, messages: list[_Message], *, has_clock: bool) -> None:
        """Give the estimator messages that arrived together, and step it if it reads one of them.

        Args:
            logged_ns: time of the step in the recording.
            t_ns: vehicle time of the step.
            has_clock: whether the clock is among the bag's messages; else each new epoch of the odometry begins one.
        """
        self._logged_ns = logged_ns
        for each in messages:
            if isinstance(each.message, Odometry) and not has_clock and each.message.epoch_id != self._epoch_id:
                self._epoch_id = each.message.epoch_id
                self._deliver(topics.CLOCK, Clock(t_ns=t_ns, epoch_id=self._epoch_id, wall_ns=t_ns))
            self._deliver(each.source, each.message)
        if not any(each.source.name in self._reads for each in messages):
            return
        self._node.inbox.wall_ns, self._node.inbox.connected = t_ns, True
        self._node.step(t_ns)
        self._write_journal(t_ns)

    def _deliver(self, source: Topic[Any] | Endpoint[Any, Any], message: Any) -> None:
        data = encode(message)
        if isinstance(source, Topic):
            self._record(source.name, data)
            self._node.deliver(source.name, data)
        else:
            self._requests += 1
            self._node.deliver_request(source.name, self._requests, CLIENT, data, {})

    def end(self, t_ns: int) -> None:
        """Record the rest of the journal."""
        self._write_journal(t_ns, force=True)

    def _write_journal(self, t_ns: int, *, force: bool = False) -> None:
        part = self._journal.take(t_ns, force=force)
        if part is not None:
            self._writer.write(self._logged_ns, topics.journal_of(ESTIMATOR).name, part)

    def _record(self, name: str, data: bytes) -> None:
        self._writer.write(self._logged_ns, name, data)
        self._counts[name] += 1

    def publish(self, topic: Topic[Any], data: bytes) -> None:
        self._record(topic.name, data)


def _run(messages: Iterator[_Message], player: _Player) -> None:
    """Step the estimator with each group of messages that have one time in the bag.

    The time of a step is that of the bag, where this is vehicle time, as in bags of `jezero recording export`: there it
    is the time of the step that read these messages in flight. In others it is the newest time in a message so far.
    Requests have none, so those before the first message wait for it.
    """
    newest_ns = 0
    in_vehicle_time: bool | None = None
    has_clock = False
    waiting: list[_Message] = []
    for logged_ns, group in groupby(messages, lambda each: each.logged_ns):
        together = [*waiting, *group]
        times_ns = [each.message.t_ns for each in together if isinstance(each.source, Topic)]
        if in_vehicle_time is None and not times_ns:
            waiting = together
            continue
        waiting = []
        if in_vehicle_time is None:
            in_vehicle_time = abs(logged_ns - times_ns[0]) < SAME_CLOCK_MAX_NS
        has_clock = has_clock or any(each.source is topics.CLOCK for each in together)
        newest_ns = max((newest_ns, *((logged_ns,) if in_vehicle_time else times_ns)))
        player.step(logged_ns, newest_ns, together, has_clock=has_clock)
    player.end(newest_ns)
