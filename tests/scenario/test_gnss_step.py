"""GNSS jumps by 1.5 m while the vehicle hovers: its position is relabelled, the vehicle stays."""

from collections.abc import Iterable
from math import degrees

from jezero.deploy.in_process import build_stack
from jezero.frames import EARTH_RADIUS_M, horizontal, subtract
from jezero.mavlink import MavlinkCodec, dialect
from jezero.runtime.service import Inbox, Output, Send, Service
from jezero.schemas import topics
from tests.scenario.rig import Flight, go_to, land_at

STEP_NORTH_M = 1.5


class GnssStep:
    """A simulator whose fixes move north by 1.5 m once `stepped` is set."""

    def __init__(self, simulator: Service) -> None:
        self._simulator = simulator
        self.spec = simulator.spec
        self.stepped = False
        self._codec = MavlinkCodec(1, 25)

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Output]:
        for output in self._simulator.step(t_ns, inbox):
            yield self._moved(output) if self.stepped and isinstance(output, Send) else output

    def _moved(self, output: Send) -> Send:
        data = b""
        for message in MavlinkCodec(1, 25).parse(output.data):
            if message.get_msgId() == dialect.MAVLINK_MSG_ID_HIL_GPS:
                message.lat += round(degrees(STEP_NORTH_M / EARTH_RADIUS_M) * 1e7)
            data += self._codec.pack(message)
        return Send(output.link, data)


def test_a_gnss_step_while_hovering_does_not_make_the_vehicle_jump() -> None:
    wrapped: list[GnssStep] = []

    def wrap(simulator: Service) -> Service:
        wrapped.append(GnssStep(simulator))
        return wrapped[0]

    flight = Flight(seed=3, prepare=lambda seed: build_stack(seed, wrap_simulator=wrap))
    flight.take_off(3.0)
    flight.bus.run_for(3.0)
    before = flight.truth
    wrapped[0].stepped = True
    start = len(flight.truths)
    flight.bus.run_for(15.0)
    after = flight.truths[start:]
    odometry = flight.status.odometry
    assert odometry is not None
    assert odometry.reset_counter > 0
    assert 1.0 < odometry.reset_offset_ned_m[0] < 2.0
    assert max(horizontal(subtract(t.pos_uav_ned_m, before.pos_uav_ned_m)) for t in after) < 0.5
    assert max(horizontal(t.vel_uav_ned_mps) for t in after) < 0.5
    flight.do(topics.GO_TO, go_to(0.0, 0.0, -3.0))
    flight.do(topics.LAND_ON_SPOT, land_at(0.0, 0.0))
