"""The twin's modules at real pseudo-terminals, read by the drivers of the real ones."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from jezero.base.vehicle_config import UwbLayoutConfig, VehicleConfig
from jezero.deploy.twin.modules import Dwm1001Shell, module_ids
from jezero.runtime.links import SerialLine
from jezero.runtime.node import Mailbox
from jezero.runtime.service import Health, Publish, Send
from jezero.schemas.sensors import Uwb, UwbRange
from jezero.services.uwb.config import UwbDriverConfig
from jezero.services.uwb.service import LINK, UwbDriver

TIMEOUT_S = 30.0
PERIOD_S = 0.02


def round_of(range_m: float) -> Uwb:
    ranges = (
        UwbRange(t_ns=1, anchor=i, pos_anchor_rover_body_m=(0.45, -0.45, 0.0), range_m=range_m + i) for i in range(4)
    )
    return Uwb(t_ns=1, ranges=tuple(ranges))


class Bench:
    """The driver at one end of the line, the module at the other, in real time."""

    def __init__(self, folder: Path) -> None:
        self.module = Dwm1001Shell(folder / "uwb")
        vehicle = VehicleConfig(uwb=UwbLayoutConfig(id_anchors=tuple(module_ids(4))))
        self.driver = UwbDriver(UwbDriverConfig(link=f"serial:{folder / 'uwb'}:115200"), vehicle)
        self.link = SerialLine(str(folder / "uwb"), 115_200)
        self.inbox = Mailbox(self.driver.spec.links)
        self.published: list[Uwb] = []
        self.health = Health("starting", "")
        self.noise = b""

    def run_until(self, done: Callable[[], bool]) -> None:
        start_s = time.monotonic()
        while not done():
            assert time.monotonic() - start_s < TIMEOUT_S, self.health
            self.turn()
            time.sleep(PERIOD_S / 4)

    def turn(self) -> None:
        wall_ns = time.monotonic_ns()
        if not self.module.rounds:
            self.module.rounds.append(round_of(3.0))
        if self.noise:
            self.module.line.put(self.noise)
        self.module.turn(1e-9 * wall_ns)
        data = self.link.poll(wall_ns)
        self.inbox.set_link(LINK, self.link.up)
        self.inbox.wall_ns = wall_ns
        if data:
            self.inbox.add_bytes(LINK, data)
        for output in self.driver.step(wall_ns, self.inbox):
            if isinstance(output, Send):
                self.link.send(output.data)
            elif isinstance(output, Publish) and isinstance(output.message, Uwb):
                self.published.append(output.message)
            elif isinstance(output, Health):
                self.health = output
        self.inbox.clear()


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    bench = Bench(tmp_path)
    yield bench
    bench.link.close()
    bench.module.line.close()


def test_the_driver_wakes_the_shell_of_a_module_and_publishes_its_ranges(bench: Bench) -> None:
    bench.run_until(lambda: len(bench.published) >= 20)
    assert [(each.anchor, each.range_m) for each in bench.published[-1].ranges] == [
        (0, 3.0),
        (1, 4.0),
        (2, 5.0),
        (3, 6.0),
    ]
    assert bench.published[-1].ranges[0].pos_anchor_rover_body_m == (0.45, 0.45, 0.0), "that of vehicle.toml"


def test_a_plug_that_is_pulled_and_put_back_is_named_and_the_ranges_come_again(bench: Bench) -> None:
    bench.run_until(lambda: bench.health.state == "ok")
    bench.module.line.unplug()
    bench.run_until(lambda: "is not open" in bench.health.text)
    count = len(bench.published)
    bench.module.line.plug()
    bench.run_until(lambda: len(bench.published) >= count + 10 and bench.health.state == "ok")


def test_garbage_on_the_line_is_counted_and_the_ranges_come_again(bench: Bench) -> None:
    bench.run_until(lambda: bench.health.state == "ok")
    bench.noise = b"\x00\xffDIST,4,AN0,A0\n"
    bench.run_until(lambda: "damaged" in bench.health.text)
    bench.noise = b""
    count = len(bench.published)
    bench.run_until(lambda: len(bench.published) >= count + 10)
