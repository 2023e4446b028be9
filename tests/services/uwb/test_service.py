"""The UWB driver: what it publishes, and what it says about a module that is silent, garbled, unknown or unplugged."""

import pytest

from jezero.base.vehicle_config import UwbLayoutConfig, VehicleConfig
from jezero.runtime.node import Mailbox
from jezero.runtime.service import Health, Output, Publish, Send
from jezero.schemas.sensors import Uwb
from jezero.services.uwb.config import UwbDriverConfig
from jezero.services.uwb.dwm1001 import WAKE
from jezero.services.uwb.service import LINK, UwbDriver

S = 1_000_000_000
IDS = ("022E", "1a2b", "0C31", "4F02")
LINE = b'{"ranges_m": {"4f02": 1.5, "022E": 3.44, "1A2B": 5.01, "0c31": 2.0}}\n'


class Bench:
    """The driver at a line that the test plugs; its clock is 5 s behind the computer's."""

    def __init__(self, kind: str = "json", link: str = "serial:/dev/ttyUSB0:115200") -> None:
        config = UwbDriverConfig(link=link, format=kind, delay_s=0.05)  # type: ignore[arg-type]
        self.driver = UwbDriver(config, VehicleConfig(uwb=UwbLayoutConfig(id_anchors=IDS)))
        self.inbox = Mailbox(self.driver.spec.links)
        self.wall_ns = 100 * S
        self.healths = [Health("starting", "")]

    @property
    def health(self) -> Health:
        return self.healths[-1]

    def is_degraded(self, word: str) -> bool:
        """Whether the health is degraded, with this word in its sentence."""
        return self.health.state == "degraded" and word in self.health.text

    def step(self, data: bytes = b"", after_s: float = 0.05, *, timed: bool = True) -> list[Output]:
        self.wall_ns += round(after_s * S)
        self.inbox.wall_ns = self.wall_ns
        if data:
            self.inbox.add_bytes(LINK, data)
        outputs = list(self.driver.step(self.wall_ns - 5 * S if timed else 0, self.inbox))
        self.inbox.clear()
        for output in outputs:
            if isinstance(output, Health):
                self.healths.append(output)
        return outputs

    def run(self, seconds: float, data: bytes = b"") -> list[Uwb]:
        outputs = [output for _ in range(round(seconds / 0.05)) for output in self.step(data)]
        return [output.message for output in outputs if isinstance(output, Publish) and isinstance(output.message, Uwb)]


@pytest.fixture
def bench() -> Bench:
    bench = Bench()
    bench.inbox.set_link(LINK, True)
    return bench


def test_a_round_has_the_places_of_the_anchors_and_the_time_of_its_arrival_less_the_delay(bench: Bench) -> None:
    (publish,) = (output for output in bench.step(LINE) if isinstance(output, Publish))
    uwb = publish.message
    assert isinstance(uwb, Uwb)
    assert uwb.t_ns == bench.wall_ns - 5 * S - round(0.05 * S)
    assert [(each.anchor, each.range_m) for each in uwb.ranges] == [(0, 3.44), (1, 5.01), (2, 2.0), (3, 1.5)]
    assert uwb.ranges[3].pos_anchor_rover_body_m == (-0.45, 0.45, 0.0)
    assert {each.t_ns for each in uwb.ranges} == {uwb.t_ns}


def test_of_rounds_that_arrive_at_once_each_anchors_newest_range_is_published(bench: Bench) -> None:
    (uwb,) = bench.run(0.05, b'{"ranges_m": {"022E": 3.0, "1A2B": 5.0}}\n{"ranges_m": {"022E": 3.1}}\n')
    assert [(each.anchor, each.range_m) for each in uwb.ranges] == [(0, 3.1), (1, 5.0)]


def test_a_range_beyond_the_modules_reach_and_one_of_zero_are_left_out(bench: Bench) -> None:
    (uwb,) = bench.run(0.05, b'{"ranges_m": {"022E": 16.0, "1A2B": 0.0, "0C31": 14.0}}\n')
    assert [each.anchor for each in uwb.ranges] == [2]


def test_without_vehicle_time_nothing_is_published(bench: Bench) -> None:
    assert not [output for output in bench.step(LINE, timed=False) if isinstance(output, Publish)]
    bench.step(LINE, after_s=1.0, timed=False)
    assert bench.health.state == "degraded"
    assert "no vehicle time yet" in bench.health.text


def test_a_module_that_works_is_ok_with_its_rate(bench: Bench) -> None:
    assert len(bench.run(3.0, LINE)) == 60
    assert bench.health == Health("ok", "20 rounds/s from 4 anchors")


def test_an_unknown_module_and_a_missing_one_are_named(bench: Bench) -> None:
    bench.run(3.0, b'{"ranges_m": {"022E": 3.44, "1A2B": 5.01, "4F02": 1.5, "BEEF": 2.0}}\n')
    assert bench.health.state == "degraded"
    assert "no range from 0C31" in bench.health.text
    assert "BEEF is no anchor in vehicle.toml" in bench.health.text


def test_silence_garbage_and_a_pulled_plug_are_told_apart_and_it_recovers_from_each(bench: Bench) -> None:
    for word, data, up in (
        ("nothing comes from the UWB module", b"", True),
        ("has no ranges of the format json", b"\x00\xfe\n", True),
        ("is not open: is the module plugged in", b"", False),
    ):
        bench.run(3.0, LINE)
        assert bench.health.state == "ok"
        bench.inbox.set_link(LINK, up)
        assert bench.run(4.0, data) == []
        assert bench.is_degraded(word), bench.health
        bench.inbox.set_link(LINK, True)
    bench.run(3.0, LINE)
    assert bench.health.state == "ok"


def test_half_a_line_before_the_plug_was_pulled_is_not_continued(bench: Bench) -> None:
    bench.step(LINE[:30])
    bench.inbox.set_link(LINK, False)
    bench.step()
    bench.inbox.set_link(LINK, True)
    assert bench.run(0.05, LINE[30:]) == []
    assert len(bench.run(0.05, LINE)) == 1


def test_the_shell_of_a_silent_dwm1001_is_woken_when_its_line_is_open() -> None:
    bench = Bench("dwm1001")
    closed = [output for _ in range(80) for output in bench.step() if isinstance(output, Send)]
    bench.inbox.set_link(LINK, True)
    opened = [output for _ in range(80) for output in bench.step() if isinstance(output, Send)]
    assert closed == []
    assert opened[0] == Send(LINK, WAKE)


def test_without_a_link_it_is_ok_says_that_it_is_not_configured_and_does_nothing() -> None:
    bench = Bench(link="")
    assert bench.driver.spec.links == ()
    assert bench.run(3.0) == []
    assert bench.health.state == "ok"
    assert "not configured" in bench.health.text


@pytest.mark.parametrize("ids", [("A", "B"), ("A", "B", "C", "a")])
def test_ids_that_are_too_few_or_twice_there_are_refused(ids: tuple[str, ...]) -> None:
    with pytest.raises(ValueError, match="id_anchors"):
        UwbLayoutConfig(id_anchors=ids)
