"""A recording as a rosbag2, with the messages that the bridge publishes; without ROS, by the library rosbags.

Each message has its own time, which is vehicle time, and `/clock` is among them: programs that read a bag while it is
played run with `use_sim_time`. The whole messages of jezero below `jezero/` have the time at which the estimator
received them, where its journal is recorded: from these it makes the same estimates again, see `jezero.replay.rosbag`.
"""

from array import array
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np
from msgspec.structs import replace
from rosbags.interfaces import (
    Connection,
    Nodetype,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from jezero.base.codec import decode, decode_request
from jezero.base.vehicle_config import VehicleConfig
from jezero.recording.journals import ServiceRun, files_with_start, runs_of
from jezero.recording.mcap_file import RecordingError
from jezero.recording.reader import Recording
from jezero.schemas import journal, topics
from jezero.schemas.state import Clock
from jezero.services.ros2_bridge import conversions
from jezero.services.ros2_bridge.conversions import Context
from jezero.services.ros2_bridge.exact import definition, to_exact, type_name
from jezero.services.ros2_bridge.geometry import RosMessage
from jezero.services.ros2_bridge.rows import (
    DEPTH,
    EVERY_HEALTH,
    EXACT,
    EXACT_ROWS,
    REQUESTS,
    ROWS,
    Quality,
    exact_name,
    exact_structs,
)

Version = Literal[8, 9]
"""Version of the bag's metadata: 8 is that of Humble, 9 of Jazzy and later."""
STORES = {8: Stores.ROS2_HUMBLE, 9: Stores.ROS2_JAZZY}
NO_LIMIT = QosTime(2147483647, 4294967295)
ESTIMATOR = "estimator"
MADE_WITH = "jezero_estimator"
"""Custom data of a bag: the arguments of the estimator that flew, as JSON."""


def typestore_of(version: Version) -> Typestore:
    """Types of messages of ROS, and jezero's own."""
    store = get_typestore(STORES[version])
    for struct in exact_structs().values():
        store.register(get_types_from_msg(definition(struct), type_name(struct)))
    return store


class MessageBuilder:
    """Makes messages of rosbags, in which every field has a value.

    Args:
        version: of the bag.
    """

    def __init__(self, version: Version) -> None:
        self.typestore = typestore_of(version)

    def serialized(self, message: RosMessage) -> memoryview:
        """The message in CDR."""
        return self.typestore.serialize_cdr(self.build(message), message.type)

    def build(self, message: RosMessage) -> Any:
        """The message with its parts; fields that are left out are zero."""
        fields = {
            name: self._value(kind, message.fields[name]) if name in message.fields else self._default(kind)
            for name, kind in self.typestore.fielddefs[message.type][1]
        }
        unknown = set(message.fields) - set(fields)
        if unknown:
            raise ValueError(f"{message.type} has no field {sorted(unknown)[0]}")
        return self.typestore.types[message.type](**fields)

    def _value(self, kind: Any, value: Any) -> Any:
        if isinstance(value, RosMessage):
            return self.build(value)
        if isinstance(value, bytes):  # a byte of ROS
            return value[0]
        if isinstance(value, list | array):
            (of, detail), _ = kind[1]
            if of is Nodetype.NAME:
                return [self.build(each) for each in value]
            return list(value) if detail[0] == "string" else np.array(value, dtype=_dtype(detail[0]))
        return value

    def _default(self, kind: Any) -> Any:
        node, detail = kind
        if node is Nodetype.NAME:
            return self.build(RosMessage(detail, {}))
        if node is Nodetype.BASE:
            return {"string": "", "bool": False}.get(detail[0], 0)
        (of, inner), length = detail
        if of is Nodetype.BASE and inner[0] != "string":
            return np.zeros(length if node is Nodetype.ARRAY else 0, dtype=_dtype(inner[0]))
        return []


def _dtype(name: str) -> str:
    return {"byte": "uint8", "octet": "uint8", "char": "uint8"}.get(name, name)


def qos_of(quality: Quality) -> Qos:
    """Quality of service of a topic, for who plays the bag."""
    return Qos(
        QosHistory.KEEP_LAST,
        DEPTH[quality],
        QosReliability.BEST_EFFORT if quality == "sensor" else QosReliability.RELIABLE,
        QosDurability.TRANSIENT_LOCAL if quality == "latched" else QosDurability.VOLATILE,
        NO_LIMIT,
        NO_LIMIT,
        QosLiveliness.AUTOMATIC,
        NO_LIMIT,
        False,
    )


class BagWriter:
    """Writes ROS messages into an open bag, and counts them.

    Args:
        writer: the bag.
        builder: makes the messages.
        namespace: of names that don't begin with "/".

    Attributes:
        counts: number of messages of each topic.
    """

    def __init__(self, writer: Writer, builder: MessageBuilder, namespace: str) -> None:
        self._writer, self._builder, self._namespace = writer, builder, namespace
        self._connections: dict[str, Connection] = {}
        self.counts: Counter[str] = Counter()

    def write(self, name: str, quality: Quality, t_ns: int, message: RosMessage) -> None:
        """Write one message of a topic."""
        topic = name if name.startswith("/") else f"/{self._namespace}/{name}"
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                topic, message.type, typestore=self._builder.typestore, offered_qos_profiles=(qos_of(quality),)
            )
        self._writer.write(self._connections[topic], t_ns, self._builder.serialized(message))
        self.counts[topic] += 1


