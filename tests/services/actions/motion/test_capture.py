"""Pictures at planned points: the choice of the exposure, the measurements with it, and the store of its pixels."""

from collections.abc import Callable
from math import pi, radians
from pathlib import Path
from queue import SimpleQueue

import pytest

from jezero.base.codec import encode
from jezero.base.frames import geodetic_from_ned, quat_from_euler
from jezero.base.vehicle_config import AirframeConfig
from jezero.runtime.node import Mailbox
from jezero.runtime.process import Worker
from jezero.schemas import topics
from jezero.schemas.images import ImageReply
from jezero.schemas.sensors import Altimeter
from jezero.schemas.state import Odometry
from jezero.schemas.struct import Message
from jezero.services.actions.lifecycle.picture_store import PictureStore
from jezero.services.actions.motion.capture import Capture, Shot
from jezero.services.actions.motion.config import CaptureConfig
from tests.services.actions.fake_camera import frame, gnss, imu, info

MS = 1_000_000
ORIGIN_DEG = (45.0, 7.0, 300.0)


def odometry(t_ns: int, north_m: float, *, yaw_rad: float = 0.0, offset_m: float = 0.0) -> Odometry:
    return Odometry(
        t_ns=t_ns,
        epoch_id=1,
        pos_uav_ned_m=(north_m, 0.0, -4.0),
        vel_uav_ned_mps=(1.0, 0.0, 0.0),
        q_ned_from_frd=quat_from_euler(0.0, 0.0, yaw_rad),
        rates_uav_frd_rps=(0.0, 0.0, 0.0),
        origin_deg=ORIGIN_DEG,
        reset_offset_ned_m=(offset_m, 0.0, 0.0),
    )


class Feeder:
    """A capture, and messages that come to it."""

    def __init__(self, planned: int = 3, *, stream: bool = True) -> None:
        self.capture = Capture(CaptureConfig(), AirframeConfig(), planned, stream=stream)
        self.inbox = Mailbox(())
        self.shots: list[Shot] = []

    def give(self, t_ns: int, *messages: Message) -> None:
        names = {t.type: t.name for t in topics.TOPICS}
        for message in messages:
            self.inbox.add_message(names[type(message)], message)
        self.shots += self.capture.update(t_ns, self.inbox)
        self.inbox.clear()

    def fly(self, until_ms: int, since_ms: int = 0, offset_m: float = 0.0) -> None:
        """Fly north at 1 m/s: at time t the vehicle is at t metres; pictures come 100 ms late."""
        self.give(since_ms * MS, info(since_ms * MS))
        for ms in range(since_ms, until_ms, 20):
            messages: list[Message] = [odometry(ms * MS, ms / 1000.0 + offset_m, offset_m=offset_m), imu(ms * MS)]
            if ms % 100 == 0:
                messages.append(gnss(ms * MS))
            if ms % 40 == 0:
                messages.append(Altimeter(t_ns=ms * MS, range_m=4.0 + ms / 10000.0))
            exposed_ms = ms - 100
            if exposed_ms >= 0 and exposed_ms % 60 == 0:
                messages.append(frame((exposed_ms + 7) * MS, exposed_ms))
            self.give(ms * MS, *messages)


