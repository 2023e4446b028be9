"""Output of the services: written to a log file each, and to a terminal with the service's name in front."""

import io
import time
from collections.abc import Iterable
from datetime import UTC, datetime
from typing import TextIO

from jezero.base.plain_text import plain
from jezero.deploy.launcher.state import RunFolder

COLOURS = (36, 33, 32, 35, 34, 96, 93, 92, 95, 94)
MAX_LINE_BYTES = 65536
QUOTED_MAX = 500
STAMP_LENGTH = len("2026-01-31T12:00:00.000Z")


def stamp(unix_s: float) -> str:
    """UTC time to the millisecond; sorts as text."""
    return datetime.fromtimestamp(unix_s, UTC).strftime("%Y-%m-%dT%H:%M:%S.%f")[:-3] + "Z"


class Prefixer:
    """Puts `name | ` before a line, with a colour for each name."""

    def __init__(self, names: Iterable[str], colour: bool) -> None:
        listed = list(names)
        width = max((len(name) for name in listed), default=0)
        self._prefixes = {}
        for index, name in enumerate(listed):
            plain = f"{name:<{width}} | "
            self._prefixes[name] = f"\x1b[{COLOURS[index % len(COLOURS)]}m{plain}\x1b[0m" if colour else plain

    def line(self, name: str, text: str) -> str:
        return f"{self._prefixes[name]}{text}"


class Output:
    """Splits the services' output into lines and writes them to log files and the terminal.

    A full disk or a terminal that can't show a character loses lines but never ends the launcher, because the services
    would die with it.

    Args:
        folder: folder of the run.
        names: names of the services.
        terminal: gets each line too; None when detached.
    """

    def __init__(self, folder: RunFolder, names: Iterable[str], terminal: TextIO | None) -> None:
        listed = list(names)
        self._files = {}
        for name in listed:
            path = folder.log_of(name)
            if path.exists():
                path.replace(path.with_suffix(".log.1"))
            self._files[name] = path.open("wb", buffering=0)
        self._lost = dict.fromkeys(listed, 0)
        self._unfinished = dict.fromkeys(listed, b"")
        self._last_lines = dict.fromkeys(listed, "")
        if isinstance(terminal, io.TextIOWrapper):
            terminal.reconfigure(errors="replace")
        self._terminal = terminal
        self._prefixer = Prefixer(listed, colour=terminal is not None and terminal.isatty())

    def on_data(self, name: str, data: bytes) -> None:
        """Process bytes that a service printed; an incomplete last line is kept until its end arrives."""
        *lines, rest = (self._unfinished[name] + data).split(b"\n")
        if len(rest) > MAX_LINE_BYTES:
            lines.append(rest)
            rest = b""
        self._unfinished[name] = rest
        for line in lines:
            self._write_printed(name, line)

    def on_exit(self, name: str) -> None:
        """Write the incomplete last line of a service whose process has ended."""
        rest = self._unfinished[name]
        self._unfinished[name] = b""
        if rest:
            self._write_printed(name, rest)

    def last_line(self, name: str) -> str:
        """The last line with text that a service printed, without its own name in front, at most `QUOTED_MAX` long."""
        return self._last_lines[name].removeprefix(f"{name}: ")[:QUOTED_MAX]

    def _write_printed(self, name: str, line: bytes) -> None:
        text = plain(line.decode("utf-8", "replace").rstrip("\r"))
        self._last_lines[name] = text.strip() or self._last_lines[name]
        self.write_line(name, text)

    def write_line(self, name: str, text: str) -> None:
        """Write one line to the service's log and to the terminal."""
        self._log(name, text)
        self.print_line(self._prefixer.line(name, text))

    def _log(self, name: str, text: str) -> None:
        at = stamp(time.time())
        notice = f"{at} [launcher] {self._lost[name]} lines before this one could not be written\n"
        try:
            self._files[name].write(f"{notice if self._lost[name] else ''}{at} {text}\n".encode())
        except OSError:
            self._lost[name] += 1
        else:
            self._lost[name] = 0

    def print_line(self, text: str) -> None:
        """Write one line to the terminal only."""
        if self._terminal is None:
            return
        try:
            print(text, file=self._terminal, flush=True)
        except OSError:  # the terminal is closed; the services must not die of it
            self._terminal = None

    def close(self) -> None:
        for file in self._files.values():
            file.close()


class LogReader:
    """Reads the log files of several services in order of time."""

    def __init__(self, folder: RunFolder, names: Iterable[str]) -> None:
        self._paths = {name: folder.log_of(name) for name in names}
        self._offsets = dict.fromkeys(self._paths, 0)

    def read(self) -> list[tuple[str, str]]:
        """(name, stamped line) of all lines since the last call, in order of time."""
        found: list[tuple[str, str]] = []
        for name, path in self._paths.items():
            with path.open("rb") as file:
                file.seek(self._offsets[name])
                data = file.read()
            end = data.rfind(b"\n") + 1
            self._offsets[name] += end
            found.extend((name, line) for line in data[:end].decode("utf-8", "replace").split("\n")[:-1])
        return sorted(found, key=lambda entry: entry[1][:STAMP_LENGTH])