def write_bag(
    recording: Recording,
    folder: Path,
    config: VehicleConfig,
    *,
    vehicle: str,
    version: Version = 9,
    mcap: bool = False,
    images: bool = True,
) -> dict[str, int]:
    """Write a recording as a rosbag2.

    Args:
        recording: the recording.
        folder: the new bag.
        config: the vehicle's dimensions.
        vehicle: name of the vehicle as a namespace.
        version: of the bag.
        mcap: whether the bag's messages are in an MCAP file, else in SQLite.
        images: whether the camera's images are written too.

    Returns:
        Number of messages by topic.

    Raises:
        RecordingError: the recording can't be read.
        FileExistsError: there is such a folder already.
    """
    if folder.exists():
        raise FileExistsError(17, "it exists already: name a new folder", str(folder))
    context, builder = Context(vehicle, config), MessageBuilder(version)
    plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
    runs = _estimator_runs(recording)
    rows = tuple(row for row in ROWS if not (runs and row.name.startswith(EXACT)))
    with Writer(folder, version=version, storage_plugin=plugin) as writer:
        bag = BagWriter(writer, builder, vehicle)
        if runs:
            writer.set_custom_data(MADE_WITH, msgspec.json.encode(runs[0].made_with).decode())
        begin_ns: int | None = None
        for source, message in _messages(recording, images=images):
            if begin_ns is None:
                begin_ns = message.t_ns
                bag.write("/tf_static", "latched", begin_ns, conversions.static_transforms(context, 0))
            if isinstance(message, Clock):
                bag.write("/clock", "sensor", message.t_ns, conversions.clock(message.t_ns))
            elif source == topics.TRUTH.name:
                bag.write(exact_name(topics.TRUTH), "state", message.t_ns, to_exact(message))
            context.notice(message)
            for row in rows:
                if row.source.name == source and (made := row.convert(message, context)) is not None:
                    bag.write(row.name, row.quality, message.t_ns, made)
        for run in runs:
            for t_ns, name, message in _inputs(run):
                bag.write(name, "state", t_ns, to_exact(message))
    return dict(sorted(bag.counts.items()))


def _messages(recording: Recording, *, images: bool) -> Iterator[tuple[str, Any]]:
    """Messages with the name of their source, in the order of the recording; the images come last."""
    wanted = {row.source.name for row in ROWS} | {t.name for t in (topics.CLOCK, topics.CAMERA_INFO, topics.TRUTH)}
    for entry in recording.messages():
        source = EVERY_HEALTH.name if entry.topic.startswith("health/") else entry.topic
        if source in wanted and source != topics.CAMERA.name:
            yield source, entry.message
    if images:
        for frame, pixels in recording.images():
            yield topics.CAMERA.name, replace(frame, pixels=pixels.tobytes())


def _estimator_runs(recording: Recording) -> list[ServiceRun]:
    """The recorded runs of the estimator; none where its journal or the start of it is not recorded."""
    try:
        return runs_of(files_with_start(recording.path, ESTIMATOR), ESTIMATOR)
    except RecordingError:
        return []


def _inputs(run: ServiceRun) -> Iterator[tuple[int, str, msgspec.Struct]]:
    """What the estimator received, each with the vehicle time of the step that read it and its name in ROS."""
    structs = {row.source.name: (row.name, row.source.struct) for row in EXACT_ROWS}
    requests = {request.name: request for request in REQUESTS}
    waiting: list[tuple[str, msgspec.Struct]] = []
    for entry in run.entries:
        match entry:
            case journal.Received(topic, message) if topic in structs:
                name, struct = structs[topic]
                waiting.append((name, decode(struct, bytes(message))))
            case journal.Requested(endpoint, _, _, message, parameters) if endpoint in requests:
                request = requests[endpoint]
                data = b"" if bytes(message) == b"null" else bytes(message)
                waiting.append((exact_name(request), decode_request(request.request_type, data, parameters)))
            case journal.Step(t_ns):
                yield from ((t_ns, name, each) for name, each in waiting)
                waiting.clear()
