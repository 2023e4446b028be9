"""The codec packs and parses every message of the dialect exactly as pymavlink does, whole or in pieces."""

from random import Random
from typing import Any

import numpy as np
import pytest

from jezero.base.mavlink import FieldReader, FramePacker, MavlinkCodec, Signing, dialect


class Sink:
    def write(self, data: bytes) -> int:
        return len(data)


def fields_of(kind: Any, rng: Random) -> dict[str, Any]:
    """Something for every field of a message of a class of the dialect."""
    values: dict[str, Any] = {}
    for name, field, count in zip(kind.ordered_fieldnames, in_wire_order(kind), kind.array_lengths, strict=True):
        if field == "char":
            values[name] = b"jezero"[: count or 1]
        else:
            number = rng.uniform(-9.0, 9.0) if field in ("float", "double") else rng.randrange(100)
            values[name] = [number] * count if count else number
    return values


def in_wire_order(kind: Any) -> list[str]:
    types = dict(zip(kind.fieldnames, kind.fieldtypes, strict=True))
    return [types[name] for name in kind.ordered_fieldnames]


FIELDS = [(kind, fields_of(kind, Random(number))) for number, kind in enumerate(dialect.mavlink_map.values())]
MESSAGES = [kind(**fields) for kind, fields in FIELDS]


def test_every_message_is_packed_as_pymavlink_packs_it() -> None:
    codec, reference = MavlinkCodec(3, 7), dialect.MAVLink(Sink(), srcSystem=3, srcComponent=7)
    for message in MESSAGES:
        data = codec.pack(message)
        assert data == message.pack(reference), message.get_type()
        reference.seq = (reference.seq + 1) % 256


@pytest.mark.parametrize("signing", [None, Signing(bytes(32))])
def test_every_message_without_text_is_packed_from_its_numbers_as_it_is_whole(signing: Signing | None) -> None:
    whole, of_numbers, reader = MavlinkCodec(3, 7, signing), MavlinkCodec(3, 7, signing), MavlinkCodec(1, 1)
    for (kind, fields), message in zip(FIELDS, MESSAGES, strict=True):
        if "char" in kind.fieldtypes:
            continue
        numbers = (number for name in kind.ordered_fieldnames for number in np.ravel(fields[name]).tolist())
        data, expected = (
            of_numbers.pack_numbers(FramePacker(kind, *kind.ordered_fieldnames), *numbers),
            whole.pack(message),
        )
        assert signing is not None or data == expected, message.get_type()
        assert [read.to_dict() for read in reader.parse(data)] == [read.to_dict() for read in reader.parse(expected)]


@pytest.mark.parametrize("fields", [("type",), ("type", "custom_mode", "autopilot")])
def test_a_message_is_not_packed_from_a_part_of_its_numbers_nor_out_of_order(fields: tuple[str, ...]) -> None:
    with pytest.raises(ValueError, match="the fields of MAVLink_heartbeat_message are custom_mode, type, autopilot"):
        FramePacker(dialect.MAVLink_heartbeat_message, *fields)


def test_a_codec_with_a_peer_drops_the_messages_of_others() -> None:
    sent = [(system, component) for system in (3, 4) for component in (7, 8)]
    beat = dialect.MAVLink_heartbeat_message(2, 12, 0, 5, 0, 3)
    data = b"".join(MavlinkCodec(*sender).pack(beat) for sender in sent)
    for piece in (len(data), 5):
        codec = MavlinkCodec(1, 1, peer=(3, 8))
        received = [message for at in range(0, len(data), piece) for message in codec.parse(data[at : at + piece])]
        assert [(message.get_srcSystem(), message.get_srcComponent()) for message in received] == [(3, 8)]
        assert codec.malformed == 0


