"""Runs a service on its recorded inputs, and compares what it does with what it did."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import zip_longest
from pathlib import Path
from typing import Any

import msgspec

from jezero.recording.journals import ServiceRun, files_with_start, runs_of
from jezero.recording.mcap_file import RecordingError
from jezero.replay.rebuild import OwnClassError, make_service
from jezero.replay.recorded_images import RecordedImages
from jezero.runtime.journal import NULL, Journal
from jezero.runtime.node import Node, SilentTransport
from jezero.runtime.service import Service
from jezero.runtime.task import TaskOutcome, execute, pickled, read_outcome
from jezero.schemas import journal
from jezero.schemas.journal import AnyEntry, Output
from jezero.schemas.units import NS_PER_S


@dataclass(frozen=True)
class ReplayDifference:
    """The first output that is not the recorded one.

    Attributes:
        t_s: vehicle time of the step.
        recorded: the recorded output; "" for none.
        replayed: the output of the replay; "" for none.
    """

    t_s: float
    recorded: str
    replayed: str


@dataclass
class Replay:
    """Outcome of the replay of one service.

    Attributes:
        service: name of the service.
        files: the recordings that were read.
        runs: number of runs of the service, each from a start of its process.
        steps: number of steps.
        outputs: number of recorded outputs.
        different: number of steps with other outputs than recorded.
        first_difference: the first of them.
        gap_s: time from the start of the recording from which on the journal is not whole; the replay ends there.
        lossy_images: number of images that the service read, and that the recording has in lower quality.
        not_received: inputs of a class of one's own of which the journal has no message.
        published: topic and encoded message of all that the replay published, without attachments.
        published_before: the same as recorded.
    """

    service: str
    files: list[Path]
    runs: int = 0
    steps: int = 0
    outputs: int = 0
    different: int = 0
    first_difference: ReplayDifference | None = None
    gap_s: float | None = None
    lossy_images: int = 0
    not_received: tuple[str, ...] = ()
    published: list[tuple[str, bytes]] = field(default_factory=list)
    published_before: list[tuple[str, bytes]] = field(default_factory=list)

    @property
    def identical(self) -> bool:
        """Whether all outputs are bit by bit those that were recorded."""
        return self.different == 0


def replay_through(
    path: Path,
    service: str,
    changes: Mapping[str, str] | None = None,
    own: type[Service] | None = None,
    on_service: Callable[[Service], None] = lambda service: None,
) -> Replay:
    """Replay a service from a recording, in virtual time.

    Args:
        path: the recording.
        service: name of the service.
        changes: other settings than recorded, see `rebuild.changed`.
        own: class of the service, if it is not jezero's; see `rebuild.make_service`.
        on_service: called with the service of each run before its first step.

    Raises:
        RecordingError: the recording can't be read, or has no journal of the service from its start, or lacks images.
        SettingError: a setting is wrong.
        OwnClassError: `own` can't be made, or its step raised.
    """
    files = files_with_start(path, service)
    images = RecordedImages(files)
    replay = Replay(service, files)
    for run in runs_of(files, service):
        made = make_service(run, changes or {}, own)
        on_service(made)
        try:
            _replay_run(run, made, replay, images)
        except RecordingError:
            raise
        except Exception as error:
            if own is None:
                raise
            where = f"{own.__module__}:{own.__qualname__}"
            raise OwnClassError(f"{where} failed in a step: {type(error).__name__}: {error}") from error
        if own is not None:
            replay.not_received = _not_received(run, made)
    replay.lossy_images = images.lossy
    return replay


def _replay_run(run: ServiceRun, service: Service, replay: Replay, images: RecordedImages) -> None:
    """Step the service as often as it was stepped, and compare the outputs of each step."""
    player = _Player(run, service, images)
    replay.runs += 1
    replay.gap_s = run.gap_s if replay.gap_s is None else replay.gap_s
    for t_ns, recorded, replayed in player.steps():
        replay.steps += 1
        replay.outputs += len(recorded)
        replay.published += _published(replayed)
        replay.published_before += _published(recorded)
        if replayed != recorded:
            replay.different += 1
            if replay.first_difference is None:
                replay.first_difference = _difference(t_ns, recorded, replayed)


def _not_received(run: ServiceRun, service: Service) -> tuple[str, ...]:
    """Inputs of a service of which the journal has no message: a replay has only what the recorded service read."""
    received = {entry.topic for entry in run.entries if isinstance(entry, journal.Received)}
    return tuple(topic.name for topic in service.spec.inputs if topic.name not in received)


class _Player(SilentTransport):
    """A node that gets the recorded inputs; the transport of its node, which sends nothing."""

    def __init__(self, run: ServiceRun, service: Service, images: RecordedImages) -> None:
        self._run = run
        self._images = images
        self._journal = Journal(run.service, run.boot_id, {}, run.made_by)
        self._node = Node(service, self, strict=False, boot_id=run.boot_id, journal=self._journal)
        spec = service.spec
        reads = {topic.name for topic in (*spec.inputs, *spec.on_demand)}
        self._reads = reads | {endpoint.name for endpoint in spec.serves} | set(spec.links)
        """Names of what the service reads: a class of one's own may read less than the recorded one."""
        self._tasks: dict[str, bytes | TaskOutcome] = {}

    def steps(self) -> Iterator[tuple[int, list[Output], list[Output]]]:
        """Vehicle time of each step, its recorded outputs, and those of the replay."""
        t_ns: int | None = None
        recorded: list[Output] = []
        replayed: list[Output] = []
        refused = False
        for entry in self._run.entries:
            if isinstance(entry, journal.Step):
                if t_ns is not None:
                    yield t_ns, recorded, replayed
                t_ns, recorded, replayed = entry.t_ns, [], self._step(entry)
            elif isinstance(entry, Output):
                if not refused:
                    recorded.append(entry)
                refused = False  # the reply to a refused request is the runtime's, not the service's
            elif isinstance(entry, journal.Refused):
                refused = True
            else:
                self._deliver(entry)
        if t_ns is not None:
            yield t_ns, recorded, replayed

    def _step(self, step: journal.Step) -> list[Output]:
        inbox = self._node.inbox
        inbox.wall_ns, inbox.stalled_ns, inbox.connected = step.wall_ns, step.stalled_ns, step.connected
        self._journal.take_entries()
        self._node.step(step.t_ns)
        return [entry for entry in self._journal.take_entries() if isinstance(entry, Output)]

    def _deliver(self, entry: AnyEntry) -> None:
        node = self._node
        match entry:
            case (
                journal.Received(name) | journal.Requested(name) | journal.LinkBytes(name) | journal.LinkState(name)
            ) if name not in self._reads:
                return
            case journal.Received(topic, message, None):
                node.deliver(topic, bytes(message))
            case journal.Received(topic, message, int(checksum)):
                node.deliver(topic, self._images.message(bytes(message), checksum))
            case journal.Requested(endpoint, request_id, client_id, request, parameters):
                data = b"" if request == NULL else bytes(request)
                node.deliver_request(endpoint, request_id, client_id, data, parameters)
            case journal.Answered(call_id, reply, error):
                node.deliver_response(call_id, None if error is not None else bytes(reply), error)
            case journal.TaskEnded(task, error):
                node.deliver_outcome(task, self._outcome(task, error))
            case journal.LinkBytes(link, data):
                node.deliver_bytes(link, data)
            case journal.LinkState(link, up):
                node.set_link(link, up)
            case journal.Departed(name):
                node.deliver_departure(name)

    def _outcome(self, tag: str, error: str | None) -> TaskOutcome:
        task = self._tasks.pop(tag, None)
        if error is not None or task is None:
            return TaskOutcome(None, error or "the replay has not started this task")
        return task if isinstance(task, TaskOutcome) else read_outcome(execute(task))

    # -- Transport; the journal of the node keeps what is sent --

    def run_task(self, function: Callable[[], Any], tag: str) -> None:
        self._tasks[tag] = pickled(function)


