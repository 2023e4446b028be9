"""The recorder on the in-memory bus, and what it does when the disk doesn't take anything."""

import random
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import pytest

from jezero.base.codec import decode, encode
from jezero.recording import open_recording
from jezero.recording.folder import RecordingFolder, RecordingProgress, newest_recording, room_bytes
from jezero.runtime.memory_bus import MemoryBus
from jezero.runtime.service import Inbox, Output, Publish, SentMessage, Spec
from jezero.schemas import topics
from jezero.schemas.health import ServiceHealth
from jezero.schemas.sensors import Altimeter
from jezero.services.recorder.service import IMAGES_WAITING_MAX_BYTES, WAITING_MAX_BYTES, Recorder

MB = 1_000_000
Batch = Sequence[tuple[int, str, bytes]]


class Sensor:
    """Publishes the altimeter."""

    spec = Spec(name="sensor", outputs=(topics.ALTIMETER,), rate_hz=20.0)

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        yield Publish(topics.ALTIMETER, Altimeter(t_ns=t_ns, range_m=2.0))


def recorded(
    write: Callable[[Batch], RecordingProgress], seconds: float = 5.0
) -> tuple[MemoryBus, list[ServiceHealth]]:
    """A bus with a sensor and a recorder, after some seconds, and all health reports of the recorder."""
    bus = MemoryBus(0)
    reports: list[ServiceHealth] = []

    def observe(t_ns: int, topic: str, data: bytes) -> None:
        if topic == "health/recorder":
            reports.append(decode(ServiceHealth, data))

    bus.observe(observe)
    bus.add(Recorder(write, images=True))
    bus.add(Sensor())
    bus.run_for(seconds)
    return bus, reports


def test_every_message_is_in_the_file_a_second_later(tmp_path: Path) -> None:
    folder = RecordingFolder(tmp_path / "recordings", {"vehicle": "v"}, 1000 * MB)
    _, reports = recorded(folder.write)
    path = newest_recording(tmp_path)
    assert path is not None
    entries = list(open_recording(path).messages(topics.ALTIMETER))  # though the file isn't finished
    assert 80 <= len(entries) <= 100
    assert [entry.logged_ns for entry in entries] == [entry.message.t_ns for entry in entries]
    assert reports[-1].state == "ok" and path.name in reports[-1].text
    folder.close()
    summary = open_recording(path).summary()
    assert summary.problem == ""
    assert summary.counts["health/recorder"] >= 4


def test_a_full_file_is_finished_and_the_next_one_begun(tmp_path: Path) -> None:
    folder = RecordingFolder(tmp_path / "recordings", {}, 20_000)
    for number in range(4):
        noise = random.Random(number).randbytes(20_000).hex()  # doesn't become smaller than its half
        folder.write([(number, "health/x", b'{"text":"%b"}' % noise.encode())])
    folder.close()
    count, size_bytes = room_bytes(tmp_path)
    assert count == 4 and size_bytes > 80_000
    assert all(open_recording(path).summary().problem == "" for path in (tmp_path / "recordings").iterdir())


def test_a_disk_that_refuses_is_named_in_health_within_a_second_and_recording_goes_on_later(tmp_path: Path) -> None:
    (tmp_path / "recordings").write_text("in the way")
    folder = RecordingFolder(tmp_path / "recordings", {}, MB)
    bus, reports = recorded(folder.write, seconds=1.2)
    assert reports[-1].state == "degraded"
    assert reports[-1].text.startswith("not recording: ") and "recordings" in reports[-1].text
    (tmp_path / "recordings").unlink()
    bus.run_for(4.0)
    assert newest_recording(tmp_path) is not None
    folder.close()


def test_a_file_that_vanishes_is_named_and_a_new_one_is_begun(tmp_path: Path) -> None:
    folder = RecordingFolder(tmp_path / "recordings", {}, MB)
    message = (1, "sensor/altimeter", encode(Altimeter(t_ns=1, range_m=1.0)))
    first = folder.write([message]).path
    assert first is not None
    first.unlink()
    assert "has vanished" in folder.write([message]).problem
    second = folder.write([message])
    assert second.problem == "" and second.path is not None and second.path.exists()
    folder.close()


def test_an_error_of_the_writer_is_told_in_health_and_recording_goes_on(capsys: pytest.CaptureFixture[str]) -> None:
    outcomes = iter([ZeroDivisionError("of the test")])

    def write(batch: Batch) -> RecordingProgress:
        for error in outcomes:
            raise error
        return RecordingProgress(Path("a.mcap"), MB, "")

    _, reports = recorded(write)
    assert any("ZeroDivisionError: of the test" in report.text for report in reports)
    assert reports[-1].text == "recording to a.mcap, 1.0 MB"
    assert "Traceback" in capsys.readouterr().err


def test_a_disk_that_takes_nothing_any_more_is_named_and_the_memory_stays_bounded() -> None:
    recorder = Recorder(lambda batch: RecordingProgress(None, 0, ""), images=True)
    big = b" " * (WAITING_MAX_BYTES // 10)
    recorder._take([SentMessage(i, "sensor/altimeter", big) for i in range(15)])
    assert len(recorder._waiting) == 10
    assert recorder._health(0).text.endswith("; 5 messages lost so far")
    recorder._write_start_ns = 0
    stuck = recorder._health(3_000_000_000)
    assert stuck.state == "degraded" and "has not taken anything for 3 s" in stuck.text


def test_images_that_wait_leave_room_for_all_other_messages() -> None:
    recorder = Recorder(lambda batch: RecordingProgress(None, 0, ""), images=True)
    image = b" " * MB
    recorder._take([SentMessage(i, topics.CAMERA.name, image) for i in range(60)])
    assert len(recorder._waiting) * MB == IMAGES_WAITING_MAX_BYTES
    recorder._take([SentMessage(60, topics.ALTIMETER.name, b" " * 100)])
    assert recorder._waiting[-1].topic == topics.ALTIMETER.name


def test_what_waits_while_a_batch_is_written_is_written_at_the_end() -> None:
    tasks: list[Callable[[], None]] = []
    written: list[int] = []

    def write(batch: Batch) -> RecordingProgress:
        written.extend(arrival_ns for arrival_ns, _, _ in batch)
        return RecordingProgress(None, 0, "")

    recorder = Recorder(write, images=True, execute=tasks.append)
    bus = MemoryBus(0)
    bus.add(recorder)
    bus.add(Sensor())
    bus.run_for(2.0)
    assert len(tasks) == 1, "the first batch is not written yet"
    recorder.finish()
    for task in tasks:
        task()
    assert written[-1] > 1.9e9
    assert written == sorted(written)
