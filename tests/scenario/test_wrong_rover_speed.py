"""A rover whose odometry measures a wrong speed, as with wheels that slip, is landed on, and its odometry is named.

`pytest -s -m "" tests/scenario/test_wrong_rover_speed.py` flies all and prints a row for each.
"""

from math import hypot

import msgspec
import pytest
from msgspec.structs import replace

from jezero.base.codec import decode, encode
from jezero.base.frames import subtract
from jezero.schemas import topics
from jezero.schemas.goals import LandOnSpotGoal
from jezero.schemas.health import ServiceHealth
from jezero.schemas.sensors import RoverOdometry
from jezero.trials.stack import RoverDriver
from tests.scenario.rig import Flight, go_to

OFF_MAX_M = 0.3
NAMED = "the rover's speed is left out"
SLIPS = ((0.5, 0.0), (1.0, -1.0), (1.0, 0.0), (1.0, 0.5), (1.0, 1.5), (1.0, 2.0))
"""Speed of the rover in m/s, and the part of it that its odometry measures."""


class SlippingRover(Flight):
    """A flight to a rover whose odometry measures a wrong speed.

    Args:
        factor: of the measured speed to the true one.
        more_mps: what is measured beyond it.

    Attributes:
        named: what the estimator's health said of the rover's speed, or "".
    """

    def __init__(self, factor: float, more_mps: float = 0.0) -> None:
        super().__init__(1)
        self.named = ""
        self.driver = RoverDriver()
        self.bus.add(self.driver)
        health = topics.health_of("estimator").name

        def tamper(sender: str, receiver: str, name: str, t_ns: int, data: bytes) -> list[tuple[int, bytes]]:
            if name == topics.ROVER_ODOMETRY.name:
                measured: RoverOdometry = decode(RoverOdometry, data)
                wrong_mps = factor * measured.speed_rover_body_mps + more_mps
                data = encode(replace(measured, speed_rover_body_mps=wrong_mps))
            return [(t_ns, data)]

        def listen(t_ns: int, topic: str, data: bytes) -> None:
            if topic == health and NAMED in (text := msgspec.json.decode(data, type=ServiceHealth).text):
                self.named = text

        self.bus.tamper = tamper
        self.bus.observe(listen)

    def land(self, speed_mps: float, **goal: object) -> float:
        """Land on the rover that drives at a speed; returns the error of the touchdown in m."""
        self.take_off(4.0)
        self.do(topics.GO_TO, go_to(-2.0, 0.0, -4.0))
        self.driver.speed_mps = speed_mps
        self.bus.run_for(1.0)
        self.do(topics.LAND_ON_SPOT, LandOnSpotGoal(**goal))  # type: ignore[arg-type]
        return hypot(*subtract(self.truth.pos_uav_ned_m, self.truth.pos_rover_ned_m)[:2])


@pytest.mark.parametrize("use_uwb", [True, False], ids=["by UWB and tag", "by tag"])
def test_a_rover_that_stands_while_its_wheels_turn_is_landed_on(use_uwb: bool) -> None:
    flight = SlippingRover(1.0, more_mps=1.0)
    spot_ned_m = None if use_uwb else (0.0, 0.0, 0.0)
    off_m = flight.land(0.0, use_uwb=use_uwb, landing_spot_ned_m=spot_ned_m)
    assert off_m < OFF_MAX_M
    assert NAMED in flight.named


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize(("speed_mps", "measured"), SLIPS)
def test_a_rover_that_drives_at_another_speed_than_it_measures_is_landed_on(speed_mps: float, measured: float) -> None:
    flight = SlippingRover(measured)
    off_m = flight.land(speed_mps)
    print(f"\nrover at {speed_mps} m/s that measures {measured * speed_mps} m/s: {off_m:.3f} m off, {flight.named}")
    assert off_m < OFF_MAX_M
    assert NAMED in flight.named
