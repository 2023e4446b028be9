"""The camera's pitch axis, its delay, and what it publishes."""

from collections.abc import Iterable
from itertools import pairwise
from math import dist, pi

import pytest

from jezero.base.config import load_config
from jezero.base.vehicle_config import CameraMountConfig, VehicleConfig
from jezero.runtime.memory_bus import NO_DELAY, MemoryBus
from jezero.runtime.service import Inbox, Output, Publish, Spec
from jezero.schemas import topics
from jezero.schemas.commands import CameraPitch
from jezero.schemas.landing_board import BIG_ID
from jezero.schemas.sensors import CameraFrame, CameraPreview, TagCorners
from jezero.schemas.state import Scene
from jezero.services.simulator.camera.config import CameraConfig
from jezero.services.simulator.camera.gimbal import Gimbal
from jezero.services.simulator.camera.making import make_camera
from jezero.services.simulator.camera.service import CameraSimulator
from jezero.services.simulator.camera.view import CameraView
from jezero.services.simulator.config import SimulatorConfig

MS = 1_000_000
CONFIG = CameraConfig(mode="projected")
VEHICLE = VehicleConfig()
PITCH_REST_RAD = VEHICLE.camera.pitch_rest_rad


def command(t_ns: int, pitch_rad: float) -> CameraPitch:
    return CameraPitch(t_ns=t_ns, pitch_camera_rad=pitch_rad)


def scene(t_ns: int, epoch_id: int = 1) -> Scene:
    zero = (0.0, 0.0, 0.0)
    return Scene(
        t_ns=t_ns,
        epoch_id=epoch_id,
        pos_uav_ned_m=(0.0, 0.0, -4.5),
        vel_uav_ned_mps=zero,
        q_ned_from_frd=(1.0, 0.0, 0.0, 0.0),
        rates_uav_frd_rps=zero,
        pos_rover_ned_m=(0.0, 0.0, -0.5),
        vel_rover_ned_mps=zero,
        yaw_rover_rad=0.0,
    )


def test_the_shipped_settings_are_the_defaults() -> None:
    assert load_config(CameraConfig, "camera") == CameraConfig()


def test_the_axis_follows_a_command_at_a_bounded_rate() -> None:
    gimbal = Gimbal((PITCH_REST_RAD, 0.0), CONFIG.axis_rate_max_rps)
    gimbal.move(0)
    gimbal.update(0, [command(0, -0.5 * pi + 0.2)])
    gimbal.move(100 * MS)
    assert gimbal.pitch_rad == pytest.approx(PITCH_REST_RAD + 0.15)
    assert gimbal.pitch_rate_rps == pytest.approx(CONFIG.axis_rate_max_rps)
    gimbal.move(200 * MS)
    assert gimbal.pitch_rad == pytest.approx(-0.5 * pi + 0.2)


def test_the_axis_returns_to_rest_when_nobody_commands_any_more() -> None:
    gimbal = Gimbal((PITCH_REST_RAD, 0.0), CONFIG.axis_rate_max_rps)
    gimbal.update(0, [command(0, -1.0)])
    for t_ms in range(0, 1001, 100):
        gimbal.move(t_ms * MS)
    assert gimbal.pitch_rad == pytest.approx(-1.0)
    for t_ms in range(1100, 2001, 100):
        gimbal.move(t_ms * MS)
    assert gimbal.pitch_rad == pytest.approx(PITCH_REST_RAD)


def test_an_old_command_changes_nothing() -> None:
    gimbal = Gimbal((PITCH_REST_RAD, 0.0), CONFIG.axis_rate_max_rps)
    gimbal.move(0)
    gimbal.update(500 * MS, [command(100 * MS, -1.0)])
    gimbal.move(600 * MS)
    assert gimbal.pitch_rad == PITCH_REST_RAD


class Scenes:
    """In place of the simulator: scenes at 15 Hz until it is told to stop."""

    spec = Spec(name="scenes", outputs=(topics.SCENE,), rate_hz=15.0)
    epoch_id = 1

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        yield Publish(topics.SCENE, scene(t_ns, self.epoch_id))


class Grey:
    """In place of a renderer."""

    description = "grey"
    rate_max_hz = 60.0

    def picture(self, scene: Scene, views: tuple[CameraView, CameraView, CameraView]) -> bytes:
        return bytes(3 * 640 * 480)


