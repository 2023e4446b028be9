"""The twin's modules at real pseudo-terminals, read by the drivers of the real ones."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from jezero.base.vehicle_config import UwbLayoutConfig, VehicleConfig
from jezero.deploy.twin.modules import Dwm1001Shell, RoverDrive, RoverReceiver, module_ids
from jezero.runtime.links import SerialLine
from jezero.runtime.node import Mailbox
from jezero.runtime.service import Health, Publish, Send
from jezero.schemas.commands import RoverCommand
from jezero.schemas.sensors import RoverOdometry, Uwb, UwbRange
from jezero.schemas.topics import ROVER_COMMAND
from jezero.services.rover_driver.config import RoverDriverConfig
from jezero.services.rover_driver.service import COMMAND_LINK, ODOMETRY_LINK, RealRover
from jezero.services.uwb.config import UwbDriverConfig
from jezero.services.uwb.service import LINK, UwbDriver

pytestmark = pytest.mark.process

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


class RoverBench:
    """The rover's driver at one end of two lines, receiver and motors at the other, in real time."""

    def __init__(self, folder: Path) -> None:
        self.commanded: list[RoverCommand] = []
        self.receiver = RoverReceiver(folder / "receiver")
        self.drive = RoverDrive(folder / "motors", self.receiver, self.commanded.append)
        paths = {ODOMETRY_LINK: folder / "receiver", COMMAND_LINK: folder / "motors"}
        self.links = {name: SerialLine(str(path), 115_200) for name, path in paths.items()}
        addresses = [f"serial:{path}:115200" for path in paths.values()]
        self.driver = RealRover(RoverDriverConfig(link=addresses[0], command_link=addresses[1]))
        self.inbox = Mailbox(self.driver.spec.links)
        self.published: list[RoverOdometry] = []
        self.health = Health("starting", "")
        self.speed_mps = -0.5
        self.commands_mps = 0.0

    def run_until(self, done: Callable[[], bool]) -> None:
        start_s = time.monotonic()
        while not done():
            assert time.monotonic() - start_s < TIMEOUT_S, self.health
            self.turn()
            time.sleep(PERIOD_S)

    def turn(self) -> None:
        wall_ns = time.monotonic_ns()
        self.receiver.add(
            RoverOdometry(
                t_ns=wall_ns, pos_odom_m=(10.0, -5.0), yaw_rover_rad=-2.0, speed_rover_body_mps=self.speed_mps,
                yaw_rate_rover_rps=0.0,
            )
        )  # fmt: skip
        for module in (self.receiver, self.drive):
            module.turn(1e-9 * wall_ns)
        self.inbox.wall_ns = wall_ns
        for name, link in self.links.items():
            data = link.poll(wall_ns)
            self.inbox.set_link(name, link.up)
            if data:
                self.inbox.add_bytes(name, data)
        command = RoverCommand(t_ns=wall_ns, speed_rover_body_mps=self.commands_mps, yaw_rate_rover_rps=0.2)
        self.inbox.add_message(ROVER_COMMAND.name, command)
        for output in self.driver.step(wall_ns, self.inbox):
            if isinstance(output, Send):
                self.links[output.link].send(output.data)
            elif isinstance(output, Publish) and isinstance(output.message, RoverOdometry):
                self.published.append(output.message)
            elif isinstance(output, Health):
                self.health = output
        self.inbox.clear()


@pytest.fixture
def rover(tmp_path: Path) -> Iterator[RoverBench]:
    bench = RoverBench(tmp_path)
    yield bench
    for link in bench.links.values():
        link.close()
    bench.receiver.line.close()
    bench.drive.line.close()


def test_the_rovers_driver_reads_the_receiver_and_its_commands_reach_the_motors(rover: RoverBench) -> None:
    rover.commands_mps = 0.7
    rover.run_until(lambda: len(rover.published) >= 10 and len(rover.commanded) >= 10)
    newest = rover.published[-1]
    assert newest.yaw_rover_rad == pytest.approx(-2.0, abs=1e-3)
    assert newest.speed_rover_body_mps == pytest.approx(-0.5, abs=1e-3)
    assert (rover.commanded[-1].speed_rover_body_mps, rover.commanded[-1].yaw_rate_rover_rps) == (0.7, 0.2)
    assert abs(rover.commanded[-1].t_ns - time.monotonic_ns()) < 2e9


def test_a_receivers_plug_that_is_pulled_and_put_back_is_named_and_the_odometry_comes_again(rover: RoverBench) -> None:
    rover.run_until(lambda: rover.health.state == "ok")
    rover.receiver.line.unplug()
    rover.run_until(lambda: "is not open" in rover.health.text)
    count = len(rover.published)
    rover.receiver.line.plug()
    rover.run_until(lambda: len(rover.published) >= count + 10 and rover.health.state == "ok")
