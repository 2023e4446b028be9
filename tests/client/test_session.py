"""What a connection takes for vehicle time."""

import pytest

from jezero.client.session import Connection
from tests.client.rig import free_endpoint, open_router

SECOND_NS = 10**9


def test_a_message_that_waited_for_its_reader_does_not_turn_vehicle_time_back(monkeypatch: pytest.MonkeyPatch) -> None:
    endpoint, now_s = free_endpoint(), [100.0]
    with open_router(endpoint):
        connection = Connection("uav1", endpoint, 3.0)
        monkeypatch.setattr("jezero.client.session.time.monotonic", lambda: now_s[0])
        connection.set_vehicle_time(5 * SECOND_NS)
        now_s[0] += 60.0
        connection.set_vehicle_time(6 * SECOND_NS, may_have_waited=True)
        assert connection.vehicle_time_ns() is None
        connection.set_vehicle_time(65 * SECOND_NS, may_have_waited=True)
        assert connection.vehicle_time_ns() == 65 * SECOND_NS
        connection.set_vehicle_time(1 * SECOND_NS)  # a reply of a vehicle that was restarted
        assert connection.vehicle_time_ns() == 1 * SECOND_NS
        monkeypatch.undo()
        connection.close()
