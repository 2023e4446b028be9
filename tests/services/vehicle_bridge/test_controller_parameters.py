"""Parameters of a flight controller are read and set over a link that loses messages."""

from collections.abc import Iterator

import pytest

from jezero.base.mavlink import MavlinkCodec, Signing, dialect
from jezero.services.vehicle_bridge.controller_parameters import ParameterExchange
from tests.services.vehicle_bridge.rig import FakeAutopilot

MS = 1_000_000


def run(exchange: ParameterExchange, autopilot: FakeAutopilot, seconds: float = 10.0) -> Iterator[int]:
    """Times in ms at which something was sent, until all is done."""
    data, now_ns = autopilot.codec.pack(dialect.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3)), 0
    while not exchange.done and now_ns < seconds * 1e9:
        out = exchange.step(data, now_ns)
        data = autopilot.handle(out)
        if out:
            yield now_ns // MS
        now_ns += 10 * MS


def test_parameters_are_read_with_their_types_and_unknown_ones_are_named() -> None:
    autopilot = FakeAutopilot(system_id=9)
    autopilot.parameters = {"COM_OF_LOSS_T": 0.5, "COM_OBL_RC_ACT": 3}
    exchange = ParameterExchange()
    exchange.read(["COM_OF_LOSS_T", "COM_OBL_RC_ACT", "MAV_9_RATE"])
    assert list(run(exchange, autopilot))
    assert exchange.done
    assert exchange.system_id == 9
    assert exchange.values == {"COM_OF_LOSS_T": 0.5, "COM_OBL_RC_ACT": 3}
    assert exchange.unknown == ["MAV_9_RATE"]


def test_a_lost_reply_is_asked_for_again() -> None:
    autopilot = FakeAutopilot()
    autopilot.parameters, autopilot.lost_reads = {"COM_OBL_RC_ACT": 3}, 2
    exchange = ParameterExchange(system_id=1)
    exchange.read(["COM_OBL_RC_ACT"])
    list(run(exchange, autopilot))
    assert exchange.values == {"COM_OBL_RC_ACT": 3}
    assert autopilot.read_parameters == ["COM_OBL_RC_ACT"] * 3


def test_a_parameter_is_set_when_the_controller_reports_the_value() -> None:
    autopilot = FakeAutopilot()
    autopilot.parameters = {"COM_OBL_RC_ACT": 3, "COM_OF_LOSS_T": 0.5}
    exchange = ParameterExchange(system_id=1)
    exchange.set("COM_OBL_RC_ACT", 4)
    exchange.set("COM_OF_LOSS_T", 1.0)
    list(run(exchange, autopilot))
    assert autopilot.parameters == {"COM_OBL_RC_ACT": 4, "COM_OF_LOSS_T": 1.0}
    assert exchange.done


def test_another_systems_parameters_are_not_taken() -> None:
    autopilot = FakeAutopilot(system_id=9)
    autopilot.parameters = {"COM_OBL_RC_ACT": 3}
    exchange = ParameterExchange(system_id=1)
    exchange.read(["COM_OBL_RC_ACT"])
    list(run(exchange, autopilot))
    assert exchange.values == {}
    assert exchange.unknown == ["COM_OBL_RC_ACT"]


def test_ardupilots_parameters_are_left_alone() -> None:
    exchange = ParameterExchange()
    exchange.set("COM_OBL_RC_ACT", 4)
    autopilot = FakeAutopilot()
    exchange.step(autopilot.codec.pack(dialect.MAVLink_heartbeat_message(2, 3, 0, 0, 3, 3)), 0)
    assert exchange.done and exchange.refusal.startswith("the flight controller runs ArduPilot")
    assert autopilot.set_parameters == []


def test_the_controller_hears_a_heartbeat_twice_a_second_from_the_start_on() -> None:
    """Over USB, PX4 replies only to programs whose HEARTBEATs it receives."""
    exchange, codec, times_ms = ParameterExchange(), MavlinkCodec(1, 1), []
    exchange.read(["COM_OBL_RC_ACT"])
    active_computer = (dialect.MAV_TYPE_ONBOARD_CONTROLLER, dialect.MAV_AUTOPILOT_INVALID, dialect.MAV_STATE_ACTIVE)
    for now_ms in range(0, 1500, 10):
        for message in codec.parse(exchange.step(b"", now_ms * MS)):
            assert message.get_msgId() == dialect.MAVLINK_MSG_ID_HEARTBEAT, "no controller is known that could reply"
            assert (message.type, message.autopilot, message.system_status) == active_computer
            times_ms.append(now_ms)
    assert times_ms == [0, 500, 1000]


