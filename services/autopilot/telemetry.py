"""MAVLink links of the autopilot to the vehicle bridge and to ground stations.

The streams have the messages, units and frames of PX4. SET_MESSAGE_INTERVAL sets their rates.
"""

from collections import Counter
from collections.abc import Iterable

from jezero.base.frames import Vec3
from jezero.base.mavlink import MavlinkCodec, MavMessage, Signing, dialect
from jezero.services.autopilot.streams import STREAMS, Snapshot

OFFBOARD, GCS = "offboard", "gcs"
"""Names of the links."""
STATUSTEXT_CHARACTERS = 50

OFFBOARD_INTERVALS_US = {
    dialect.MAVLINK_MSG_ID_HEARTBEAT: 1_000_000,
    dialect.MAVLINK_MSG_ID_ODOMETRY: 20_000,
    dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 100_000,
    dialect.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: 100_000,
    dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 200_000,
    dialect.MAVLINK_MSG_ID_SYS_STATUS: 500_000,
    dialect.MAVLINK_MSG_ID_BATTERY_STATUS: 2_000_000,
    dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: 1_000_000,
    dialect.MAVLINK_MSG_ID_HOME_POSITION: 1_000_000,
}
GCS_INTERVALS_US = {
    dialect.MAVLINK_MSG_ID_HEARTBEAT: 1_000_000,
    dialect.MAVLINK_MSG_ID_ATTITUDE: 100_000,
    dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 100_000,
    dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 200_000,
    dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 200_000,
    dialect.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: 500_000,
    dialect.MAVLINK_MSG_ID_VFR_HUD: 250_000,
    dialect.MAVLINK_MSG_ID_ALTITUDE: 1_000_000,
    dialect.MAVLINK_MSG_ID_GPS_RAW_INT: 500_000,
    dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 500_000,
    dialect.MAVLINK_MSG_ID_SYS_STATUS: 500_000,
    dialect.MAVLINK_MSG_ID_BATTERY_STATUS: 1_000_000,
    dialect.MAVLINK_MSG_ID_HOME_POSITION: 1_000_000,
}


class Senders:
    """The MAVLink systems whose messages are taken.

    Args:
        system_ids: their ids.

    Attributes:
        refused: number of messages to this vehicle by the id of the system that sent them without being one of these.
    """

    def __init__(self, system_ids: Iterable[int]) -> None:
        self.refused: Counter[int] = Counter()
        self._system_ids = frozenset(system_ids)

    def take(self, message: MavMessage) -> bool:
        """Whether a message is taken; one that is refused is counted."""
        sender = message.get_srcSystem()
        if sender in self._system_ids:
            return True
        if hasattr(message, "target_system"):  # the heartbeat of another vehicle asks for nothing
            self.refused[sender] += 1
        return False


