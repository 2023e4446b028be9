"""Every command and Python program of README and docs, run page by page as a reader would run them.

The pages about a real vehicle are read with the twin in its place.
"""

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import click
import pytest

from jezero.calibration.board import Board
from jezero.calibration.intrinsics import CameraIntrinsics
from jezero.cli.main import main as jezero_command
from jezero.schemas.state import StatusCode
from tests.calibration.views import SIZE_PX, photographed, poses
from tests.system.conftest import Stack, new_stack, wait_for

ROOT = Path(__file__).parents[2]
FIRST = ("README.md", "docs/getting-started.md")
SHELL = ("", "sh", "console")
DOCUMENTED_VEHICLE, DOCUMENTED_ROUTER = "uav1", "tcp/127.0.0.1:7447"
TWIN_PAGES = (
    "docs/how-to/your-drone.md",
    "docs/how-to/use-a-real-rover.md",
    "docs/how-to/use-a-uwb-module.md",
    "docs/how-to/connect-a-camera.md",
)
"""Pages about a real vehicle."""
TWIN, TWIN_SETTINGS = "jezero twin", Path("runs/twin/config")
DEVICES = {"serial:/dev/ttyACM0:921600": "flight controller"}
"""Documented addresses of devices, and the names by which the twin prints its own."""
DOWN = "while the stack is down"
DIFFERS = "jezero px4 parameters check"
"""Ends with exit code 3 on the twin, whose controller doesn't know all of PX4's parameters."""
ANSWERS = "y\n" * 20
CAMCHAIN = """
cam0:
  camera_model: pinhole
  intrinsics: [381.4, 381.4, 319.5, 239.5]
  distortion_model: radtan
  distortion_coeffs: [0.0, 0.0, 0.0, 0.0]
  resolution: [640, 480]
"""
REASONS = {
    "asks questions",
    "downloads or installs",
    "example of a command's help",
    "needs Docker",
    "needs PX4",
    "needs ROS 2",
    "needs a file of your own",
    "needs a flight that ended early",
    "needs an installed package",
    "needs your hand",
    "needs another computer",
    "needs systemd",
    "part of a longer program",
    "starts a second stack",
    "takes minutes",
}
"""The only reasons for which a block is not run; `<!-- not run: REASON -->` stands before it in the page."""
INTERRUPTED = "until Ctrl+C"
TAKE_OFF = ("takeoff", "mission run")
"""Words of the pages that begin on the ground."""
CONNECTED = 'from jezero import Vehicle\nuav = Vehicle.connect("uav1")\n'
"""Stands before a Python block that uses a connected `uav`."""
BLOCK_TIMEOUT_S = 900.0
READY_TIMEOUT_S, TWIN_READY_TIMEOUT_S = 60.0, 240.0
INTERRUPT_TIMEOUT_S = 15.0


class Block(NamedTuple):
    """A block of a page.

    Attributes:
        page: path of the page from the repository's root.
        line: line of the first command.
        language: word behind the opening fence.
        text: content without indentation.
        reason: why it is not run, or "".
    """

    page: str
    line: int
    language: str
    text: str
    reason: str

    @property
    def commands(self) -> list[str]:
        """The commands of a shell block, continued lines joined, without prompts."""
        lines = self.text.replace("\\\n", " ").splitlines()
        return [line.removeprefix("$ ") for line in lines if line.strip() and not line.lstrip().startswith("#")]

    @property
    def is_shell(self) -> bool:
        """Whether it holds commands."""
        return self.language in SHELL


def pages() -> list[str]:
    """README and docs: those for a new user first, then those that start a stack, then those that use a running one."""
    found = [*sorted(str(path.relative_to(ROOT)) for path in ROOT.glob("docs/**/*.md")), "CONTRIBUTING.md"]
    others = [page for page in found if page not in (*FIRST, *TWIN_PAGES)]
    return [*FIRST, *sorted(others, key=lambda page: not starts_stack(blocks_of(page))), *TWIN_PAGES]


