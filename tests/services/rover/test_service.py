"""The rover's computer passes the rover's topics between the bus and the simulator."""

from jezero.base.rover_link import line_of
from jezero.runtime.node import Mailbox
from jezero.runtime.service import Health, Output, Publish, Send
from jezero.schemas import topics
from jezero.schemas.commands import RoverCommand
from jezero.schemas.sensors import RoverOdometry
from jezero.services.rover.service import SIMULATOR, SPEC, RoverComputer

COMMAND = RoverCommand(t_ns=5, speed_rover_body_mps=0.5, yaw_rate_rover_rps=0.1)
ADDRESS = "10.0.0.7:4810"


def odometry(t_ns: int) -> RoverOdometry:
    return RoverOdometry(
        t_ns=t_ns, pos_odom_m=(1.0, 2.0), yaw_rover_rad=0.5, speed_rover_body_mps=0.1, yaw_rate_rover_rps=0.0
    )


class Bench:
    """The service with a link that the test controls."""

    def __init__(self) -> None:
        self.service = RoverComputer(ADDRESS)
        self.inbox = Mailbox(SPEC.links)

    def step(self) -> list[Output]:
        outputs = list(self.service.step(0, self.inbox))
        self.inbox.clear()
        return outputs


def connected() -> Bench:
    bench = Bench()
    bench.inbox.set_link(SIMULATOR, True)
    bench.step()
    return bench


def test_it_publishes_each_reading_of_the_simulator_once_in_pieces_or_not() -> None:
    bench = connected()
    data = line_of(odometry(1)) + line_of(odometry(2))
    bench.inbox.add_bytes(SIMULATOR, data[:100])
    first = bench.step()
    bench.inbox.add_bytes(SIMULATOR, data[100:])
    outputs = first + bench.step() + bench.step()
    assert outputs == [Publish(topics.ROVER_ODOMETRY, odometry(t_ns)) for t_ns in (1, 2)]


def test_it_sends_each_command_of_the_bus_to_the_simulator() -> None:
    bench = connected()
    bench.inbox.add_message(topics.ROVER_COMMAND.name, COMMAND)
    assert bench.step() == [Send(SIMULATOR, line_of(COMMAND))]
    assert bench.step() == []


def test_without_a_connection_it_is_degraded_and_names_the_address() -> None:
    bench = Bench()
    bench.inbox.add_message(topics.ROVER_COMMAND.name, COMMAND)
    (health,) = bench.step()
    assert isinstance(health, Health)
    assert health.state == "degraded"
    assert ADDRESS in health.text
    assert bench.step() == []
    bench.inbox.set_link(SIMULATOR, True)
    assert bench.step() == [Health("ok", f"connected to the simulator at {ADDRESS}")]


def test_a_new_connection_does_not_continue_the_line_of_the_lost_one() -> None:
    bench = connected()
    bench.inbox.add_bytes(SIMULATOR, line_of(odometry(1))[:50])
    bench.step()
    bench.inbox.set_link(SIMULATOR, False)
    bench.inbox.set_link(SIMULATOR, True)
    bench.inbox.add_bytes(SIMULATOR, line_of(odometry(2)))
    assert bench.step() == [Publish(topics.ROVER_ODOMETRY, odometry(2))]


def test_what_is_no_odometry_is_dropped_and_counted() -> None:
    bench = connected()
    bench.inbox.add_bytes(SIMULATOR, b"hello\n" + line_of(COMMAND) + line_of(odometry(3)))
    outputs = bench.step()
    assert Publish(topics.ROVER_ODOMETRY, odometry(3)) in outputs
    assert isinstance(outputs[-1], Health)
    assert outputs[-1].text.endswith("; 2 invalid messages dropped")
