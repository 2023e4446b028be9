"""MAVLink signing on the ground-station link: forged and broken messages affect neither vehicle nor honest station."""

from collections import Counter
from collections.abc import Iterator
from random import Random

import msgspec

from jezero.base.config import load_config
from jezero.base.mavlink import MavlinkCodec, Signing, dialect
from jezero.runtime.memory_bus import UDP_DELAY
from jezero.runtime.service import Inbox, Output, Send, Spec
from jezero.schemas import topics
from jezero.schemas.state import StatusCode as Code
from jezero.services.autopilot.config import AutopilotConfig, SigningConfig
from jezero.trials.stack import build_stack
from tests.scenario.rig import Flight, go_to, land_at

KEY = bytes(range(32))
HOUR = 360_000_000
FORGED = ((400, 0.0, 21196.0), (21, 0.0, 0.0), (20, 0.0, 0.0), (176, 1.0, 4.0), (400, 1.0, 0.0))
"""Commands of the forgers: force-disarm, land, return, another mode, arm."""
HONEST_COMMAND = dialect.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES


class GroundLink:
    """An honest ground station that signs, and forgers on the same link.

    Attributes:
        requests: number of commands that the honest station has signed and sent.
        acknowledged: number of the autopilot's acknowledgements, by command and result.
    """

    spec = Spec(name="station", links=("autopilot",), rate_hz=10.0)

    def __init__(self) -> None:
        self.requests = 0
        self.acknowledged: Counter[tuple[int, int]] = Counter()
        self._random = Random(6)
        self._signing = Signing(KEY)
        self._honest = MavlinkCodec(255, 190, self._signing)
        self._reader = MavlinkCodec(255, 190)
        self._sent: list[bytes] = []

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        for message in self._reader.parse(inbox.received("autopilot")):
            if message.get_msgId() == dialect.MAVLINK_MSG_ID_COMMAND_ACK:
                self.acknowledged[message.command, message.result] += 1
        self._signing.clock_10us = t_ns // 10_000
        request = self._honest.pack(self._command(HONEST_COMMAND, 0.0, 0.0))
        self.requests += 1
        self._sent.append(request)
        replayed = self._random.choice(self._sent[:-1] or [b""])
        yield Send("autopilot", replayed + self._forgeries() + bytes(300) + request)

    def _forgeries(self) -> bytes:
        future, wrong, broken = Signing(KEY), Signing(KEY[::-1]), Signing(KEY)
        future.clock_10us, wrong.clock_10us, broken.clock_10us = (
            self._signing.clock_10us + HOUR,
            self._signing.clock_10us,
            self._signing.clock_10us,
        )
        flipped = bytearray(MavlinkCodec(255, 190, broken).pack(self._any()))
        flipped[self._random.randrange(10, len(flipped))] ^= 1 << self._random.randrange(8)
        signed = [MavlinkCodec(255, 190, signing).pack(self._any()) for signing in (None, wrong, future)]
        return b"".join(signed) + bytes(flipped) + self._random.randbytes(self._random.randrange(200))

    def _any(self) -> object:
        return self._command(*self._random.choice(FORGED))

    @staticmethod
    def _command(command: int, p1: float, p2: float) -> object:
        return dialect.MAVLink_command_long_message(1, 1, command, 0, p1, p2, *[0.0] * 5)


def test_forged_replayed_and_future_commands_on_the_ground_link_have_no_effect() -> None:
    config = load_config(AutopilotConfig, "autopilot")
    config = msgspec.structs.replace(config, signing=SigningConfig(key=KEY.hex()))
    flight, ground = Flight(seed=5, make_bus=lambda seed: build_stack(seed, autopilot=config)), GroundLink()
    flight.bus.wire(("autopilot", "gcs"), ("station", "autopilot"), UDP_DELAY)
    flight.bus.add(ground)
    flight.take_off(3.0)
    flight.do(topics.GO_TO, go_to(4.0, 0.0, -3.0))
    flight.do(topics.LAND_ON_SPOT, land_at(4.0, 0.0))
    assert Code.EXTERNAL not in flight.codes
    assert ground.requests > 200
    (acknowledged_command,) = ground.acknowledged
    assert acknowledged_command == (HONEST_COMMAND, dialect.MAV_RESULT_ACCEPTED)
    assert ground.requests - ground.acknowledged[acknowledged_command] <= 3
