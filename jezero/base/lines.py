"""Lines of text out of the bytes of a link, however they are cut."""

LINE_MAX_BYTES = 4096
"""Longer lines are dropped."""


class Lines:
    """Splits bytes into lines.

    Attributes:
        rest: beginning of a line; one byte above the limit at most, so that a line that is too long stays too long.
        too_long: number of lines so far that were dropped.
    """

    def __init__(self) -> None:
        self.rest = b""
        self.too_long = 0

    def receive(self, data: bytes) -> list[bytes]:
        """Lines that are complete with these bytes, oldest first, without their ends and the spaces around them."""
        if not data:
            return []
        *complete, rest = (self.rest + data).split(b"\n")
        self.rest = rest[: LINE_MAX_BYTES + 1]
        good = [line.strip() for line in complete if len(line) <= LINE_MAX_BYTES]
        self.too_long += len(complete) - len(good)
        return good
