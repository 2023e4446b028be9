"""The autopilot's MAVLink links to the vehicle bridge and to ground stations.

Streams have PX4's messages, units and frames; rates can be set with SET_MESSAGE_INTERVAL.
"""

from jezero.mavlink import MavlinkCodec, MavMessage, Signing, dialect
from jezero.services.autopilot.streams import MAKERS, Snapshot

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


class TelemetryLink:
    """One link: its streams, and the messages on it that are meant for this autopilot."""

    def __init__(
        self, system_id: int, intervals_us: dict[int, int], interval_min_us: int, signing: Signing | None = None
    ) -> None:
        self._system_id = system_id
        self._codec = MavlinkCodec(system_id, dialect.MAV_COMP_ID_AUTOPILOT1, signing)
        self._interval_min_us = interval_min_us
        self._default_us = {message_id: max(interval_min_us, us) for message_id, us in intervals_us.items()}
        self._interval_us = dict(self._default_us)
        self._due_us = dict.fromkeys(intervals_us, 0)
        self._next_us = 0
        self._told: tuple[int, bool, bool] | None = None
        self._text_id = 0

    @property
    def malformed(self) -> int:
        """Stretches of bytes that were no message."""
        return self._codec.malformed

    @property
    def bad_signatures(self) -> int:
        """Messages whose signature was not believed."""
        return self._codec.bad_signatures

    def receive(self, data: bytes) -> list[MavMessage]:
        """Messages for this autopilot, or for everybody."""
        return [message for message in self._codec.parse(data) if self._is_for_us(message)]

    def _is_for_us(self, message: MavMessage) -> bool:
        """Not what claims to come from this autopilot itself."""
        if (message.get_srcSystem(), message.get_srcComponent()) == (self._system_id, dialect.MAV_COMP_ID_AUTOPILOT1):
            return False
        system, component = getattr(message, "target_system", 0), getattr(message, "target_component", 0)
        return system in {0, self._system_id} and component in {0, dialect.MAV_COMP_ID_AUTOPILOT1}

    def pack(self, *messages: MavMessage) -> bytes:
        """Bytes of messages, in order."""
        return b"".join(self._codec.pack(message) for message in messages)

    def set_interval(self, message_id: int, interval_us: float) -> bool:
        """Change a stream's rate: 0 is its default, -1 stops it; False when there is no such stream."""
        if message_id not in MAKERS:
            return False
        if interval_us < 0.0:
            self._interval_us.pop(message_id, None)
            return True
        default_us = self._default_us.get(message_id, 1_000_000)
        asked_us = default_us if interval_us == 0.0 else int(interval_us)
        self._interval_us[message_id] = max(self._interval_min_us, asked_us)
        self._due_us.setdefault(message_id, 0)
        self._next_us = 0
        return True

    def knows(self, message_id: int) -> bool:
        """Whether there is such a message to tell."""
        return message_id in MAKERS

    def request(self, message_id: int, now: Snapshot) -> bytes:
        """One message now; nothing when there is no such message, or it can't be told yet."""
        maker = MAKERS.get(message_id)
        message = None if maker is None else maker(now)
        return b"" if message is None else self._codec.pack(message)

    def is_due(self, t_us: int, state: tuple[int, bool, bool]) -> bool:
        """Whether `stream` has something to tell. `state` is the custom mode, armed, landed."""
        return state != self._told or t_us >= self._next_us

    def stream(self, now: Snapshot) -> bytes:
        """What is due, and at once what changed.

        Streams keep to multiples of their interval: those that are as frequent travel together.
        """
        state = (now.custom_mode, now.armed, now.landed)
        if state != self._told:
            self._told = state
            self._due_us[dialect.MAVLINK_MSG_ID_HEARTBEAT] = 0
            self._due_us[dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE] = 0
            self._due_us[dialect.MAVLINK_MSG_ID_HOME_POSITION] = 0
        data = b""
        for message_id, interval_us in self._interval_us.items():
            if now.t_us < self._due_us[message_id]:
                continue
            self._due_us[message_id] = (now.t_us // interval_us + 1) * interval_us
            message = MAKERS[message_id](now)
            if message is not None:
                data += self._codec.pack(message)
        self._next_us = min((self._due_us[message_id] for message_id in self._interval_us), default=now.t_us)
        return data

    def acknowledge(self, message: MavMessage, command: int, result: int) -> bytes:
        """COMMAND_ACK of a command to whoever sent the message."""
        sender = (message.get_srcSystem(), message.get_srcComponent())
        return self._codec.pack(dialect.MAVLink_command_ack_message(command, result, 0, 0, *sender))

    def text(self, severity: int, text: str) -> bytes:
        """STATUSTEXT, in several chunks when it is long."""
        raw = text.encode("ascii", "replace")
        chunks = [raw[i : i + STATUSTEXT_CHARACTERS] for i in range(0, len(raw), STATUSTEXT_CHARACTERS)]
        text_id = 0
        if len(chunks) > 1:
            self._text_id = text_id = self._text_id % 65_535 + 1
        return b"".join(
            self._codec.pack(dialect.MAVLink_statustext_message(severity, chunk, text_id, number))
            for number, chunk in enumerate(chunks)
        )