def test_the_first_picture_exposed_after_the_point_is_taken() -> None:
    feeder = Feeder()
    feeder.fly(500)
    feeder.capture.request(0, 490 * MS)
    waited = feeder.capture.is_waiting
    feeder.fly(900, since_ms=500)
    assert waited and not feeder.capture.is_waiting
    assert [shot.image.t_ns // MS for shot in feeder.shots] == [547]
    assert feeder.shots[0].frame.pixels


def test_an_image_has_the_pose_at_its_exposure() -> None:
    feeder = Feeder()
    feeder.fly(500)
    feeder.capture.request(0, 490 * MS)
    feeder.fly(900, since_ms=500)
    image = feeder.shots[0].image
    assert image.pos_uav_ned_m == pytest.approx((0.547, 0.0, -4.0), abs=1e-5)
    assert image.pos_camera_ned_m == pytest.approx((0.547, 0.0, -4.118), abs=1e-5)
    assert image.position_camera_deg == pytest.approx(geodetic_from_ned((0.547, 0.0, -4.118), ORIGIN_DEG), abs=1e-9)
    assert image.imu is not None
    assert image.imu.t_ns == 540 * MS
    assert image.gnss is not None
    assert image.gnss.t_ns == 500 * MS
    assert image.range_m == pytest.approx(4.056)
    assert image.pitch_camera_rad == pytest.approx(-0.5 * pi)
    assert (image.exposure_s, image.focal_px, image.width_px) == (0.004, 10.0, 16)


def test_attitude_is_interpolated_too() -> None:
    feeder = Feeder()
    feeder.give(0, info(0))
    feeder.capture.request(0, 0)
    feeder.give(0, odometry(0, 0.0, yaw_rad=radians(170.0)))
    feeder.give(20 * MS, odometry(20 * MS, 0.0, yaw_rad=radians(-170.0)), frame(15 * MS))
    assert feeder.shots[0].image.yaw_rad == pytest.approx(radians(-175.0), abs=1e-3)


def test_one_picture_serves_one_point_in_the_order_of_passing() -> None:
    feeder = Feeder()
    feeder.fly(500)
    feeder.capture.request(0, 490 * MS)
    feeder.capture.request(1, 492 * MS)
    feeder.fly(900, since_ms=500)
    assert [(shot.image.index, shot.image.t_ns // MS) for shot in feeder.shots] == [(0, 547), (1, 607)]


def test_a_corrected_position_moves_what_was_recorded_before() -> None:
    feeder = Feeder()
    feeder.fly(500)
    feeder.capture.request(0, 490 * MS)
    feeder.fly(900, since_ms=500)
    feeder.fly(1000, since_ms=900, offset_m=2.0)
    assert feeder.capture.images()[0].pos_uav_ned_m[0] == pytest.approx(2.547, abs=1e-5)
    moved = geodetic_from_ned((2.547, 0.0, -4.118), ORIGIN_DEG)
    assert feeder.capture.images()[0].position_camera_deg == pytest.approx(moved, abs=1e-9)


def test_a_picture_taken_across_a_correction_is_at_its_own_place() -> None:
    feeder = Feeder()
    feeder.give(0, info(0))
    feeder.capture.request(0, 0)
    feeder.give(0, odometry(0, 0.0))
    feeder.give(20 * MS, odometry(20 * MS, 5.02, offset_m=5.0), frame(10 * MS))
    assert feeder.shots[0].image.pos_uav_ned_m[0] == pytest.approx(0.01)
    assert feeder.capture.images()[0].pos_uav_ned_m[0] == pytest.approx(5.01)


@pytest.mark.parametrize("t_ms", [-3_600_000, -5000, 5000, 3_600_000])
def test_messages_with_impossible_times_change_nothing(t_ms: int) -> None:
    feeder = Feeder()
    feeder.fly(10_000 + 500, since_ms=10_000)
    feeder.capture.request(0, 10_490 * MS)
    strange_ns = max(0, (10_500 + t_ms) * MS)
    feeder.give(10_500 * MS, odometry(strange_ns, 77.0), frame(strange_ns), imu(strange_ns), gnss(strange_ns))
    feeder.fly(10_900, since_ms=10_500)
    assert [shot.image.t_ns // MS for shot in feeder.shots] == [10_507]
    assert feeder.shots[0].image.pos_uav_ned_m[0] == pytest.approx(10.507, abs=1e-5)


def test_where_no_odometry_came_no_picture_is_placed() -> None:
    feeder = Feeder()
    feeder.give(0, info(0))
    feeder.capture.request(0, 0)
    feeder.give(0, odometry(0, 0.0))
    feeder.give(400 * MS, frame(200 * MS), odometry(400 * MS, 0.4))
    assert not feeder.shots
    feeder.give(420 * MS, frame(410 * MS), odometry(420 * MS, 0.42))
    assert [shot.image.t_ns // MS for shot in feeder.shots] == [410]


def test_without_pictures_a_goal_is_refused_or_aborted_with_the_reason() -> None:
    feeder = Feeder()
    assert "no pictures: the camera sends none" in feeder.capture.refusal()
    feeder.give(0, info(0))
    assert 'mode = "rendered"' in feeder.capture.refusal()
    feeder.give(100 * MS, frame(1 * MS))
    assert feeder.capture.refusal() == ""
    feeder.capture.request(1, 200 * MS)
    assert feeder.capture.problem(2100 * MS) == ""
    assert feeder.capture.problem(2300 * MS) == "no pictures: none came for point 2 of 3 within 2.1 s"


def test_feedback_reports_each_picture_once_and_only_when_streaming() -> None:
    for stream in (True, False):
        feeder = Feeder(stream=stream)
        feeder.fly(500)
        feeder.capture.request(0, 490 * MS)
        feeder.fly(900, since_ms=500)
        assert [image.index for image in feeder.capture.unreported_images()] == ([0] if stream else [])
        assert feeder.capture.unreported_images() == ()
        assert len(feeder.capture.images()) == 1


def picture(goal_id: str, index: int) -> ImageReply:
    return ImageReply(goal_id=goal_id, index=index, width_px=2, height_px=1, pixels=bytes(range(6)))


def test_a_store_gives_back_what_it_was_given_and_says_what_it_has_not(tmp_path: Path) -> None:
    store = PictureStore(tmp_path / "pictures")
    store.keep(picture("a", 3))
    assert store.get("a", 3) == picture("a", 3)
    assert "no picture 4 of goal a" in store.get("a", 4).reason
    assert "no picture 0 of goal .." in store.get("..", 0).reason


def test_a_store_forgets_the_oldest_goal_first_and_never_the_present_one(tmp_path: Path) -> None:
    store = PictureStore(tmp_path / "pictures", size_max_bytes=200)
    for goal_id in ("a", "b", "c"):
        store.keep(picture(goal_id, 0))
    for index in range(5):
        store.keep(picture("c", index))
    assert store.get("a", 0).reason
    assert store.get("b", 0).reason
    assert all(not store.get("c", index).reason for index in range(5))


def test_a_store_begins_empty_and_a_temporary_one_leaves_nothing(tmp_path: Path) -> None:
    PictureStore(tmp_path / "pictures").keep(picture("a", 0))
    assert PictureStore(tmp_path / "pictures").get("a", 0).reason
    temporary = PictureStore()
    temporary.keep(picture("a", 0))
    folder = temporary._folder
    assert folder.exists()
    del temporary
    assert not folder.exists()


def test_a_disk_that_stands_still_delays_nobody_and_loses_nothing(tmp_path: Path) -> None:
    size, waiting = len(encode(picture("a", 0))), list[Callable[[], None]]()
    store = PictureStore(tmp_path / "pictures", execute=waiting.append, unwritten_max_bytes=3 * size)
    for index in range(3):
        store.keep(picture("a", index))
    assert [store.get("a", index) for index in range(3)] == [picture("a", index) for index in range(3)]
    with pytest.raises(OSError, match="doesn't keep up"):
        store.keep(picture("a", 3))
    carry_out(waiting)
    assert len(list(tmp_path.rglob("*.rgb"))) == 3 and not store._unwritten
    assert [store.get("a", index) for index in range(3)] == [picture("a", index) for index in range(3)]
    store.keep(picture("a", 3))


def test_an_error_of_the_disk_is_raised_with_the_next_picture_of_that_goal(tmp_path: Path) -> None:
    folder, waiting = tmp_path / "pictures", list[Callable[[], None]]()
    store = PictureStore(folder, execute=waiting.append)
    store.keep(picture("a", 0))
    folder.write_text("no folder")
    carry_out(waiting)
    assert store.get("a", 0) == picture("a", 0)
    with pytest.raises(NotADirectoryError):
        store.keep(picture("a", 1))
    folder.unlink()
    store.keep(picture("b", 0))


def test_a_late_failure_of_an_earlier_goal_is_not_the_present_ones(tmp_path: Path) -> None:
    folder, waiting = tmp_path / "pictures", list[Callable[[], None]]()
    store = PictureStore(folder, execute=waiting.append)
    store.keep(picture("a", 0))
    store.keep(picture("b", 0))
    folder.write_text("no folder")
    waiting.pop(0)()
    folder.unlink()
    store.keep(picture("b", 1))
    carry_out(waiting)
    assert store.get("b", 0) == picture("b", 0) and not store._unwritten


def test_a_thread_beside_writes_what_it_is_given(tmp_path: Path) -> None:
    written: SimpleQueue[bool] = SimpleQueue()
    worker = Worker()
    store = PictureStore(tmp_path / "pictures", execute=worker.add)
    store.keep(picture("a", 0))
    worker.add(lambda: written.put(True))
    assert written.get(timeout=10.0)
    assert len(list(tmp_path.rglob("*.rgb"))) == 1 and not store._unwritten


def carry_out(waiting: list[Callable[[], None]]) -> None:
    while waiting:
        waiting.pop(0)()


def test_a_picture_that_was_cut_short_on_disk_is_refused(tmp_path: Path) -> None:
    store = PictureStore(tmp_path)
    store.keep(picture("a", 0))
    file = next(tmp_path.rglob("*.rgb"))
    file.write_bytes(file.read_bytes()[:-1])
    assert "can't be read" in store.get("a", 0).reason