def test_at_most_eight_requests_wait_for_their_replies_and_each_is_sent_again_three_times_a_second() -> None:
    """A slow line has a small buffer."""
    exchange, codec = ParameterExchange(system_id=1), MavlinkCodec(9, 1)
    names = [f"P{number:02}" for number in range(20)]
    exchange.read(names)
    sent: dict[str, list[int]] = {}
    for now_ms in range(0, 2000, 100):
        for message in codec.parse(exchange.step(b"", now_ms * MS)):
            if message.get_msgId() == dialect.MAVLINK_MSG_ID_PARAM_REQUEST_READ:
                sent.setdefault(message.param_id, []).append(now_ms)
                assert (message.target_system, message.target_component, message.param_index) == (1, 1, -1)
    assert sent == {name: [0, 300, 600, 900, 1200, 1500, 1800] for name in names[:8]}


def test_a_parameter_is_given_up_after_eight_tries_and_the_next_one_is_asked_for() -> None:
    exchange, codec = ParameterExchange(system_id=1), MavlinkCodec(9, 1)
    names = [f"P{number:02}" for number in range(9)]
    exchange.read(names)
    tries: dict[str, int] = dict.fromkeys(names, 0)
    for now_ms in range(0, 2900, 100):
        for message in codec.parse(exchange.step(b"", now_ms * MS)):
            if message.get_msgId() == dialect.MAVLINK_MSG_ID_PARAM_REQUEST_READ:
                tries[message.param_id] += 1
    assert tries == {**dict.fromkeys(names[:8], 8), names[8]: 2}
    assert exchange.unknown == names[:8]
    assert not exchange.done


def test_a_value_that_was_set_counts_when_it_is_reported_and_not_the_one_before() -> None:
    autopilot, exchange = FakeAutopilot(), ParameterExchange(system_id=1)
    exchange.set("COM_OBL_RC_ACT", 4)
    done = []
    for number, value in enumerate((3, 4)):
        autopilot.parameters = {"COM_OBL_RC_ACT": value}
        exchange.step(autopilot.parameter("COM_OBL_RC_ACT"), number * 10 * MS)
        done.append(exchange.done)
    assert done == [False, True]
    assert exchange.values == {"COM_OBL_RC_ACT": 4}


def test_only_the_controller_itself_and_the_first_one_found_counts() -> None:
    exchange = ParameterExchange()
    exchange.read(["COM_OBL_RC_ACT"])
    px4, ardupilot = (dialect.MAVLink_heartbeat_message(2, kind, 0, 0, 3, 3) for kind in (12, 3))
    exchange.step(MavlinkCodec(7, 100).pack(px4), 0)  # a camera
    assert exchange.system_id == 0
    exchange.step(MavlinkCodec(9, 1).pack(px4), 10 * MS)
    exchange.step(MavlinkCodec(5, 1).pack(ardupilot), 20 * MS)
    assert (exchange.system_id, exchange.refusal) == (9, "")
    value = dialect.MAVLink_param_value_message(b"COM_OBL_RC_ACT", 1.0, dialect.MAV_PARAM_TYPE_REAL32, 1, 0)
    exchange.step(MavlinkCodec(9, 100).pack(value), 30 * MS)
    exchange.step(MavlinkCodec(5, 1).pack(value), 40 * MS)
    assert exchange.values == {}
    exchange.step(MavlinkCodec(9, 1).pack(value), 50 * MS)
    assert exchange.values == {"COM_OBL_RC_ACT": 1.0}


@pytest.mark.parametrize("same_key", [True, False])
def test_over_a_signed_link_only_a_controller_with_the_key_reads_and_replies(same_key: bool) -> None:
    key, since_2015_s = bytes(range(32)), 3.5e8
    signing = Signing(key if same_key else bytes(32))
    signing.clock_10us = int(since_2015_s * 1e5) + 1
    autopilot = FakeAutopilot(signing=signing)
    autopilot.parameters = {"COM_OBL_RC_ACT": 3}
    exchange = ParameterExchange(1, key, since_2015_s)
    exchange.read(["COM_OBL_RC_ACT"])
    list(run(exchange, autopilot))
    assert exchange.values == ({"COM_OBL_RC_ACT": 3} if same_key else {})
    assert bool(exchange.bad_signatures) is not same_key
    assert bool(autopilot.read_parameters) is same_key


def test_over_a_signed_link_replies_are_taken_also_after_minutes() -> None:
    """A receiver drops what was signed more than a minute from its own clock."""
    key = bytes(range(32))
    signing = Signing(key)
    autopilot = FakeAutopilot(signing=signing)
    autopilot.parameters = {"COM_OBL_RC_ACT": 3}
    exchange = ParameterExchange(1, key)
    begin_ns, minutes_ns = 7000 * 1_000_000_000, 150 * 1_000_000_000
    exchange.step(b"", begin_ns)
    exchange.read(["COM_OBL_RC_ACT"])
    signing.clock_10us = minutes_ns // 10_000
    sent = exchange.step(b"", begin_ns + minutes_ns)
    exchange.step(autopilot.handle(sent), begin_ns + minutes_ns + 10 * MS)
    assert exchange.values == {"COM_OBL_RC_ACT": 3}