def blocks_of(page: str) -> list[Block]:
    """The fenced blocks of a page that are shell or Python."""
    found: list[Block] = []
    reason, start, language, lines = "", 0, "", list[str]()
    for number, line in enumerate((ROOT / page).read_text(encoding="utf-8").splitlines(), start=1):
        words = line.strip()
        if start:
            if words == "```":
                found.append(Block(page, start, language, "\n".join(lines), reason))
                start, reason, lines = 0, "", []
            else:
                lines.append(line)
        elif words.startswith("```"):
            start, language = number + 1, words.removeprefix("```").strip()
        elif marker := re.fullmatch(r"<!-- not run: (.+) -->", words):
            reason = marker[1]
        elif words:
            reason = ""
    return [block for block in found if block.is_shell or block.language == "python"]


def is_up(command: str) -> bool:
    """Whether a command starts a stack in the foreground."""
    return re.search(r"\bjezero up( --profile \w+)* *(#|$)", command) is not None


def starts_stack(blocks: list[Block]) -> bool:
    """Whether the page itself starts the stack that its commands use."""
    commands = [command for block in blocks if block.is_shell and not block.reason for command in block.commands]
    return any(is_up(command) or re.search(r"\bjezero up( --profile \w+)* -d\b", command) for command in commands)


def jezero_calls(block: Block) -> list[list[str]]:
    """Arguments of each call of `jezero` in a shell block."""
    calls = []
    for command in block.commands:
        words = shlex.split(command, comments=True)
        while words and re.match(r"[A-Z_]+=", words[0]):
            words.pop(0)
        if words and words[0] in ("jezero", ".venv/bin/jezero"):
            ends = [index for index, word in enumerate(words) if word in ("|", ">", "&&")]
            calls.append(words[1 : ends[0] if ends else None])
    return calls


