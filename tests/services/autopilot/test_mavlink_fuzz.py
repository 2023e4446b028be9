"""Garbage, flipped bits, foreign and forged messages on the autopilot's links have no effect; valid messages arrive."""

from dataclasses import dataclass
from random import Random

import msgspec
import pytest

from jezero.base.mavlink import MavlinkCodec, MavMessage, Signing, dialect
from jezero.base.vehicle_config import VehicleConfig
from jezero.services.autopilot.config import AutopilotConfig, SigningConfig
from jezero.services.autopilot.service import OFFBOARD, Autopilot
from tests.services.autopilot.test_service import ARM, Bench, kinds

KEY = bytes(range(32))
START_S = 3.0e8
MINUTE = 6_000_000
DISARM_LAND_MODE = ((ARM, 0.0), (21, 0.0), (176, 1.0), (22, 0.0), (20, 0.0))


def chunks(data: bytes, random: Random) -> list[bytes]:
    """Cut into datagrams of any length."""
    cuts, at = [], 0
    while at < len(data):
        length = random.randint(1, 4000)
        cuts.append(data[at : at + length])
        at += length
    return cuts


def test_two_megabytes_of_garbage_move_nothing_and_honest_commands_arrive_between() -> None:
    bench, random = Bench(), Random(1)
    bench.rest(5.0)
    for chunk in chunks(random.randbytes(2_000_000), random):
        received = bench.step(bench.sensor(), chunk)[OFFBOARD]
        assert not kinds(received, dialect.MAVLINK_MSG_ID_COMMAND_ACK)
        assert not any(m.base_mode & 128 for m in kinds(received, dialect.MAVLINK_MSG_ID_HEARTBEAT))
    results = []
    for _ in range(4):  # the tail of the garbage may swallow the start of what follows
        data = bench.companion.pack(dialect.MAVLink_command_long_message(1, 1, 520, 0, *[0.0] * 7))
        received = bench.step(bench.sensor(), bytes(300) + data)[OFFBOARD]
        results += kinds(received, dialect.MAVLINK_MSG_ID_COMMAND_ACK)
    assert results
    assert {m.result for m in results} == {dialect.MAV_RESULT_ACCEPTED}