@pytest.mark.parametrize("piece", [1 << 20, 100, 7])
def test_every_message_is_parsed_as_pymavlink_parses_it_in_whatever_pieces_it_comes(piece: int) -> None:
    packer, codec, reference = MavlinkCodec(3, 7), MavlinkCodec(1, 1), dialect.MAVLink(Sink())
    data = b"".join(packer.pack(message) for message in MESSAGES)
    parsed = [message for at in range(0, len(data), piece) for message in codec.parse(data[at : at + piece])]
    expected = reference.parse_buffer(data)
    assert len(parsed) == len(expected)
    for own, theirs in zip(parsed, expected, strict=True):
        names = vars(theirs).keys() - {"_header", "_payload"}
        assert isinstance(own, type(theirs))
        assert {name: getattr(own, name) for name in names} == {name: getattr(theirs, name) for name in names}
        assert vars(own.get_header()) == vars(theirs.get_header())
        for getter in ("get_msgId", "get_srcSystem", "get_srcComponent", "get_seq", "get_type", "get_crc", "to_dict"):
            assert getattr(own, getter)() == getattr(theirs, getter)()
    assert codec.malformed == 0


@pytest.mark.parametrize("signing", [None, Signing(bytes(32))])
def test_what_was_parsed_can_be_changed_and_packed_again(signing: Signing | None) -> None:
    packer, codec = MavlinkCodec(3, 7), MavlinkCodec(1, 1)
    (message,) = codec.parse(packer.pack(dialect.MAVLink_heartbeat_message(2, 12, 0, 5, 0, 3)))
    message.custom_mode = 9
    (again,) = codec.parse(MavlinkCodec(4, 8, signing).pack(message))
    assert (again.custom_mode, again.get_srcSystem(), again.get_srcComponent()) == (9, 4, 8)


def test_what_was_changed_before_the_rest_was_read_stays_so() -> None:
    kind, fields = next((kind, fields) for kind, fields in FIELDS if kind is dialect.MAVLink_odometry_message)
    (message,) = MavlinkCodec(1, 1).parse(MavlinkCodec(3, 7).pack(kind(**fields)))
    message.x = 9.0
    assert message.y == pytest.approx(fields["y"])
    assert message.x == 9.0


@pytest.mark.parametrize("signing", [None, Signing(bytes(32))])
@pytest.mark.parametrize("quality", [0, 80])  # zeros at the end are not sent
def test_some_numbers_are_picked_as_they_are_read(signing: Signing | None, quality: int) -> None:
    kind, fields = next((kind, fields) for kind, fields in FIELDS if kind is dialect.MAVLink_odometry_message)
    sent = kind(**{**fields, "quality": quality, "q": [0.1, 0.2, 0.3, 0.4], "pose_covariance": [*range(21)]})
    (message,) = MavlinkCodec(1, 1, signing).parse(MavlinkCodec(3, 7, signing).pack(sent))
    pick = FieldReader(kind, "time_usec", "q", "pose_covariance[0]", "pose_covariance[6]", "frame_id", "quality")
    expected = (message.time_usec, *message.q, 0.0, 6.0, message.frame_id, quality)
    assert pick(message) == expected


@pytest.mark.parametrize("fields", [("y", "x"), ("z", "w"), ("q[4]",)])
def test_what_can_not_be_picked_is_named(fields: tuple[str, ...]) -> None:
    with pytest.raises(ValueError, match=rf"has no field '{fields[-1]}'".replace("[", r"\[")):
        FieldReader(dialect.MAVLink_odometry_message, *fields)


def test_a_message_has_no_other_fields_than_its_own() -> None:
    (message,) = MavlinkCodec(1, 1).parse(MavlinkCodec(3, 7).pack(dialect.MAVLink_heartbeat_message(2, 12, 0, 5, 0, 3)))
    with pytest.raises(AttributeError, match="MAVLink_heartbeat_message has no 'custom_made'"):
        _ = message.custom_made


def test_a_flipped_bit_costs_one_message_and_garbage_between_messages_none() -> None:
    packer, codec = MavlinkCodec(3, 7), MavlinkCodec(1, 1)
    frames = [packer.pack(dialect.MAVLink_heartbeat_message(2, 12, 0, number, 0, 3)) for number in range(4)]
    broken = bytearray(frames[1])
    broken[12] ^= 4
    parsed = codec.parse(frames[0] + bytes(broken) + frames[2] + b"garbage" + frames[3])
    assert [message.custom_mode for message in parsed] == [0, 2, 3]
    assert codec.malformed == 2