class TelemetryLink:
    """One link: sends its streams, and receives the messages that are addressed to this autopilot.

    Args:
        name: name of the link.
        system_id: MAVLink system id of this autopilot.
        senders: who may send; all links have them in common.
        intervals_us: default interval of each stream, by the id of its message.
        interval_min_us: minimum interval of a stream.
        signing: signing of the link, if it requires signatures.
    """

    def __init__(
        self,
        name: str,
        system_id: int,
        senders: Senders,
        intervals_us: dict[int, int],
        interval_min_us: int,
        signing: Signing | None = None,
    ) -> None:
        self.name = name
        self._system_id = system_id
        self._senders = senders
        self._codec = MavlinkCodec(system_id, dialect.MAV_COMP_ID_AUTOPILOT1, signing)
        self._interval_min_us = interval_min_us
        self._default_us = {message_id: max(interval_min_us, us) for message_id, us in intervals_us.items()}
        self._interval_us = dict(self._default_us)
        self._due_us = dict.fromkeys(intervals_us, 0)
        self._next_us = 0
        self._last_state: tuple[int, bool, bool] | None = None
        self._sent_origin_deg: Vec3 | None = None
        self._text_id = 0

    @property
    def malformed(self) -> int:
        """Number of malformed messages."""
        return self._codec.malformed

    @property
    def bad_signatures(self) -> int:
        """Number of messages without an accepted signature."""
        return self._codec.bad_signatures

    def receive(self, data: bytes) -> list[MavMessage]:
        """Parse bytes; returns the messages of the senders to this autopilot or to all systems."""
        return [message for message in self._codec.parse(data) if self._is_for_us(message)]

    def _is_for_us(self, message: MavMessage) -> bool:
        """Whether the message is of a sender, has this autopilot as a target, and is not from its own id."""
        if (message.get_srcSystem(), message.get_srcComponent()) == (self._system_id, dialect.MAV_COMP_ID_AUTOPILOT1):
            return False
        system, component = getattr(message, "target_system", 0), getattr(message, "target_component", 0)
        is_meant = system in {0, self._system_id} and component in {0, dialect.MAV_COMP_ID_AUTOPILOT1}
        return is_meant and self._senders.take(message)

    def pack(self, *messages: MavMessage) -> bytes:
        """Pack messages in order."""
        return b"".join(self._codec.pack(message) for message in messages)

    def set_interval(self, message_id: int, interval_us: float) -> bool:
        """Set the interval of a stream, 0 for its default, -1 to stop it; returns False if there is no such stream."""
        if message_id not in STREAMS:
            return False
        if interval_us < 0.0:
            self._interval_us.pop(message_id, None)
            return True
        default_us = self._default_us.get(message_id, 1_000_000)
        requested_us = default_us if interval_us == 0.0 else int(interval_us)
        self._interval_us[message_id] = max(self._interval_min_us, requested_us)
        self._due_us.setdefault(message_id, 0)
        self._next_us = 0
        return True

    def build_message(self, message_id: int, now: Snapshot) -> bytes:
        """Pack one message; returns no bytes if there is no such message, or no data for it yet."""
        build = STREAMS.get(message_id)
        message = None if build is None else build(now)
        return b"" if message is None else self._codec.pack(message)

    def is_due(self, t_us: int, state: tuple[int, bool, bool]) -> bool:
        """Whether `streams` has messages to send. `state` is (custom mode, armed, landed)."""
        return state != self._last_state or t_us >= self._next_us

    def streams(self, now: Snapshot) -> bytes:
        """Pack the streams that are due. A change of the state is sent at once.

        Streams are sent at multiples of their interval, so that those of equal rate share a packet. The origin is sent
        only when it has changed, as PX4 does: who connects later has to request it.
        """
        state = (now.custom_mode, now.armed, now.landed)
        if state != self._last_state:
            self._last_state = state
            self._due_us[dialect.MAVLINK_MSG_ID_HEARTBEAT] = 0
            self._due_us[dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE] = 0
            self._due_us[dialect.MAVLINK_MSG_ID_HOME_POSITION] = 0
        data = b""
        for message_id, interval_us in self._interval_us.items():
            if now.t_us < self._due_us[message_id]:
                continue
            self._due_us[message_id] = (now.t_us // interval_us + 1) * interval_us
            if message_id == dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN:
                if now.origin_deg == self._sent_origin_deg:
                    continue
                self._sent_origin_deg = now.origin_deg
            message = STREAMS[message_id](now)
            if message is not None:
                data += self._codec.pack(message)
        self._next_us = min((self._due_us[message_id] for message_id in self._interval_us), default=now.t_us)
        return data

    def acknowledge(self, message: MavMessage, command: int, result: int) -> bytes:
        """Pack the COMMAND_ACK of a command to the sender of the message."""
        sender = (message.get_srcSystem(), message.get_srcComponent())
        return self._codec.pack(dialect.MAVLink_command_ack_message(command, result, 0, 0, *sender))

    def status_text(self, severity: int, text: str) -> bytes:
        """Pack a STATUSTEXT, in several chunks if it is long."""
        raw = text.encode("ascii", "replace")
        chunks = [raw[i : i + STATUSTEXT_CHARACTERS] for i in range(0, len(raw), STATUSTEXT_CHARACTERS)]
        text_id = 0
        if len(chunks) > 1:
            self._text_id = text_id = self._text_id % 65_535 + 1
        return b"".join(
            self._codec.pack(dialect.MAVLink_statustext_message(severity, chunk, text_id, number))
            for number, chunk in enumerate(chunks)
        )