def test_no_flipped_bit_makes_another_command() -> None:
    bench, random = Bench(), Random(2)
    bench.rest(5.0)
    for number in range(3000):
        command, parameter = DISARM_LAND_MODE[number % len(DISARM_LAND_MODE)]
        data = bytearray(
            bench.companion.pack(dialect.MAVLink_command_long_message(1, 1, command, 0, parameter, *[1.0] * 6))
        )
        position = random.randrange(8 * len(data))
        data[position // 8] ^= 1 << position % 8
        received = bench.step(bench.sensor(), bytes(data) + bytes(280))[OFFBOARD]
        assert not kinds(received, dialect.MAVLINK_MSG_ID_COMMAND_ACK)
    assert bench.command(520)[0] == dialect.MAV_RESULT_ACCEPTED


def test_commands_for_other_systems_and_components_or_in_its_own_name_are_not_carried_out() -> None:
    bench, random = Bench(), Random(3)
    bench.rest(5.0)
    for _ in range(2000):
        system, component = random.randint(2, 255), random.randint(2, 255)
        target = random.choice(((system, 1), (1, component), (system, component)))
        data = MavlinkCodec(random.randint(1, 255), random.randint(2, 255)).pack(
            dialect.MAVLink_command_long_message(*target, ARM, 0, 1.0, *[0.0] * 6)
        )
        data += MavlinkCodec(1, 1).pack(dialect.MAVLink_command_long_message(1, 1, ARM, 0, 1.0, *[0.0] * 6))
        assert not kinds(bench.step(bench.sensor(), data)[OFFBOARD], dialect.MAVLINK_MSG_ID_COMMAND_ACK)


def test_messages_of_all_kinds_with_any_content_leave_it_standing() -> None:
    bench, random = Bench(), Random(4)
    bench.rest(5.0)
    types = [t for number, t in sorted(dialect.mavlink_map.items()) if number not in {0}]
    for _ in range(4000):
        kind = random.choice(types)
        payload = random.randbytes(kind.unpacker.size)
        frame = _frame(kind, payload, random.randrange(256))
        bench.step(bench.sensor(), frame)
    assert kinds(bench.rest(0.5), dialect.MAVLINK_MSG_ID_ODOMETRY)


def _frame(kind: type[MavMessage], payload: bytes, sequence: int) -> bytes:
    """A valid frame around any payload, from system 255."""
    header = bytes([len(payload), 0, 0, sequence, 255, 190]) + kind.id.to_bytes(3, "little")
    crc = dialect.x25crc(header + payload + bytes([kind.crc_extra]))
    frame: bytes = b"\xfd" + header + payload + int(crc.crc).to_bytes(2, "little")
    return frame


# -- signing -------------------------------------------------------------------------------------------------


@dataclass
class Signed:
    """An autopilot that requires signatures, and a companion that can sign."""

    bench: Bench
    signing: Signing

    def arrives(self, data: bytes) -> bool:
        """Whether a command in these bytes was carried out."""
        received = self.bench.step(self.bench.sensor(), data)[OFFBOARD]
        return bool(kinds(received, dialect.MAVLINK_MSG_ID_COMMAND_ACK))

    def command(self, signing: Signing | None, component: int = 191) -> bytes:
        return MavlinkCodec(1, component, signing).pack(dialect.MAVLink_command_long_message(1, 1, 520, 0, *[0.0] * 7))

    def stamped(self, offset: int, component: int = 191) -> bytes:
        signing = Signing(KEY)
        signing.clock_10us = self.signing.clock_10us + offset
        return self.command(signing, component)


@pytest.fixture
def signed() -> Signed:
    config = msgspec.structs.replace(AutopilotConfig(), signing=SigningConfig(key=KEY.hex(), links=("gcs", "offboard")))
    bench = Bench()
    bench.autopilot = Autopilot(config, VehicleConfig(), 1, START_S)
    bench.rest(2.0)
    signing = Signing(KEY)
    signing.clock_10us = int(START_S * 1e5)
    return Signed(bench, signing)


def test_signed_messages_arrive_and_answers_are_signed(signed: Signed) -> None:
    assert signed.arrives(signed.command(signed.signing))
    assert signed.arrives(signed.command(signed.signing))
    answers = signed.bench.step(signed.bench.sensor(), signed.command(signed.signing))[OFFBOARD]
    reader = Signing(KEY)
    reader.clock_10us = signed.signing.clock_10us
    assert answers
    assert all(reader.accepts(m) for m in answers)


def test_unsigned_wrongly_signed_and_replayed_messages_are_refused_and_counted(signed: Signed) -> None:
    good = signed.command(signed.signing)
    assert signed.arrives(good)
    wrong = Signing(KEY[::-1])
    wrong.clock_10us = signed.signing.clock_10us + 100
    changed = bytearray(signed.command(signed.signing))
    changed[-1] ^= 1
    for bad in (signed.command(None), signed.command(wrong), good, bytes(changed)):
        assert not signed.arrives(bad)
    assert signed.bench.health[-1].text == "connected to the simulator; 4 messages without a valid signature"
    assert signed.arrives(signed.command(signed.signing))


def test_one_message_from_the_future_locks_nobody_out(signed: Signed) -> None:
    assert not signed.arrives(signed.stamped(60 * MINUTE))
    assert not signed.arrives(signed.stamped(MINUTE + 1))
    assert signed.arrives(signed.stamped(10))
    assert signed.arrives(signed.stamped(MINUTE - 1, component=192))
    assert signed.arrives(signed.stamped(20))
    assert not signed.arrives(signed.stamped(-2 * MINUTE, component=193))


def test_a_forged_message_does_not_touch_the_stream_it_pretends_to_be(signed: Signed) -> None:
    forged = bytearray(signed.stamped(1000))
    forged[-1] ^= 1
    assert not signed.arrives(bytes(forged))
    assert signed.arrives(signed.stamped(500))


def test_a_key_of_another_length_is_a_mistake() -> None:
    with pytest.raises(ValueError, match="32 bytes"):
        Signing(b"short")