class Reader:
    """A reader at a terminal, in a folder that looks like a clone; one stack and one environment at a time."""

    def __init__(self, folder: Path, stack: Stack) -> None:
        self._stack = stack
        self._clone = folder / "jezero"
        self._clone.mkdir()
        for entry in ROOT.iterdir():
            if entry.name not in (".git", ".venv", "runs", "site"):
                (self._clone / entry.name).symlink_to(entry)
        (self._clone / ".venv").symlink_to(sys.prefix)
        self._environment: dict[str, str] = {}
        self._up: subprocess.Popen[bytes] | None = None
        self._up_detached = False
        self._twin: subprocess.Popen[bytes] | None = None
        self._devices: dict[str, str] = {}
        """Addresses of the twin's devices, by the documented ones."""

    def read(self, page: str, blocks: list[Block]) -> None:
        """Run the blocks of a page, in a new terminal."""
        self._environment = dict(self._stack.environment)
        shutil.rmtree(Path(self._environment["XDG_CONFIG_HOME"]) / "jezero" / "team", ignore_errors=True)
        if page in TWIN_PAGES:
            self._prepare_twin(starts_itself=starts_stack(blocks))
        elif starts_stack(blocks):
            self.close()
        elif not self._up_detached:
            self._stack.up()
            self._up_detached = True
        if page not in TWIN_PAGES and not starts_stack(blocks):
            self._hover(takes_off=any(words in block.text for block in blocks for words in TAKE_OFF))
        try:
            for block in blocks:
                self._run(block)
        except BaseException:
            self.close()  # the next page begins anew
            raise
        finally:
            self._interrupt_up()

    def _prepare_twin(self, *, starts_itself: bool) -> None:
        """Stop what runs, start the twin unless it runs, and a stack that flies it unless the page does."""
        self._stop_stacks()
        if self._twin is None:
            self._start_twin()
        self._environment["JEZERO_CONFIG_DIR"] = str(self._clone / TWIN_SETTINGS)
        del self._environment["JEZERO_GROUND"]  # else the profile of the ground station, which a page starts, is empty
        self._write_pictures()
        if not starts_itself:
            up = ["jezero", "up", "-d", "--wait", "--profile", "onboard", "--profile", "rover"]
            self._shell([shlex.join([*up, "--timeout", str(TWIN_READY_TIMEOUT_S)])], "the stack that flies the twin")

    def _start_twin(self) -> None:
        output = self._clone.parent / "twin"
        with output.open("w") as file:
            self._twin = subprocess.Popen(
                TWIN.split(), cwd=self._clone, env=self._stack.environment, stdin=subprocess.DEVNULL, stdout=file,
                stderr=subprocess.STDOUT,
            )  # fmt: skip
        wait_for(lambda: "fly it with" in output.read_text(), TWIN_READY_TIMEOUT_S, TWIN)
        for line in output.read_text().splitlines():
            self._devices |= {known: line.split()[-1] for known, name in DEVICES.items() if line.startswith(name)}
        assert self._devices.keys() == DEVICES.keys()

    def _write_pictures(self) -> None:
        """What needs a hand: pictures of the calibration board, and the result of a program that took some."""
        import cv2

        folder, board = self._clone / "runs" / "calibration", Board()
        camera = CameraIntrinsics(SIZE_PX, (420.0, 420.0), (319.5, 239.5), "plumb_bob", (0.0,) * 5)
        folder.mkdir(parents=True, exist_ok=True)
        for number, (turn, place_m) in enumerate(poses(12, board, camera)):
            cv2.imwrite(str(folder / f"{number}.png"), photographed(board, turn, place_m, camera, seed=number))
        (self._clone / "camchain.yaml").write_text(CAMCHAIN)

    @property
    def _answers(self) -> str:
        """What the reader types, where a command asks."""
        return "" if self._twin is None else ANSWERS

    def close(self) -> None:
        """Stop the stack, those that a page has left, and the twin."""
        self._stop_stacks()
        if self._twin is not None:
            twin, self._twin = self._twin, None
            _interrupt(twin, TWIN, timeout_s=READY_TIMEOUT_S)

    def _stop_stacks(self) -> None:
        self._interrupt_up()
        self._stack.jezero("down", check=False)
        for run_dir in (self._clone / "runs").glob("*/"):
            self._stack.jezero("down", "--run-dir", str(run_dir), check=False)
        self._up_detached = False

    def _hover(self, takes_off: bool) -> None:
        """Bring the vehicle where the pages expect it: in a hover, or ready for the takeoff of the page."""
        with self._stack.connect() as vehicle:
            vehicle.wait_ready()
            flies = vehicle.status().code == StatusCode.HOVER
            if takes_off and flies:
                spot = vehicle.status().odometry
                assert spot is not None
                vehicle.land_on_spot((*spot.pos_uav_ned_m[:2], 0.0), use_uwb=False, use_tag=False).result(timeout_s=60)
            elif not takes_off and not flies:
                vehicle.takeoff(altitude_m=2.0).result(timeout_s=60)

    def _run(self, block: Block) -> None:
        where = f"{block.page}:{block.line}"
        if not block.is_shell:
            program = block.text if "import" in block.text else CONNECTED + block.text
            self._execute([sys.executable, "-W", "error", "-c", self._here(program)], where, program)
            return
        batch: list[str] = []
        for command in map(self._here, block.commands):
            if re.search(rf"\b{TWIN}\b", command):
                assert self._twin is not None
                continue  # it runs already, for all pages
            if DOWN in command:
                self._interrupt_up()
            if is_up(command) or INTERRUPTED in command:
                self._shell(batch, where)
                batch = []
                self._foreground(command, where)
            else:
                batch.append(f"{command.partition('#')[0]} || test $? = 3" if DIFFERS in command else command)
        self._shell(batch, where)

    def _here(self, text: str) -> str:
        """The text, with this stack's name and address for the documented ones."""
        instance = self._stack.instance
        for documented, device in self._devices.items():
            text = text.replace(documented, device)
        text = text.replace(DOCUMENTED_ROUTER, instance.router)
        connected = f'Vehicle.connect("{instance.vehicle}", router="{instance.router}")'
        text = text.replace(f'Vehicle.connect("{DOCUMENTED_VEHICLE}")', connected)
        return re.sub(rf"\b{DOCUMENTED_VEHICLE}\b", instance.vehicle, text)

    def _shell(self, commands: list[str], where: str) -> None:
        """Run commands; what they export is in the environment of the later ones."""
        if not commands:
            return
        kept = self._clone.parent / "environment"
        script = "\n".join(["set -e", *commands, f"env -0 > {shlex.quote(str(kept))}"])
        self._execute(["bash", "-x", "-c", script], where, "\n".join(commands))
        pairs = (entry.partition("=") for entry in kept.read_text().split("\0") if entry)
        self._environment = {name: value for name, _, value in pairs}

    def _execute(self, words: list[str], where: str, shown: str) -> None:
        try:
            done = subprocess.run(
                words, cwd=self._clone, env=self._environment, input=self._answers, stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT, text=True, timeout=BLOCK_TIMEOUT_S, check=False,
            )  # fmt: skip
        except subprocess.TimeoutExpired as error:
            raise AssertionError(f"{where}: not over after {BLOCK_TIMEOUT_S} s:\n{shown}\n{error.stdout!r}") from error
        assert done.returncode == 0, f"{where}: exit {done.returncode}:\n{shown}\n\n{done.stdout}"

    def _foreground(self, command: str, where: str) -> None:
        """Start a command that runs until Ctrl+C: `jezero up` runs on, the others are interrupted after one line."""
        output = self._clone.parent / "output"
        with output.open("w") as file:  # a pipe would stop a process whose output nobody reads
            process = subprocess.Popen(
                ["bash", "-c", f"exec env {command}"], cwd=self._clone,
                stdin=subprocess.DEVNULL, stdout=file, stderr=subprocess.STDOUT,
                env={**self._environment, "PYTHONUNBUFFERED": "1"},
            )  # fmt: skip
        if is_up(command):
            self._interrupt_up()
            self._up = process
        expected = re.compile(r"^ready" if is_up(command) else r".", re.MULTILINE)
        timeout_s = READY_TIMEOUT_S if self._twin is None else TWIN_READY_TIMEOUT_S
        wait_for(lambda: expected.search(output.read_text()) or process.poll() is not None, timeout_s, command)
        assert process.poll() is None, f"{where}: ended by itself: {command}\n{output.read_text()}"
        if process is not self._up:
            _interrupt(process, f"{where}: {command}")

    def _interrupt_up(self) -> None:
        if self._up is not None:
            up, self._up = self._up, None
            _interrupt(up, "jezero up")


