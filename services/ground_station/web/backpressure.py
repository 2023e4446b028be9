"""Whether a page still reads what is sent to it."""

import time

from nicegui import Client

UNREAD_MAX = 400
"""Messages, about ten seconds of them. A page acknowledges what it has read every three seconds."""
TRICKLE_PERIOD_S = 2.0


class Backpressure:
    """Decides whether more is sent to one page: little to one that is asleep or stalled.

    Without this rule, what a page doesn't read is kept until its connection times out. The little that is sent brings
    an acknowledgement from a page that reads again, or whose last one was lost with a connection.
    """

    def __init__(self, client: Client) -> None:
        self._client = client
        self._trickled_s = 0.0

    def may_send(self) -> bool:
        """Whether to send the next values; one that is not sent is not sent later either."""
        if not self._client.has_socket_connection:
            return False
        if len(self._client.outbox.message_history) <= UNREAD_MAX:
            return True
        now_s = time.monotonic()
        if now_s - self._trickled_s < TRICKLE_PERIOD_S:
            return False
        self._trickled_s = now_s
        return True
