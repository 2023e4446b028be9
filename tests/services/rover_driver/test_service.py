"""The rover's driver: odometry in, drive commands out, and what it says when something is wrong."""

import json

import pytest

from jezero.runtime.node import Mailbox
from jezero.runtime.service import Health, Output, Publish, Send
from jezero.schemas.commands import RoverCommand
from jezero.schemas.sensors import RoverOdometry
from jezero.schemas.topics import ROVER_COMMAND
from jezero.services.rover_driver.config import RoverDriverConfig
from jezero.services.rover_driver.service import COMMAND_LINK, ODOMETRY_LINK, RealRover
from tests.services.rover_driver.test_formats import hdt, rmc

S = 1_000_000_000
ADDRESS, OTHER = "serial:/dev/ttyUSB0:115200", "serial:/dev/ttyUSB1:115200"
GOOD = b'{"yaw_rad": 0.0, "speed_mps": 0.5}\n'


class Bench:
    """The driver at lines that the test plugs; its clock is 5 s behind the computer's."""

    def __init__(self, config: RoverDriverConfig) -> None:
        self.driver = RealRover(config)
        self.inbox = Mailbox(self.driver.spec.links)
        self.wall_ns = 100 * S
        self.healths: list[Health] = []
        for link in self.driver.spec.links:
            self.inbox.set_link(link, True)

    @property
    def health(self) -> Health:
        return self.healths[-1]

    def is_degraded(self, word: str) -> bool:
        """Whether the health is degraded, with this word in its sentence."""
        return self.health.state == "degraded" and word in self.health.text

    @property
    def t_ns(self) -> int:
        return self.wall_ns - 5 * S

    def step(self, data: bytes = b"", after_s: float = 0.1, command: RoverCommand | None = None) -> list[Output]:
        self.wall_ns += round(after_s * S)
        self.inbox.wall_ns = self.wall_ns
        if data:
            self.inbox.add_bytes(ODOMETRY_LINK, data)
        if command is not None:
            self.inbox.add_message(ROVER_COMMAND.name, command)
        outputs = list(self.driver.step(self.t_ns, self.inbox))
        self.inbox.clear()
        self.healths += [output for output in outputs if isinstance(output, Health)]
        return outputs

    def run(self, seconds: float, data: bytes = b"") -> list[RoverOdometry]:
        outputs = [output for _ in range(round(10 * seconds)) for output in self.step(data)]
        return [
            each.message for each in outputs if isinstance(each, Publish) and isinstance(each.message, RoverOdometry)
        ]

    def command(self, speed_mps: float = 0.5, age_s: float = 0.0, after_s: float = 0.1) -> list[dict[str, float]]:
        """Send a command; returns the lines that went to the rover."""
        t_ns = self.t_ns + round((after_s - age_s) * S)
        command = RoverCommand(t_ns=t_ns, speed_rover_body_mps=speed_mps, yaw_rate_rover_rps=0.1)
        return sent(self.step(after_s=after_s, command=command))


def sent(outputs: list[Output]) -> list[dict[str, float]]:
    data = b"".join(output.data for output in outputs if isinstance(output, Send))
    return [json.loads(line) for line in data.splitlines()]


@pytest.fixture
def bench() -> Bench:
    return Bench(RoverDriverConfig(link=ADDRESS, format="json", command_link=ADDRESS, delay_s=0.02))


def test_the_odometry_has_the_time_of_its_arrival_less_the_delay_and_is_dead_reckoned(bench: Bench) -> None:
    readings = bench.run(2.0, GOOD)
    assert readings[-1].t_ns == bench.t_ns - round(0.02 * S)
    assert readings[-1].pos_odom_m == pytest.approx((0.5 * 1.9, 0.0))
    assert readings[-1].speed_rover_body_mps == 0.5


def test_a_long_gap_is_not_reckoned_over(bench: Bench) -> None:
    bench.run(0.1, GOOD)
    bench.step(after_s=10.0)
    (reading,) = bench.run(0.1, GOOD)
    assert reading.pos_odom_m == (0.0, 0.0)


def test_a_command_goes_out_at_once_and_the_rover_is_stopped_half_a_second_after_the_last(bench: Bench) -> None:
    bench.step()
    assert bench.command() == [{"speed_mps": 0.5, "yaw_rate_rps": 0.1}]
    lines = [sent(bench.step()) for _ in range(15)]
    assert lines[:5] == [[]] * 5
    assert lines[5] == [{"speed_mps": 0.0, "yaw_rate_rps": 0.0}]
    assert sum(map(len, lines)) == 2, "the stop is sent again"


def test_a_command_that_is_old_or_overtaken_is_dropped(bench: Bench) -> None:
    bench.step()
    assert bench.command(age_s=0.4) == []
    assert len(bench.command(0.5)) == 1
    assert bench.command(0.9, age_s=0.2) == []


def test_commands_can_have_a_line_of_their_own_or_none() -> None:
    own = Bench(RoverDriverConfig(link=ADDRESS, command_link=OTHER))
    (send,) = [output for output in own.step() if isinstance(output, Send)]
    assert send.link == COMMAND_LINK
    none = Bench(RoverDriverConfig(link=ADDRESS))
    assert none.command() == []


def test_silence_garbage_no_fix_and_a_pulled_plug_are_told_apart_and_it_recovers_from_each() -> None:
    bench = Bench(RoverDriverConfig(link=ADDRESS))
    good = hdt(90.0) + rmc()
    for word, data, up in (
        ("nothing comes from the rover", b"", True),
        ("check format and baud rate", b"\x00\xfe\n", True),
        ("has no fix", hdt(90.0) + rmc(status="V"), True),
        ("sends no heading", rmc(), True),
        ("is not open: is it plugged in", b"", False),
    ):
        bench.run(4.0, good)
        assert bench.health.state == "ok"
        bench.inbox.set_link(ODOMETRY_LINK, up)
        bench.run(1.0, data)
        assert bench.run(4.0, data) == []
        assert bench.is_degraded(word), bench.health
        bench.inbox.set_link(ODOMETRY_LINK, True)


def test_without_a_link_it_is_ok_and_says_that_it_is_not_configured() -> None:
    bench = Bench(RoverDriverConfig())
    assert bench.run(2.0) == []
    assert bench.health.state == "ok"
    assert "not configured" in bench.health.text
