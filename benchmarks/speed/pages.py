"""Cost of the ground station: nobody looks, one viewer, two, and one who does not read what is sent to him.

`python -m benchmarks.speed.pages` starts a stack, hovers, and prints the use of the ground station's process.
"""

import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

from benchmarks.speed.page_viewer import PageViewer
from benchmarks.speed.stack import HOVER_ALTITUDE_M, Stack, cpu_ns, memory_mb, running_stack
from jezero import Vehicle
from jezero.deploy.launcher.ports import reserved_instance
from jezero.deploy.launcher.state import RunFolder

SETTLE_S = 5.0
MEASURE_S = 20.0
RATE_PICTURES_HZ = 5.0
CASES: tuple[tuple[str, tuple[bool, ...]], ...] = (
    ("nobody", ()),
    ("one", (True,)),
    ("two", (True, True)),
    ("one, and one stalled", (True, False)),
    ("nobody again", ()),
)
"""Who looks, and whether each of them reads what is sent to him."""


class Cost(NamedTuple):
    """Use of the server during one measurement.

    Attributes:
        what: who looks.
        cpu: fraction of a core.
        rss_mb: resident memory at the end.
        messages_hz: messages per second to the first viewer who reads.
        kbps: their size, in kB/s.
        pictures_hz: pictures per second to that viewer.
    """

    what: str
    cpu: float
    rss_mb: float
    messages_hz: float
    kbps: float
    pictures_hz: float


def measure(stack: Stack, address: str, what: str, *viewers: bool) -> Cost:
    """Measure with viewers; each is True if it reads what is sent to it.

    Raises:
        RuntimeError: the ground station does not run.
    """
    pid = stack.processes()["ground_station"]
    with ExitStack() as pages:
        opened = [
            pages.enter_context(PageViewer(address, reads=reads, rate_pictures_hz=RATE_PICTURES_HZ if reads else 0.0))
            for reads in viewers
        ]
        reader = next((viewer for viewer, reads in zip(opened, viewers, strict=True) if reads), None)
        time.sleep(SETTLE_S)
        before = _counts(pid, reader)
        time.sleep(MEASURE_S)
        after = _counts(pid, reader)
        cpu, messages, size, pictures = ((end - start) / MEASURE_S for start, end in zip(before, after, strict=True))
        return Cost(what, cpu * 1e-9, memory_mb(pid)[0], messages, size / 1e3, pictures)


def _counts(pid: int, viewer: PageViewer | None) -> tuple[int, int, int, int]:
    """Processor time in ns, and what a viewer has got."""
    got = (0, 0, 0) if viewer is None else (viewer.messages, viewer.bytes, viewer.pictures)
    return (cpu_ns(pid), *got)


def address_of(stack: Stack) -> str:
    """Address of the stack's pages.

    Raises:
        RuntimeError: it has none.
    """
    state = RunFolder(stack.folder).read()
    if state is None or not state.page_address:
        raise RuntimeError("the stack has no ground station")
    return state.page_address


def main() -> None:
    """Measure, and print a line for each case."""
    with (
        tempfile.TemporaryDirectory() as folder,
        reserved_instance(vehicle="pages") as instance,
        running_stack(instance, Path(folder)) as stack,
    ):
        with Vehicle.connect(instance.vehicle, router=instance.router) as uav:
            uav.wait_ready()
            uav.takeoff(altitude_m=HOVER_ALTITUDE_M).result(timeout_s=60)
        address = address_of(stack)
        print("who looks               % of a core   RSS MB   messages/s   kB/s   pictures/s")
        for what, viewers in CASES:
            cost = measure(stack, address, what, *viewers)
            print(
                f"{cost.what:<24}{100 * cost.cpu:>11.1f}{cost.rss_mb:>9.1f}{cost.messages_hz:>13.1f}{cost.kbps:>7.1f}"
                f"{cost.pictures_hz:>13.1f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