def _interrupt(process: subprocess.Popen[bytes], shown: str, timeout_s: float = INTERRUPT_TIMEOUT_S) -> None:
    process.send_signal(signal.SIGINT)
    try:
        code = process.wait(timeout_s)
    except subprocess.TimeoutExpired:
        process.kill()
        raise AssertionError(f"{shown}: runs on after Ctrl+C") from None
    assert code == 0, f"{shown}: exit {code} after Ctrl+C"


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Reader]:
    """One reader for all pages."""
    folder = tmp_path_factory.mktemp("reader")
    with new_stack(folder, whole=True) as stack:
        stack.environment["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        stack.environment["PYTHONPATH"] = str(ROOT)
        stack.environment["XDG_CONFIG_HOME"] = str(folder / "config")  # for the keys of a team
        reader = Reader(folder, stack)
        yield reader
        reader.close()


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("page", [page for page in pages() if any(not block.reason for block in blocks_of(page))])
def test_the_commands_of_a_page_work_as_written(page: str, reader: Reader) -> None:
    reader.read(page, [block for block in blocks_of(page) if not block.reason])


def test_a_block_that_is_not_run_gives_one_of_a_few_reasons() -> None:
    marked = [block for page in pages() for block in blocks_of(page) if block.reason]
    assert {block.reason for block in marked} <= REASONS, [(b.page, b.line, b.reason) for b in marked]


def test_commands_that_are_not_run_exist_and_take_these_words() -> None:
    for block in (block for page in pages() for block in blocks_of(page) if block.is_shell):
        for words in jezero_calls(block):
            group: click.Command = jezero_command
            context, left, name = click.Context(jezero_command), words, None
            try:
                while isinstance(group, click.Group) and left:
                    name, command, left = group.resolve_command(context, left)
                    assert command is not None
                    group = command
                if not re.search(r"[<*]", " ".join(left)):
                    group.make_context(name, list(left), resilient_parsing=False)
            except click.exceptions.Exit:
                continue  # --help
            except click.BadParameter as error:
                if "does not exist" not in str(error):
                    raise AssertionError(f"{block.page}:{block.line}: {error.format_message()}") from error
            except click.UsageError as error:
                raise AssertionError(f"{block.page}:{block.line}: {error.format_message()}") from error
        targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
        for made in re.findall(r"^make ([a-z]+)", block.text, re.MULTILINE):
            assert made in targets, f"{block.page}:{block.line}: make {made}"
