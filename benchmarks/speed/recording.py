"""Cost of a recording: processor time of the recorder and of the live server, and size of what is written.

`python -m benchmarks.speed.recording [--seconds S] [--file FILE]` flies a stack of real processes or takes a
recording, and writes its messages again: without and with the scene for 3D viewers, and with images.
"""

import argparse
import os
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from benchmarks.speed.stack import HOVER_ALTITUDE_M, cpu_ns, running_module, running_stack
from jezero import Vehicle
from jezero.base.config import load_config
from jezero.base.vehicle_config import VehicleConfig
from jezero.deploy.launcher.ports import reserved_instance
from jezero.recording.folder import newest_recording
from jezero.recording.images import ImageFormat, compress, decompress
from jezero.recording.mcap_file import McapFile, RawMessage
from jezero.recording.viewer_scene import MESSAGES, ViewerScene
from jezero.recording.writer import RecordingWriter
from jezero.schemas.sensors import CameraFrame
from jezero.schemas.topics import CAMERA
from jezero.schemas.units import NS_PER_S

REPEATS = 3
IMAGES = 50


def fly(folder: Path, seconds: float) -> Path:
    """Hover for some seconds, and print the shares of a core of recorder and live server; returns the recording."""
    with (
        reserved_instance(vehicle=f"record{os.getpid()}") as instance,
        running_stack(instance, folder / "run") as stack,
    ):
        with Vehicle.connect(instance.vehicle, router=instance.router) as uav:
            uav.wait_ready()
            uav.takeoff(altitude_m=HOVER_ALTITUDE_M).result(timeout_s=60)
        print(f"recorder of a hovering stack: {100.0 * share(stack.processes()['recorder'], seconds):.1f} % of a core")
        with running_module(
            "jezero.cli.main", "watch", "--foxglove", "--port", "0", "--json", instance=instance
        ) as watch:
            assert watch.stdout is not None
            watch.stdout.readline()
            print(f"jezero watch --foxglove without a viewer: {100.0 * share(watch.pid, seconds):.1f} % of a core")
    path = newest_recording(folder / "run")
    if path is None:
        raise RuntimeError("the stack has left no recording")
    return path


def share(pid: int, seconds: float) -> float:
    """Fraction of a core that a process uses during some seconds from now."""
    before_ns, begin_s = cpu_ns(pid), time.monotonic()
    time.sleep(seconds)
    return (cpu_ns(pid) - before_ns) / NS_PER_S / (time.monotonic() - begin_s)


def write(messages: Sequence[RawMessage], path: Path, scene: Callable[[], ViewerScene | None]) -> tuple[float, int]:
    """Write messages to a new file; returns the shortest processor time of a message in us, and the file's size."""
    taken_us = []
    for _ in range(REPEATS):
        begin_ns = time.process_time_ns()
        with RecordingWriter(path, {}, scene=scene()) as writer:
            for topic, logged_ns, data in messages:
                writer.write(logged_ns, topic, data)
        taken_us.append((time.process_time_ns() - begin_ns) / 1e3 / len(messages))
    return min(taken_us), path.stat().st_size


def image_us(images: Sequence[RawMessage]) -> float:
    """Mean processor time of an image's JPEG."""
    frames = []
    for image in images[:IMAGES]:
        pixels = decompress(image.data)
        height_px, width_px, _ = pixels.shape
        frames.append(
            CameraFrame(
                t_ns=0,
                sequence=0,
                width_px=width_px,
                height_px=height_px,
                pitch_camera_rad=0.0,
                exposure_s=0.0,
                pixels=pixels.tobytes(),
            )
        )
    begin_ns = time.process_time_ns()
    for frame in frames:
        compress(frame, 0, ImageFormat())
    return (time.process_time_ns() - begin_ns) / 1e3 / len(frames)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=30.0, help="duration of the hover")
    parser.add_argument("--file", type=Path, help="a recording, instead of a flight")
    arguments = parser.parse_args()
    vehicle = load_config(VehicleConfig, "vehicle")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        path = arguments.file or fly(folder, arguments.seconds)
        messages = [message for message in McapFile(path).messages() if message.topic not in MESSAGES]
        images = [message for message in messages if message.topic == CAMERA.name]
        others = [message for message in messages if message.topic != CAMERA.name]
        minutes = (messages[-1].logged_ns - messages[0].logged_ns) / NS_PER_S / 60.0
        target = folder / "written.mcap"
        print(f"{len(others) / minutes / 60.0:.0f} messages and {len(images) / minutes / 60.0:.1f} images a second")
        for text, scene in (("without", lambda: None), ("with", lambda: ViewerScene(vehicle))):
            us, size_bytes = write(others, target, scene)
            print(f"{text} the scene: {us:.1f} us a message, {size_bytes / 1e6 / minutes:.2f} MB a minute")
        if images:
            size_bytes = sum(len(image.data) for image in images)
            print(f"images: {image_us(images):.0f} us each, about {0.75 * size_bytes / 1e6 / minutes:.1f} MB a minute")


if __name__ == "__main__":
    main()
