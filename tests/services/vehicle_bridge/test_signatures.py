"""A signed link between bridge and flight controller: it flies, and what isn't signed with the key does nothing."""

from msgspec.structs import replace

from jezero.base.mavlink import MavlinkCodec, Signing, dialect
from jezero.base.vehicle_config import VehicleConfig
from jezero.runtime.service import Health
from jezero.schemas.commands import Phase
from jezero.schemas.state import StatusCode
from jezero.schemas.units import NS_PER_S
from jezero.services.vehicle_bridge.config import VehicleBridgeConfig
from jezero.services.vehicle_bridge.service import VehicleBridge
from tests.services.vehicle_bridge.rig import FakeAutopilot, Rig

KEY, OTHER = bytes(range(32)), bytes(32)
CONFIG = replace(VehicleBridgeConfig(), link="udpin:0.0.0.0:14540")


class SignedRig(Rig):
    """A rig whose autopilot signs with `key`, with the clock of the rig."""

    def __init__(self, key: bytes, controller_key: bytes) -> None:
        super().__init__(CONFIG, key=key)
        self.signing = Signing(controller_key)
        self.autopilot = FakeAutopilot(signing=self.signing)
        self._start_ns = self.box.wall_ns

    def step(self) -> None:
        self.signing.clock_10us = (self.box.wall_ns - self._start_ns) // 10_000
        super().step()


def health_of(rig: Rig) -> str:
    return [output.text for output in rig.outputs if isinstance(output, Health)][-1]


def test_with_the_same_key_the_vehicle_flies() -> None:
    rig = SignedRig(KEY, KEY)
    rig.ready()
    rig.go("takeoff", Phase.TAKEOFF)
    assert rig.status.code == StatusCode.TAKEOFF
    assert rig.autopilot.setpoints
    assert "signature" not in health_of(rig)


def test_a_signed_link_still_carries_messages_both_ways_after_two_minutes() -> None:
    """A receiver drops what was signed more than a minute from its own clock."""
    rig = SignedRig(KEY, KEY)
    rig.ready()
    for _ in range(4):
        rig.box.wall_ns += 30 * NS_PER_S
        rig.step()
    rig.ready()
    rig.go("takeoff", Phase.TAKEOFF)
    assert rig.status.code == StatusCode.TAKEOFF
    assert rig.autopilot.setpoints
    assert "signature" not in health_of(rig)


def test_a_signed_link_works_on_a_computer_that_has_run_for_days() -> None:
    rig = SignedRig(KEY, KEY)
    rig.box.wall_ns += 5 * 86_400 * NS_PER_S
    rig._start_ns = rig.box.wall_ns
    rig.ready()
    rig.go("takeoff", Phase.TAKEOFF)
    assert rig.status.code == StatusCode.TAKEOFF
    assert rig.autopilot.setpoints


def test_with_another_key_nothing_is_taken_and_the_status_says_what_to_do() -> None:
    rig = SignedRig(KEY, OTHER)
    rig.run(5.0)
    assert not rig.status.ready
    assert rig.status.odometry is None
    assert "had no valid signature: give it the key in JEZERO_MAVLINK_KEY_FILE" in rig.status.not_ready_reason


def test_a_controller_without_signatures_is_not_taken_on_a_signed_link() -> None:
    rig = Rig(CONFIG, key=KEY)
    rig.run(5.0)
    assert rig.status.odometry is None
    assert "had no valid signature" in rig.status.not_ready_reason


def test_with_a_key_the_simulated_autopilot_which_signs_nothing_is_not_taken_either() -> None:
    rig = Rig(key=KEY)
    rig.run(2.0)
    assert not rig.status.ready
    assert "had no valid signature" in rig.status.not_ready_reason


def test_a_forged_message_in_flight_changes_nothing_and_is_counted() -> None:
    rig = SignedRig(KEY, KEY)
    rig.ready()
    rig.go("takeoff", Phase.TAKEOFF)
    landed = dialect.MAVLink_heartbeat_message(2, 12, 1, 4 << 16 | 6 << 24, dialect.MAV_STATE_ACTIVE, 3)
    for signing in (None, Signing(OTHER)):
        rig.autopilot.unasked += MavlinkCodec(1, 1, signing).pack(landed)
    rig.run(0.2)
    assert rig.status.code == StatusCode.TAKEOFF
    assert rig.status.armed
    assert "2 messages without a valid signature were dropped" in health_of(rig)


def test_what_was_sent_before_the_bridge_started_is_not_taken() -> None:
    rig = Rig(CONFIG)
    rig.bridge = VehicleBridge(CONFIG, VehicleConfig(), 1, boot_id=1, secret="s", key=KEY, since_2015_s=100.0)
    signing = Signing(KEY)
    rig.autopilot = FakeAutopilot(signing=signing)
    signing.clock_10us = 9_900_000
    rig.run(0.1)
    assert not rig.odometry
    signing.clock_10us = 10_010_000
    rig.run(0.1)
    assert rig.odometry


def test_a_controller_that_signs_on_a_link_without_a_key_is_named() -> None:
    rig = SignedRig(b"", KEY)
    rig.run(2.0)
    assert rig.status.not_ready_reason == (
        "the flight controller signs its messages and takes no others: name its key with JEZERO_MAVLINK_KEY_FILE"
    )
    assert "; the autopilot signs its messages: name its key with JEZERO_MAVLINK_KEY_FILE" in health_of(rig)


def test_the_key_is_not_in_what_recordings_keep() -> None:
    assert KEY not in SignedRig(KEY, KEY).bridge.spec.made_with.values()
