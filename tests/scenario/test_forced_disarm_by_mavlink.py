"""A forced disarm in the air over the port of ground stations: who was there before the takeoff may, others not."""

from collections.abc import Iterator

import pytest

from jezero.base.mavlink import MavlinkCodec, dialect
from jezero.runtime.memory_bus import UDP_DELAY
from jezero.runtime.service import Inbox, Output, Send, Spec
from jezero.services.autopilot.mavlink_receiver import FORCE_DISARM
from tests.scenario.rig import Flight

PRESENT, LATE, BRIDGE = 255, 252, 1
"""MAVLink systems: a station that is there from the start, one that comes in the air, and the bridge's own, claimed."""


class Stations:
    """Several senders at the port of ground stations.

    Attributes:
        disarming: the system that sends forced disarms; None while nobody does.
        results: result of each acknowledgement.
        texts: text of each STATUSTEXT.
    """

    spec = Spec(name="stations", links=("autopilot",), rate_hz=5.0)

    def __init__(self) -> None:
        self.disarming: int | None = None
        self.results: list[int] = []
        self.texts: list[str] = []
        self._reader = MavlinkCodec(255, 190)
        self._codecs = {system: MavlinkCodec(system, 190) for system in (PRESENT, LATE, BRIDGE)}

    def step(self, t_ns: int, inbox: Inbox) -> Iterator[Output]:
        for message in self._reader.parse(inbox.received("autopilot")):
            if message.get_msgId() == dialect.MAVLINK_MSG_ID_COMMAND_ACK:
                self.results.append(message.result)
            elif message.get_msgId() == dialect.MAVLINK_MSG_ID_STATUSTEXT:
                self.texts.append(message.text)
        yield Send("autopilot", self._codecs[PRESENT].pack(dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)))
        if self.disarming is not None:
            parameters = (0.0, FORCE_DISARM, *[0.0] * 5)
            command = dialect.MAVLink_command_long_message(1, 1, dialect.MAV_CMD_COMPONENT_ARM_DISARM, 0, *parameters)
            yield Send("autopilot", self._codecs[self.disarming].pack(command))


def test_only_a_station_that_was_there_before_the_takeoff_stops_the_motors_in_the_air(
    capfd: pytest.CaptureFixture[str],
) -> None:
    flight, stations = Flight(seed=3), Stations()
    flight.bus.wire(("autopilot", "gcs"), ("stations", "autopilot"), UDP_DELAY)
    flight.bus.add(stations)
    flight.take_off(3.0)
    for system in (LATE, BRIDGE):
        stations.disarming = system
        stations.results.clear()
        flight.wait(lambda: len(stations.results) >= 3, 5.0, "acknowledgements")
        assert set(stations.results) == {dialect.MAV_RESULT_DENIED}
        assert flight.status.armed and not flight.status.landed
        refusal = f"MAVLink system {system} sent nothing before the takeoff"
        assert f"Forced disarm denied: {refusal}" in "".join(stations.texts)
        line = f"a forced disarm in the air by component 190 of MAVLink system {system} on the link 'gcs' is denied: "
        assert capfd.readouterr().err.count(f"{line}{refusal}\n") == 1
    stations.disarming = PRESENT
    flight.wait(lambda: dialect.MAV_RESULT_ACCEPTED in stations.results, 5.0, "the disarm")
    flight.wait(lambda: not flight.status.armed, 5.0, "the motors are off")
    line = f"disarmed by force in the air by component 190 of MAVLink system {PRESENT} on the link 'gcs'\n"
    assert line in capfd.readouterr().err