def _published(outputs: list[Output]) -> list[tuple[str, bytes]]:
    return [(each.topic, bytes(each.message)) for each in outputs if isinstance(each, journal.Published)]


def _difference(t_ns: int, recorded: list[Output], replayed: list[Output]) -> ReplayDifference:
    """The first pair of outputs that are not equal; of two messages of one topic, the fields that differ."""
    for before, now in zip_longest(recorded, replayed):
        if before == now:
            continue
        if isinstance(before, journal.Published) and isinstance(now, journal.Published) and before.topic == now.topic:
            return ReplayDifference(t_ns / NS_PER_S, *_changed_fields(before, now))
        return ReplayDifference(
            t_ns / NS_PER_S, "" if before is None else _text(before), "" if now is None else _text(now)
        )
    raise ValueError("the outputs are equal")


def _changed_fields(before: journal.Published, now: journal.Published) -> tuple[str, str]:
    """The fields of two messages of one topic that differ, as text."""
    old, new = msgspec.json.decode(before.message), msgspec.json.decode(now.message)
    names = [name for name in {**old, **new} if old.get(name) != new.get(name)]
    recorded, replayed = ({name: message.get(name) for name in names} for message in (old, new))
    return f"{before.topic} {_text(recorded)}", f"{now.topic} {_text(replayed)}"


def _text(value: Any) -> str:
    return msgspec.json.encode(value).decode()
