"""What the services print: into a log file each, and with the service's name in front on a terminal."""

import io
import time
from collections.abc import Iterable
from datetime import UTC, datetime
from typing import TextIO

from jezero.deploy.launcher.state import RunFolder

COLOURS = (36, 33, 32, 35, 34, 96, 93, 92, 95, 94)
MAX_LINE_BYTES = 65536
STAMP_LENGTH = len("2026-01-31T12:00:00.000Z")


def stamp(unix_s: float) -> str:
    """UTC to the millisecond; sorts as text."""
    return datetime.fromtimestamp(unix_s, UTC).strftime("%Y-%m-%dT%H:%M:%S.%f")[:-3] + "Z"


class Prefixer:
    """Puts `name | ` before a line, in a colour of its own for each name."""

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
    """Splits what services print into lines and writes each where it belongs.

    A full disk or a terminal that can't show a character costs lines, never the launcher: the services would die with
    it.

    Args:
        terminal: also gets each line; None when nobody looks.
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
        if isinstance(terminal, io.TextIOWrapper):
            terminal.reconfigure(errors="replace")
        self._terminal = terminal
        self._prefixer = Prefixer(listed, colour=terminal is not None and terminal.isatty())

    def feed(self, name: str, data: bytes) -> None:
        """Bytes that a service printed; a last line without an end waits for it."""
        *lines, rest = (self._unfinished[name] + data).split(b"\n")
        if len(rest) > MAX_LINE_BYTES:
            lines.append(rest)
            rest = b""
        self._unfinished[name] = rest
        for line in lines:
            self.say(name, line.decode("utf-8", "replace").rstrip("\r"))

    def finish(self, name: str) -> None:
        """Its process has ended: what it printed last is a line now."""
        rest = self._unfinished[name]
        self._unfinished[name] = b""
        if rest:
            self.say(name, rest.decode("utf-8", "replace"))

    def say(self, name: str, text: str) -> None:
        """One line."""
        self._log(name, text)
        self.show(self._prefixer.line(name, text))

    def _log(self, name: str, text: str) -> None:
        at = stamp(time.time())
        told = f"{at} [launcher] {self._lost[name]} lines before this one could not be written\n"
        try:
            self._files[name].write(f"{told if self._lost[name] else ''}{at} {text}\n".encode())
        except OSError:
            self._lost[name] += 1
        else:
            self._lost[name] = 0

    def show(self, text: str) -> None:
        """One line for the terminal only."""
        if self._terminal is None:
            return
        try:
            print(text, file=self._terminal, flush=True)
        except OSError:  # the terminal is gone; the services are not to die of it
            self._terminal = None

    def close(self) -> None:
        for file in self._files.values():
            file.close()


class LogReader:
    """Reads the log files of several services as one."""

    def __init__(self, folder: RunFolder, names: Iterable[str]) -> None:
        self._paths = {name: folder.log_of(name) for name in names}
        self._offsets = dict.fromkeys(self._paths, 0)

    def read(self) -> list[tuple[str, str]]:
        """Name and stamped line of what was written since the last call, in order of time."""
        found: list[tuple[str, str]] = []
        for name, path in self._paths.items():
            with path.open("rb") as file:
                file.seek(self._offsets[name])
                data = file.read()
            end = data.rfind(b"\n") + 1
            self._offsets[name] += end
            found.extend((name, line) for line in data[:end].decode("utf-8", "replace").split("\n")[:-1])
        return sorted(found, key=lambda entry: entry[1][:STAMP_LENGTH])
