"""Telemetry of the client: latest values, subscriptions, pictures, the rover, and an end in the middle of each."""

import inspect
import io
import struct
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest
from PIL import Image

from jezero import JezeroError, TimedOut, Unreachable, Vehicle
from jezero.client import camera
from jezero.client.dataset import Dataset
from jezero.client.goal import Goal
from jezero.client.images import ImagesGoal
from jezero.client.rover import Rover
from jezero.client.subscription import QUEUE_MAX, Subscription
from jezero.schemas import topics
from jezero.schemas.sensors import Altimeter, CameraFrame, CameraPreview
from jezero.schemas.state import Battery, Clock, Odometry
from tests.client.rig import (
    ACCEPTED,
    ODOMETRY,
    Server,
    a_status,
    endpoint,
    published,
    server,
    vehicle,
    wait_for,
    wait_until_subscribed,
)

__all__ = ["endpoint", "server", "vehicle"]

FRAME = CameraFrame(
    t_ns=7, sequence=1, width_px=2, height_px=1, pitch_camera_rad=-1.5, exposure_s=0.004, pixels=bytes(6)
)


def odometry(t_ns: int) -> Odometry:
    return msgspec.structs.replace(ODOMETRY, t_ns=t_ns)


def clock(t_ns: int) -> Clock:
    return Clock(t_ns=100_000_000 * t_ns, epoch_id=1, wall_ns=t_ns)


def publish_frame(server: Server) -> None:
    key = topics.key("v", topics.CAMERA.name)
    wait_until_subscribed(server.session, key)
    header = msgspec.json.encode({k: v for k, v in msgspec.to_builtins(FRAME).items() if k != "pixels"})
    server.session.put(key, FRAME.pixels, attachment=header)


def test_the_latest_value_waits_for_the_first_message_and_is_there_from_then_on(
    vehicle: Vehicle, server: Server
) -> None:
    with published(server, odometry, topics.ODOMETRY):
        first = vehicle.odometry(timeout_s=3.0)
        assert first.pos_uav_ned_m == ODOMETRY.pos_uav_ned_m
        wait_for(lambda: vehicle.odometry(timeout_s=0.0).t_ns > first.t_ns + 3)


def test_a_silent_topic_is_named(vehicle: Vehicle) -> None:
    with pytest.raises(TimedOut, match=r"no message on estimate/relative of v for 0.1 s: is its service up\?"):
        vehicle.relative(timeout_s=0.1)