def published(camera: CameraSimulator, seconds: float) -> dict[str, list[tuple[int, bytes]]]:
    bus = MemoryBus(delay=NO_DELAY)
    seen: dict[str, list[tuple[int, bytes]]] = {}
    bus.observe(lambda t_ns, topic, data: seen.setdefault(topic, []).append((t_ns, data)))
    bus.add(Scenes())
    bus.add(camera)
    bus.run_for(seconds)
    return seen


def decoded(kind: type, entries: list[tuple[int, bytes]]) -> list[tuple[int, object]]:
    from jezero.base.codec import decode

    return [(t_ns, decode(kind, data)) for t_ns, data in entries]


def test_projected_tags_arrive_100_ms_after_the_exposure_at_15_per_second() -> None:
    seen = published(CameraSimulator(CONFIG, VEHICLE, None, seed=1), 2.0)
    assert topics.CAMERA.name not in seen
    messages = decoded(TagCorners, seen[topics.TAG_CORNERS.name])
    assert len(messages) in {28, 29}
    for t_ns, message in messages:
        assert isinstance(message, TagCorners)
        assert 100 * MS <= t_ns - message.t_ns <= 112 * MS
        assert [tag.tag_id for tag in message.tags] == [BIG_ID]


def test_rendered_pictures_keep_their_exposure_time_and_count_up() -> None:
    seen = published(CameraSimulator(CameraConfig(), VEHICLE, Grey(), seed=1), 1.0)
    assert topics.TAG_CORNERS.name not in seen
    frames = [message for _, message in decoded(CameraFrame, seen[topics.CAMERA.name])]
    assert len(frames) >= 12
    for first, second in pairwise(frames):
        assert isinstance(first, CameraFrame) and isinstance(second, CameraFrame)
        assert second.sequence == first.sequence + 1
        assert second.t_ns > first.t_ns


def test_a_frame_is_followed_by_its_preview_twice_a_second() -> None:
    seen = published(CameraSimulator(CameraConfig(), VEHICLE, Grey(), seed=1), 3.2)
    frames = dict(decoded(CameraFrame, seen[topics.CAMERA.name]))
    previews = decoded(CameraPreview, seen[topics.CAMERA_PREVIEW.name])
    assert len(previews) in {6, 7}
    for t_ns, preview in previews:
        frame = frames[t_ns]
        assert isinstance(frame, CameraFrame) and isinstance(preview, CameraPreview)
        assert (preview.t_ns, preview.pitch_camera_rad) == (frame.t_ns, frame.pitch_camera_rad)


def test_projected_tags_have_no_previews() -> None:
    assert topics.CAMERA_PREVIEW.name not in published(CameraSimulator(CONFIG, VEHICLE, None, seed=1), 1.0)


def test_a_slower_camera_takes_every_third_scene() -> None:
    seen = published(CameraSimulator(CONFIG, VehicleConfig(camera=CameraMountConfig(rate_hz=5.0)), None, seed=1), 3.0)
    assert len(seen[topics.TAG_CORNERS.name]) in {14, 15}


def test_it_describes_itself_once_a_second() -> None:
    seen = published(CameraSimulator(CONFIG, VEHICLE, None, seed=1), 3.5)
    assert len(seen[topics.CAMERA_INFO.name]) == 4


def test_a_new_epoch_drops_what_was_on_its_way() -> None:
    bus = MemoryBus(delay=NO_DELAY)
    seen: list[int] = []
    scenes = Scenes()
    bus.add(scenes)
    bus.add(CameraSimulator(CONFIG, VEHICLE, None, seed=1))
    bus.run_for(0.5)
    scenes.epoch_id = 2
    bus.observe(lambda t_ns, topic, data: seen.append(t_ns) if topic == topics.TAG_CORNERS.name else None)
    bus.run_for(0.12)
    assert len(seen) <= 1


def test_the_same_seed_finds_the_same_tags() -> None:
    first, again, other = (published(CameraSimulator(CONFIG, VEHICLE, None, seed), 1.0) for seed in (1, 1, 2))
    assert first == again
    assert first != other


def test_a_board_printed_at_half_its_size_looks_half_as_large() -> None:
    sides_px = []
    for print_scale in (1.0, 0.5):
        config = CameraConfig(mode="projected", print_scale=print_scale)
        seen = published(make_camera(config, SimulatorConfig(), VEHICLE, 1), 0.5)
        _, corners = decoded(TagCorners, seen[topics.TAG_CORNERS.name])[0]
        assert isinstance(corners, TagCorners)
        big = next(tag for tag in corners.tags if tag.tag_id == BIG_ID)
        sides_px.append(dist(big.corners_px[0], big.corners_px[1]))
    assert sides_px[1] == pytest.approx(0.5 * sides_px[0], abs=1.0)
