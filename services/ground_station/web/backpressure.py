"""Whether a page still reads what is sent to it."""

from nicegui import Client

UNREAD_MAX = 400
"""Messages, about ten seconds of them. A page acknowledges what it has read every three seconds."""


def keeps_up(client: Client) -> bool:
    """Whether more should be sent: not to a page that is asleep or stalled, or whose connection is lost.

    Without this rule, what a page doesn't read is kept until its connection times out.
    """
    return client.has_socket_connection and len(client.outbox.message_history) <= UNREAD_MAX
