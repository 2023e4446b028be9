"""Text from the bus reaches nobody with control characters, whichever way it takes."""

import io
import json
import unicodedata
from collections.abc import Iterable
from pathlib import Path

import msgspec
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from jezero import Vehicle
from jezero.base.codec import decode, decode_request, encode
from jezero.base.plain_text import SHOWN, plain, plain_json
from jezero.cli.main import main
from jezero.deploy.launcher.output import Output
from jezero.deploy.launcher.state import RunFolder
from jezero.recording import open_recording
from jezero.recording.writer import RecordingWriter
from jezero.runtime.memory_bus import MemoryBus
from jezero.runtime.service import Inbox, Reply, Spec
from jezero.schemas import topics
from jezero.schemas.actions import ActionDescription
from jezero.schemas.commands import Abort, AbortReply
from jezero.schemas.health import ServiceHealth
from jezero.schemas.state import Status
from tests.client.rig import Server, a_status, endpoint, server, vehicle

__all__ = ["endpoint", "server", "vehicle"]

NASTY = "\x1b[31mred\x1b[0m\x07 \x9b2J\x7f\u202ereversed\nuav1 ready\r\ttab\u2028\x00"
PLAIN = f"{SHOWN}[31mred{SHOWN}[0m{SHOWN} {SHOWN}2J{SHOWN}{SHOWN}reversed uav1 ready  tab {SHOWN}"


class Bridge:
    """Replies to aborts with a nasty reason."""

    spec = Spec(name="bridge", serves=(topics.ABORT,), triggers=(topics.ABORT.name,))

    def __init__(self) -> None:
        self.reasons: list[str] = []

    def step(self, t_ns: int, inbox: Inbox) -> Iterable[Reply]:
        for request in inbox.requests(topics.ABORT):
            self.reasons.append(request.payload.reason)
            yield Reply(request.request_id, AbortReply(hovering=True, reason=NASTY))


def is_plain(text: str) -> bool:
    return not any(unicodedata.category(letter) in ("Cc", "Zl", "Zp") or letter == "\u202e" for letter in text)


def test_control_characters_are_shown_and_lines_are_joined() -> None:
    assert plain(NASTY) == PLAIN
    assert is_plain(PLAIN)
    assert plain("5 m/s² – 20 °C, “ok” 火星 🚁 \\x1b") == "5 m/s² – 20 °C, “ok” 火星 🚁 \\x1b"


@given(st.text() | st.text(st.sampled_from("\\u001b9n\"'\x1b\x9b\n\t\u2029\u202e\u2066é€")), st.booleans())
def test_a_message_is_decoded_as_its_plain_text_however_it_is_escaped(text: str, ascii_only: bool) -> None:
    data = json.dumps({"reason": text[:1000]}, ensure_ascii=ascii_only).encode("utf-8", "surrogatepass")
    try:
        expected = plain(json.loads(data)["reason"])
        expected.encode()
    except (UnicodeError, ValueError):
        return
    assert decode(Abort, data).reason == expected
    assert plain_json(plain_json(data)) == plain_json(data)


def test_names_and_nested_fields_are_plain_too() -> None:
    health = {"t_ns": 1, "service": "s", "boot_id": 1, "state": "ok", "text": "", "inputs": {"a\u001b": {}}}
    assert list(decode(ServiceHealth, msgspec.json.encode(health)).inputs) == [f"a{SHOWN}"]
    assert decode_request(Abort, b"", {"reason": NASTY}) == Abort(reason=PLAIN)
    assert decode_request(Abort, b"", {"reason": '"\\u001b"'}) == Abort(reason=SHOWN)


def test_the_description_of_an_action_keeps_its_lines() -> None:
    data = encode(topics.TAKEOFF.description)
    assert encode(decode(ActionDescription, data)) == data
    assert b"\\n" in data


def test_an_abort_s_reason_is_plain_for_the_bridge_and_for_its_client() -> None:
    bus, bridge = MemoryBus(), Bridge()
    bus.add(bridge)
    sent = bus.send_request(topics.ABORT, Abort(reason=NASTY))
    bus.run_for(1.0)
    assert bridge.reasons == [PLAIN]
    assert sent.replies[0].reason == PLAIN


def test_jezero_status_prints_no_control_character(server: Server, vehicle: Vehicle, endpoint: str) -> None:
    server.serve("status", msgspec.structs.replace(a_status(), text=NASTY, autopilot_mode=NASTY, goal_id=NASTY))
    for words in (["status"], ["status", "--json"]):
        done = CliRunner().invoke(main, [*words, "--vehicle", "v", "--router", endpoint])
        assert done.exit_code == 0, done.output
        assert "[31mred" in done.output
        assert all(is_plain(line) for line in done.output.splitlines())


def test_what_services_print_is_plain_in_the_terminal_and_in_the_log(tmp_path: Path) -> None:
    folder, terminal = RunFolder(tmp_path), io.StringIO()
    folder.logs.mkdir()
    output = Output(folder, ["bridge"], terminal)
    output.on_data("bridge", f"{NASTY}\n".encode())
    output.close()
    for text in (terminal.getvalue(), folder.log_of("bridge").read_text()):
        assert f"{SHOWN}[31mred" in text
        assert all(is_plain(line) for line in text.splitlines())


def test_a_recording_is_read_without_control_characters(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    with RecordingWriter(path, {}) as writer:
        writer.write(1, topics.STATUS.name, encode(msgspec.structs.replace(a_status(), text=NASTY)))
    (entry,) = open_recording(path).messages(topics.STATUS)
    assert isinstance(entry.message, Status)
    assert entry.message.text == PLAIN
