"""Text without control characters: what others send must not steer the terminal of whoever reads it.

Every message from the bus loses them before it is decoded, so that they reach no terminal, log, page or report. What
services print loses them too. A line feed or a tab becomes a space, as a text from the bus is one line. All others
become `SHOWN`: also DEL, the second set of control codes (C1), and the marks that change the direction of the text.
"""

import re

SHOWN = "\N{REPLACEMENT CHARACTER}"
_SPACES = re.compile("[\t\n\r\u2028\u2029]")
_CONTROLS = re.compile("[\x00-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")
_IN_JSON = re.compile(
    rb"\\(?P<lf>n|u000[aA])"
    rb"|(?P<space>\\(?:[rt]|u000[9dD]|u202[89])|\xe2\x80[\xa8\xa9])"
    rb"|(?P<control>\\(?:[bf]|u00[01][0-9a-fA-F]|u007[fF]|u00[89][0-9a-fA-F]|u202[a-eA-E]|u206[6-9])"
    rb"|\x7f|\xc2[\x80-\x9f]|\xe2\x80[\xaa-\xae]|\xe2\x81[\xa6-\xa9])"
    rb"|\\.",  # any other escape, so that the second half of an escaped backslash begins none
    re.DOTALL,
)


def plain(text: str) -> str:
    """A text in one line without control characters."""
    return _CONTROLS.sub(SHOWN, _SPACES.sub(" ", text))


def plain_json(data: bytes, *, lines: bool = False) -> bytes:
    """JSON whose texts have no control characters, neither escaped nor as they are.

    Args:
        lines: whether its texts may have line feeds.
    """
    if data.isascii() and b"\\" not in data and b"\x7f" not in data:  # as most messages are; the pattern is slow
        return data
    return _IN_JSON.sub(_with_lines if lines else _in_one_line, data)


def _in_one_line(match: re.Match[bytes]) -> bytes:
    found = match.lastgroup
    return match[0] if found is None else SHOWN.encode() if found == "control" else b" "


def _with_lines(match: re.Match[bytes]) -> bytes:
    return match[0] if match.lastgroup == "lf" else _in_one_line(match)
