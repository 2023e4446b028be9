"""While the rover's computer is connected, its link carries the rover's two topics, and the bus does not."""

from jezero.base.codec import decode
from jezero.base.lines import LINE_MAX_BYTES
from jezero.base.rover_link import line_of
from jezero.runtime.service import Health, Output, Send
from jezero.schemas import topics
from jezero.schemas.commands import RoverCommand
from jezero.schemas.sensors import RoverOdometry
from jezero.services.simulator.rover_port import ROVER
from jezero.services.simulator.schedule import STEPS_PER_S
from tests.services.simulator.test_service import STEP_NS, Bench, published


def on_link(outputs: list[Output]) -> list[RoverOdometry]:
    lines = [output.data for output in outputs if isinstance(output, Send) and output.link == ROVER]
    return [decode(RoverOdometry, line.removesuffix(b"\n")) for line in lines]


def forwards(bench: Bench, speed_mps: float = 1.0) -> RoverCommand:
    return RoverCommand(t_ns=bench.t_ns, speed_rover_body_mps=speed_mps, yaw_rate_rover_rps=0.0)


def connected() -> Bench:
    bench = Bench()
    bench.run(50)
    bench.rover_up, bench.rover_count = True, 1
    return bench


def test_without_a_rovers_computer_the_odometry_is_on_the_bus_alone() -> None:
    outputs = Bench().run(STEPS_PER_S)
    assert len(published(outputs, topics.ROVER_ODOMETRY)) in (24, 25)
    assert on_link(outputs) == []


def test_a_connected_rovers_computer_gets_each_reading_that_the_bus_would_get() -> None:
    bench, alone = connected(), Bench()
    alone.run(50)
    outputs = bench.run(STEPS_PER_S)
    assert published(outputs, topics.ROVER_ODOMETRY) == []
    assert on_link(outputs) == published(alone.run(STEPS_PER_S), topics.ROVER_ODOMETRY)


def test_a_lost_rovers_computer_leaves_the_odometry_to_the_bus_without_a_gap() -> None:
    bench = connected()
    sent = on_link(bench.run(STEPS_PER_S))
    bench.rover_up = False
    outputs = bench.run(STEPS_PER_S)
    assert on_link(outputs) == []
    assert published(outputs, topics.ROVER_ODOMETRY)[0].t_ns - sent[-1].t_ns == 10 * STEP_NS


def test_the_rover_follows_its_computer_and_not_the_bus() -> None:
    bench = connected()
    bench.rover_commands = [forwards(bench)]
    assert max(abs(o.speed_rover_body_mps) for o in on_link(bench.run(100))) < 0.1
    bench.rover_sends = line_of(forwards(bench))
    assert on_link(bench.run(100))[-1].speed_rover_body_mps > 0.1


def test_without_its_computer_the_rover_follows_the_bus() -> None:
    bench = Bench()
    bench.run(50)
    bench.rover_commands = [forwards(bench)]
    assert published(bench.run(100), topics.ROVER_ODOMETRY)[-1].speed_rover_body_mps > 0.1


def test_garbage_on_the_link_is_dropped_and_counted_and_the_next_command_counts() -> None:
    bench = connected()
    bench.rover_sends = b"\x00\xff{\n[]\n" + b"x" * (3 * LINE_MAX_BYTES)
    bench.run(5)
    bench.rover_sends = b"\n" + line_of(forwards(bench))
    outputs = bench.run(100)
    assert on_link(outputs)[-1].speed_rover_body_mps > 0.1
    assert [o.text for o in outputs if isinstance(o, Health)][-1].endswith("3 invalid messages dropped")


def test_health_says_whether_the_rovers_computer_is_there() -> None:
    bench = connected()
    (health,) = [o for o in bench.run(5) if isinstance(o, Health)]
    assert health == Health("ok", "an autopilot is connected; the rover's computer is connected")
    bench.rover_up = False
    (health,) = [o for o in bench.run(5) if isinstance(o, Health)]
    assert health.state == "ok"
    assert "the rover's computer is gone" in health.text