def test_a_value_of_a_service_that_has_stopped_is_not_the_latest_any_more(
    vehicle: Vehicle, server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("jezero.client.subscription.FRESH_S", 0.1)
    with published(server, odometry, topics.ODOMETRY):
        vehicle.odometry(timeout_s=3.0)
    with pytest.raises(TimedOut, match="no message on odometry"):
        wait_for(lambda: vehicle.odometry(timeout_s=0.05) is None)


def test_the_battery_is_that_of_the_status(vehicle: Vehicle, server: Server) -> None:
    battery = Battery(voltage_v=15.5, remaining=0.8)
    with published(server, lambda t_ns: msgspec.structs.replace(a_status(t_ns=t_ns), battery=battery)):
        assert vehicle.battery(timeout_s=3.0) == battery


def test_any_topic_is_read_by_its_name_or_its_row(vehicle: Vehicle, server: Server) -> None:
    with published(server, lambda t_ns: Altimeter(t_ns=t_ns, range_m=2.0), topics.ALTIMETER):
        assert vehicle.latest("sensor/altimeter", 3.0).t_ns > 100
        assert vehicle.latest(topics.ALTIMETER, 3.0).range_m == 2.0
    with pytest.raises(ValueError, match=r"there is no topic 'nonsense'; known are clock, sensor/imu"):
        vehicle.latest("nonsense")
    with pytest.raises(ValueError, match="there is no topic"):
        vehicle.subscribe("altitude")


def test_a_subscription_has_every_message_in_order(vehicle: Vehicle, server: Server) -> None:
    with vehicle.subscribe(topics.ODOMETRY) as stream, published(server, odometry, topics.ODOMETRY):
        times_ns = [message.t_ns for message, _ in zip(stream, range(5), strict=False)]
    assert times_ns == list(range(times_ns[0], times_ns[0] + 5))
    assert list(stream) == []


def test_a_callback_is_called_with_each_message_until_the_subscription_is_closed(
    vehicle: Vehicle, server: Server
) -> None:
    seen: list[int] = []
    subscription = vehicle.subscribe("odometry", lambda message: seen.append(message.t_ns))
    with published(server, odometry, topics.ODOMETRY):
        wait_for(lambda: len(seen) > 4)
        subscription.close()
        wait_for(lambda: not any(t.name == "jezero odometry" for t in threading.enumerate()))
    assert seen == list(range(seen[0], seen[0] + len(seen)))


def test_a_callback_that_raises_ends_its_subscription_and_shows_why(
    vehicle: Vehicle, server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    raised: list[object] = []
    monkeypatch.setattr(threading, "excepthook", lambda args: raised.append(args.exc_value))
    calls: list[int] = []

    def fail(message: Odometry) -> None:
        calls.append(message.t_ns)
        raise KeyError("my own bug")

    vehicle.subscribe(topics.ODOMETRY, fail)
    with published(server, odometry, topics.ODOMETRY):
        wait_for(lambda: raised)
    assert len(calls) == 1


def test_a_slow_reader_loses_the_oldest_messages(vehicle: Vehicle, server: Server) -> None:
    with vehicle.subscribe(topics.ODOMETRY) as stream:
        wait_until_subscribed(server.session, topics.key("v", topics.ODOMETRY.name))
        for t_ns in range(QUEUE_MAX + 10):
            server.publish(topics.ODOMETRY, odometry(t_ns))
        server.publish(topics.ODOMETRY, odometry(9_999))
        read = [stream.next(3.0).t_ns]
        while read[-1] != 9_999:
            read.append(stream.next(3.0).t_ns)
    assert read[-2] == QUEUE_MAX + 9


def test_of_pictures_a_slow_reader_keeps_four(vehicle: Vehicle, server: Server) -> None:
    with vehicle.subscribe(topics.CAMERA) as stream:
        for _ in range(20):
            publish_frame(server)
        wait_for(lambda: stream._arrivals._items.qsize() == 4)
        assert stream.next(1.0).pixels == FRAME.pixels


def test_snap_writes_a_png_of_the_next_picture(vehicle: Vehicle, server: Server, tmp_path: Path) -> None:
    publisher = threading.Thread(target=publish_frame, args=[server])
    publisher.start()
    frame = vehicle.camera.snap(tmp_path / "x.png", timeout_s=5.0)
    publisher.join()
    data = (tmp_path / "x.png").read_bytes()
    assert data.startswith(b"\x89PNG")
    assert struct.unpack(">II", data[16:24]) == (frame.width_px, frame.height_px) == (2, 1)


def publish_preview(server: Server, jpeg: bytes) -> None:
    key = topics.key("v", topics.CAMERA_PREVIEW.name)
    wait_until_subscribed(server.session, key)
    header = {"t_ns": 8, "width_px": 3, "height_px": 2, "scale": 0.5, "pitch_camera_rad": -1.5}
    server.session.put(key, jpeg, attachment=msgspec.json.encode(header))


def test_where_only_previews_arrive_snap_writes_one_as_a_png(
    vehicle: Vehicle, server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(camera, "FRAME_TIMEOUT_S", 0.1)
    jpeg = io.BytesIO()
    Image.new("RGB", (3, 2), (200, 30, 30)).save(jpeg, "jpeg", quality=95)
    publisher = threading.Thread(target=publish_preview, args=[server, jpeg.getvalue()])
    publisher.start()
    preview = vehicle.camera.snap(tmp_path / "x.png", timeout_s=5.0)
    publisher.join()
    assert isinstance(preview, CameraPreview) and (preview.t_ns, preview.jpeg) == (8, jpeg.getvalue())
    with Image.open(tmp_path / "x.png") as image:
        red, green, blue = image.convert("RGB").tobytes()[:3]
        assert (image.format, image.size) == ("PNG", (3, 2))
        assert red > 180 and green < 60 and blue < 60


def test_without_pillow_a_snap_of_a_preview_says_what_to_install(
    vehicle: Vehicle, server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(camera, "FRAME_TIMEOUT_S", 0.1)
    monkeypatch.setitem(sys.modules, "PIL", None)
    publisher = threading.Thread(target=publish_preview, args=[server, b"\xff\xd8\xff"])
    publisher.start()
    with pytest.raises(JezeroError, match=r"pip install 'jezero\[cli\]'"):
        vehicle.camera.snap(tmp_path / "x.png", timeout_s=5.0)
    publisher.join()
    assert not (tmp_path / "x.png").exists()


def test_the_preview_is_read_on_its_own_too(vehicle: Vehicle, server: Server) -> None:
    publisher = threading.Thread(target=publish_preview, args=[server, b"\xff\xd8\xff"])
    publisher.start()
    assert vehicle.camera.preview(timeout_s=5.0).scale == 0.5
    publisher.join()


def test_without_images_a_program_on_another_computer_is_told_of_previews(vehicle: Vehicle) -> None:
    with pytest.raises(Unreachable, match=r"no image of v within 0.1 s.*there are previews only"):
        vehicle.camera.frame(timeout_s=0.1)
    with pytest.raises(Unreachable, match=r"no preview of v within 0.1 s: does its camera run"):
        vehicle.camera.preview(timeout_s=0.1)


def test_without_a_camera_a_snap_says_so_and_writes_nothing(vehicle: Vehicle, tmp_path: Path) -> None:
    with pytest.raises(Unreachable, match=r"no image and no preview of v within 0.1 s: does its camera run in the"):
        vehicle.camera.snap(tmp_path / "x.png", timeout_s=0.1)
    assert not (tmp_path / "x.png").exists()


def test_driving_goes_on_beside_the_program_and_stops_with_the_block(vehicle: Vehicle, server: Server) -> None:
    speeds: list[float] = []
    with (
        vehicle.subscribe(topics.ROVER_COMMAND) as commands,
        published(server, clock, topics.CLOCK),
        vehicle.rover.driving(0.5, 0.1),
    ):
        for _ in range(5):
            command = commands.next(3.0)
            assert (command.speed_rover_body_mps, command.yaw_rate_rover_rps) == (0.5, 0.1)
    with vehicle.subscribe(topics.ROVER_COMMAND) as commands, published(server, clock, topics.CLOCK):
        with vehicle.rover.driving(0.5):
            commands.next(3.0)
        while not speeds or speeds[-1]:
            speeds.append(commands.next(3.0).speed_rover_body_mps)
    with pytest.raises(ValueError, match="not within ±2"), vehicle.rover.driving(3.0):
        pass


@pytest.mark.parametrize(
    "wait",
    [
        lambda uav: uav.rover.drive(0.5),
        lambda uav: uav.takeoff().result(),
        lambda uav: list(uav.subscribe(topics.UWB)),
        lambda uav: uav.latest(topics.UWB, 30.0),
        lambda uav: uav.camera.frame(30.0),
        lambda uav: list(uav.watch_status()),
        lambda uav: uav.wait_ready(),
    ],
    ids=["drive", "result", "subscribe", "latest", "frame", "watch_status", "wait_ready"],
)
def test_closing_the_connection_ends_every_wait_with_that_reason(
    vehicle: Vehicle, server: Server, wait: Callable[[Vehicle], object]
) -> None:
    server.serve("status", a_status(ready=False))
    server.serve("@action/takeoff", ACCEPTED, end=False)
    closer = threading.Timer(0.5, vehicle.close)
    with published(server, clock, topics.CLOCK):
        closer.start()
        start = time.monotonic()
        with pytest.raises(Unreachable, match=r"the connection to v was closed"):
            wait(vehicle)
        assert time.monotonic() - start < 2.0
        closer.join()
    with pytest.raises(Unreachable, match=r"the connection to v was closed"):
        wait(vehicle)


def test_a_vehicle_and_its_router_come_from_the_environment_as_for_the_command_line(
    endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("JEZERO_VEHICLE", "other")
    monkeypatch.setenv("JEZERO_ROUTER", endpoint)
    with Vehicle.connect() as vehicle:
        assert (vehicle._connection.vehicle, vehicle._connection.router) == ("other", endpoint)
    with Vehicle.connect("v") as vehicle:
        assert vehicle._connection.vehicle == "v"
    with pytest.raises(Unreachable, match=r"tcp/127\.0\.0\.1:9"):
        Vehicle.connect(router="tcp/127.0.0.1:9", timeout_s=0.2)


@pytest.mark.parametrize("cls", [Vehicle, Goal, ImagesGoal, Rover, Subscription, Dataset])
def test_signatures_have_plain_types(cls: type) -> None:
    for name, method in inspect.getmembers(cls, callable):
        if not name.startswith("_"):
            assert "Annotated" not in str(inspect.signature(method)), name
