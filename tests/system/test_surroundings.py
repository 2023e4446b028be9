"""A machine that lacks something, or on which something is taken: one sentence, soon, and no process is left."""

import fcntl
import json
import os
import resource
import shlex
import shutil
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from jezero.deploy.launcher.ports import instance_environment, reserved_instance
from jezero.runtime.instance import Instance
from jezero.schemas.images import LISTING
from tests.system.conftest import JEZERO, Stack, wait_for

NOTICED_WITHIN_S = 2.0
TRIES = 3
"""A busy machine may delay any command; the fastest try counts."""
HEALTHCHECK = "healthcheck: {test: [x]}"
SLEEPER = "{command: sleep 1000}"
WITH_ROUTER = f"services:\n  router: {{command: python -m jezero.runtime.router, {HEALTHCHECK}}}\n  a: {SLEEPER}\n"
ALONE = f"services:\n  a: {SLEEPER}\n"
OLD = "what was there before"


@pytest.fixture
def toy(tmp_path: Path) -> Iterator[Stack]:
    """A stack with ports and a run folder of its own, not started."""
    with reserved_instance(vehicle=f"s{os.getpid()}") as instance:
        environment = {**os.environ, **instance_environment(instance), "JEZERO_RUN_DIR": str(tmp_path / "run")}
        stack = Stack(instance, tmp_path / "run", environment)
        yield stack
        stack.jezero("down", check=False)


def compose_file(tmp_path: Path, text: str) -> str:
    path = tmp_path / "compose.yaml"
    path.write_text(text)
    return str(path)


def sentence_of(done: "subprocess.CompletedProcess[str]") -> str:
    """What a command that failed printed: one line on standard error and nothing else."""
    assert done.returncode in {1, 3}, f"exit {done.returncode}: {done.stdout}{done.stderr}"
    assert done.stdout == "" and "Traceback" not in done.stderr
    (line,) = done.stderr.splitlines()
    return line


def refused_soon(stack: Stack, *words: str) -> str:
    """The sentence of a command that must fail within two seconds."""
    fastest_s = float("inf")
    for _ in range(TRIES):
        begin_s = time.monotonic()
        sentence = sentence_of(stack.jezero(*words, check=False))
        fastest_s = min(fastest_s, time.monotonic() - begin_s)
        if fastest_s < NOTICED_WITHIN_S:
            return sentence
    raise AssertionError(f"{sentence!r} took {fastest_s:.1f} s")


# -- the disk --


def with_disk(stack: Stack, options: str, folder: Path, script: str) -> "subprocess.CompletedProcess[str]":
    """Run a script in which `folder` is a disk of its own; `jezero` is the command, $DISK the folder."""
    if subprocess.run(["unshare", "-Urm", "true"], capture_output=True, check=False).returncode != 0:
        pytest.skip("this user may not mount disks of its own")
    folder.mkdir(exist_ok=True)
    mount = f"mount -t tmpfs -o {options} tmpfs $DISK && {script.replace('jezero', shlex.join(JEZERO))}"
    return subprocess.run(
        ["unshare", "-Urm", "sh", "-c", mount],
        env={**stack.environment, "DISK": str(folder)},
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )


WRITERS = {
    "up": "jezero up --wait -f {compose} --run-dir $DISK/run",
    "up in the foreground": "jezero up -f {compose} --run-dir $DISK/run",
    "fly": "jezero fly --fast --out $DISK/run",
    "demo": "jezero demo --fast --runs $DISK/run",
    "plan": "jezero gridsweep --plan-only --polygon {area} --metres --z -5 --resolution 2 --out $DISK/plan.png",
    "new": "jezero new action spiral --into $DISK",
}


@pytest.mark.parametrize("command", WRITERS)
def test_a_folder_that_cannot_be_written_is_named(toy: Stack, tmp_path: Path, command: str) -> None:
    (tmp_path / "area.csv").write_text("0,0\n8,0\n8,8\n")
    script = WRITERS[command].format(compose=compose_file(tmp_path, ALONE), area=tmp_path / "area.csv")
    sentence = sentence_of(with_disk(toy, "ro", tmp_path / "disk", script))
    assert f"{tmp_path / 'disk'}/" in sentence and "Read-only file system" in sentence


@pytest.mark.parametrize("command", ["up", "up in the foreground", "plan"])
def test_a_full_disk_is_named(toy: Stack, tmp_path: Path, command: str) -> None:
    (tmp_path / "area.csv").write_text("0,0\n8,0\n8,8\n")
    script = WRITERS[command].format(compose=compose_file(tmp_path, ALONE), area=tmp_path / "area.csv")
    fill = "{ cat /dev/zero > $DISK/full; mkdir -p $DISK/run; } 2> /dev/null; "
    done = with_disk(toy, "size=16k", tmp_path / "disk", fill + script)
    if command == "up in the foreground":
        done.stdout = ""  # the lines of the services
    assert "No space left on device (make room on the disk" in sentence_of(done)


def test_a_disk_that_fills_up_while_a_stack_runs_stops_no_service(toy: Stack, tmp_path: Path) -> None:
    file = compose_file(tmp_path, ALONE)
    script = (
        f"jezero up --wait -f {file} --run-dir $DISK/run && cat /dev/zero > $DISK/full; "
        "jezero ps --run-dir $DISK/run && jezero down --run-dir $DISK/run"
    )
    done = with_disk(toy, "size=256k", tmp_path / "disk", script)
    assert done.returncode == 0, done.stderr
    assert "a        running" in done.stdout and done.stdout.splitlines()[-1] == "stopped"


def test_a_limit_on_the_size_of_files_is_named(toy: Stack, tmp_path: Path) -> None:
    file = compose_file(tmp_path, ALONE)
    done = limited(toy, resource.RLIMIT_FSIZE, 0, "up", "--wait", "-f", file)
    assert f"{toy.run_dir}: File too large (`ulimit -f` limits the size of files)" in sentence_of(done)


def limited(stack: Stack, kind: int, limit: int, *words: str) -> "subprocess.CompletedProcess[str]":
    """Run a command under a limit of the operating system."""
    return subprocess.run(
        [*JEZERO, *words],
        env=stack.environment,
        preexec_fn=lambda: resource.setrlimit(kind, (limit, limit)),
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def test_without_a_home_the_option_that_names_a_folder_is_named(toy: Stack, tmp_path: Path) -> None:
    del toy.environment["JEZERO_RUN_DIR"]
    (tmp_path / "file").write_text("")
    toy.environment |= {"HOME": str(tmp_path / "file" / "home"), "XDG_STATE_HOME": ""}
    for words in (("up", "-d", "-f", compose_file(tmp_path, ALONE)), ("down",), ("ps",)):
        done = toy.jezero(*words, check=False)
        if done.returncode:
            assert f"{tmp_path}/file/home" in sentence_of(done) and "Not a directory" in done.stderr
        else:
            assert f"nothing runs in {tmp_path}/file/home" in done.stdout


# -- limits and the interpreter --


@pytest.mark.parametrize("files", [16, 24, 64])
def test_too_few_open_files_are_counted_against_what_a_stack_needs(toy: Stack, files: int) -> None:
    sentence = sentence_of(limited(toy, resource.RLIMIT_NOFILE, files, "up", "--wait"))
    assert f"a process may open {files} files only, a stack needs 256: raise the limit with `ulimit -n`" in sentence


def test_a_low_limit_of_open_files_that_may_be_raised_is_raised_for_all_services(toy: Stack, tmp_path: Path) -> None:
    prints = 'python -c "import resource, time; print(resource.getrlimit(7)[0], flush=True); time.sleep(1000)"'
    file = compose_file(tmp_path, f"services:\n  a:\n    command: {json.dumps(prints)}\n")
    lower = f"ulimit -S -n 64; exec {shlex.join(JEZERO)} up -d -f {file}"
    subprocess.run(["sh", "-c", lower], env=toy.environment, check=True)
    wait_for(lambda: "a | 256" in toy.jezero("logs").stdout, 20.0, "the limit in the log")


def test_an_interpreter_that_is_gone_is_named_once(toy: Stack, tmp_path: Path) -> None:
    broken = f"import sys; sys.executable = {str(tmp_path / 'gone')!r}; from jezero.cli.main import main; main()"
    done = subprocess.run(
        [JEZERO[0], "-c", broken, "up", "--wait"], env=toy.environment, capture_output=True, text=True, check=False
    )
    assert f"the Python interpreter {tmp_path / 'gone'} can't be executed" in sentence_of(done)


# -- ports and addresses --


def hold(protocol: str, port: int) -> socket.socket:
    """Hold a port in this process."""
    if protocol == "tcp":
        return socket.create_server(("127.0.0.1", port))
    held = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    held.bind(("127.0.0.1", port))
    return held


def router_port(instance: Instance) -> int:
    return int(instance.router.rpartition(":")[2])


@pytest.mark.parametrize(
    ("protocol", "which", "variable"),
    [
        ("tcp", "router", "JEZERO_ROUTER"),
        ("tcp", "hil", "JEZERO_INSTANCE"),
        ("udp", "bridge", "JEZERO_INSTANCE"),
        ("udp", "autopilot_offboard", "JEZERO_INSTANCE"),
        ("udp", "autopilot_gcs", "JEZERO_INSTANCE"),
    ],
)
def test_a_port_that_another_program_holds_is_named_with_the_program_and_the_variable(
    toy: Stack, protocol: str, which: str, variable: str
) -> None:
    port = router_port(toy.instance) if which == "router" else int(getattr(toy.instance, f"{which}_port"))
    with hold(protocol, port):
        sentence = refused_soon(toy, "up", "--wait")
    assert f"{protocol.upper()} port {port} of 127.0.0.1 is held by process {os.getpid()} (" in sentence
    assert f"set {variable} to another one" in sentence


def test_a_service_whose_port_is_taken_later_says_so_itself(toy: Stack) -> None:
    with hold("tcp", toy.instance.hil_port):
        done = subprocess.run(
            [JEZERO[0], "-m", "jezero.services.simulator"],
            env=toy.service_environment,
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
    assert f"simulator: TCP port {toy.instance.hil_port} of 127.0.0.1 is held by process {os.getpid()}" in done.stderr
    assert done.returncode == 1 and "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("address", "reason"),
    [
        ("127.0.0.1:7447", "is no address of a router: write PROTOCOL/HOST:PORT, such as tcp/127.0.0.1:7447"),
        ("tcp://127.0.0.1:7447", "is no address of a router"),
        ("tcp/192.0.2.1:7447", "the programs of this computer need an address on its loopback, such as tcp/"),
    ],
)
def test_an_address_of_the_router_that_cannot_be_used_is_shown(toy: Stack, address: str, reason: str) -> None:
    toy.environment["JEZERO_ROUTER"] = address
    sentence = sentence_of(toy.jezero("up", "--wait", "--insecure", check=False))
    assert reason in sentence and "JEZERO_ROUTER" in sentence
    if "is no address" in reason:
        status = toy.jezero("status", check=False)
        assert status.returncode == 2 and f"'{address}' is no address of a router" in status.stderr


@pytest.mark.parametrize("host", ["203.0.113.9", "no-such-host.invalid"])
def test_an_address_for_other_computers_that_cannot_be_used_is_shown(toy: Stack, host: str) -> None:
    sentence = sentence_of(toy.jezero("up", "--wait", "--insecure", "--listen", f"tcp/{host}:7447", check=False))
    assert "cannot listen on" in sentence and host in sentence and "JEZERO_LISTEN" in sentence


# -- settings --


def test_a_wrong_setting_ends_the_start_at_once_and_is_named(toy: Stack, tmp_path: Path) -> None:
    settings = tmp_path / "settings"
    shutil.copytree(Path(__file__).resolve().parents[2] / "deploy" / "config", settings)
    (settings / "tag_detector.toml").write_text("speling_m = 1\n")
    toy.environment["JEZERO_CONFIG_DIR"] = str(settings)
    file = compose_file(
        tmp_path,
        f"{WITH_ROUTER}  tag_detector:\n    command: python -m jezero.services.estimator.tag_detector\n"
        f"    restart: unless-stopped\n    {HEALTHCHECK}\n",
    )
    failed = toy.jezero("up", "--wait", "-f", file, check=False)
    first = failed.stderr.splitlines()[0]
    assert f"tag_detector: ended with exit code 78: {settings}/tag_detector.toml: " in first
    assert "there is no setting 'speling_m'" in first and "Traceback" not in failed.stderr
    (row,) = (row for row in json.loads(toy.jezero("ps", "--json").stdout) if row["service"] == "tag_detector")
    assert (row["state"], row["restarts"]) == ("failed", 0)


def test_a_folder_of_settings_that_is_not_there_is_named(toy: Stack) -> None:
    toy.environment["JEZERO_CONFIG_DIR"] = "/no/such/folder"
    assert "/no/such/folder is no folder: JEZERO_CONFIG_DIR must" in refused_soon(toy, "up", "--wait")
    for words in (("fly", "--fast"), ("bench", "landing", "--n", "1"), ("info", "services"), ("campaign",)):
        assert "/no/such/folder/" in toy.jezero(*words, check=False).stderr.splitlines()[-1]


# -- two stacks --


def test_a_second_stack_of_a_vehicle_in_another_folder_is_refused_with_who_runs_it(toy: Stack, tmp_path: Path) -> None:
    file = compose_file(
        tmp_path,
        f"{WITH_ROUTER}  tag_detector: {{command: python -m jezero.services.estimator.tag_detector, {HEALTHCHECK}}}\n",
    )
    toy.jezero("up", "-d", "-f", file)
    # Without a camera the detector is degraded, so that `up --wait` would wait in vain.
    wait_for(lambda: "degraded" in toy.jezero("ps", check=False).stdout, 30.0, "the health of the tag detector")
    state = json.loads((toy.run_dir / "state.json").read_text())
    (pid,) = (row["pid"] for row in state["services"] if row["service"] == "tag_detector")
    for words in (("--wait",), ("-d",), ()):
        second = toy.jezero("up", *words, "-f", file, "--run-dir", str(tmp_path / "second"), check=False)
        assert second.returncode == 3
        assert f"tag_detector of vehicle {toy.instance.vehicle} runs already as " in sentence_of(second)
        assert f" pid {pid}, of launcher process {state['launcher_pid']} in {toy.run_dir}." in second.stderr
    toy.environment["JEZERO_VEHICLE"] = "another"
    toy.jezero("up", "-d", "-f", file, "--run-dir", str(tmp_path / "second"))
    toy.jezero("down", "--run-dir", str(tmp_path / "second"))


@pytest.mark.parametrize("compose", [WITH_ROUTER, ALONE], ids=["with a router", "alone"])
def test_of_stacks_of_a_vehicle_that_start_at_the_same_instant_all_but_one_are_refused(
    toy: Stack, tmp_path: Path, compose: str
) -> None:
    file = compose_file(tmp_path, compose)
    folders = [tmp_path / name for name in ("first", "second", "third")]
    starts = [toy.start("up", "-d", "-f", file, "--run-dir", str(folder)) for folder in folders]
    try:
        said = [start.communicate(timeout=60)[1] for start in starts]
        assert sorted(start.returncode for start in starts) == [0, 3, 3]
        (winner,) = (folder for folder, start in zip(folders, starts, strict=True) if start.returncode == 0)
        launcher = json.loads((winner / "state.json").read_text())["launcher_pid"]
        wanted = f"a of vehicle {toy.instance.vehicle} belongs to launcher process {launcher} already."
        assert [wanted in sentence for sentence in said].count(True) == 2, said
    finally:
        for folder in folders:
            toy.jezero("down", "--run-dir", str(folder))
    toy.jezero("up", "-d", "-f", file)  # nothing is left of the claims


def test_of_two_vehicles_that_start_at_the_same_instant_one_starts_the_router_for_both(
    toy: Stack, tmp_path: Path
) -> None:
    file, folders = compose_file(tmp_path, WITH_ROUTER), [tmp_path / name for name in ("first", "second")]
    starts = []
    for folder in folders:
        toy.environment["JEZERO_VEHICLE"] = f"{toy.instance.vehicle}-{folder.name}"
        starts.append(toy.start("up", "--wait", "-f", file, "--run-dir", str(folder)))
    try:
        assert [start.communicate(timeout=60)[1] for start in starts] == ["", ""]
        services = [row for folder in folders for row in json.loads((folder / "state.json").read_text())["services"]]
        assert sorted(row["state"] for row in services if row["service"] == "router") == ["external", "running"]
    finally:
        for folder in folders:
            toy.jezero("down", "--run-dir", str(folder))


def test_a_detached_launcher_keeps_no_file_and_no_lock_of_its_caller(toy: Stack, tmp_path: Path) -> None:
    lock = tmp_path / "lock of the caller"
    with lock.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        subprocess.run(
            [*JEZERO, "up", "-d", "-f", compose_file(tmp_path, ALONE)],
            env=toy.environment,
            pass_fds=(file.fileno(),),
            check=True,
        )
    with lock.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    launcher = int(json.loads((toy.run_dir / "state.json").read_text())["launcher_pid"])
    open_files = {os.readlink(path) for path in Path(f"/proc/{launcher}/fd").iterdir()}
    assert not any(name.startswith(str(tmp_path)) for name in open_files if not name.startswith(str(toy.run_dir)))
    assert toy.jezero("up", "-d", check=False).returncode == 3  # it holds the lock of its own folder


def test_the_reservation_of_an_instance_follows_and_changes_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The name of a lock file in a shared folder is known, so anybody could put a link there to somebody's file."""
    precious = tmp_path / "precious"
    precious.write_text(OLD)
    for number in range(1, 250):
        (tmp_path / f"jezero-{os.getuid()}-instance-{number}.lock").symlink_to(precious)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with reserved_instance() as first, reserved_instance() as second:
        assert first.number != second.number
    assert precious.read_text() == OLD


# -- commands that are killed --


@pytest.mark.long
@pytest.mark.whole
def test_a_command_that_takes_images_and_is_killed_leaves_a_folder_that_can_be_drawn_and_mapped(
    stack: Stack, tmp_path: Path
) -> None:
    (tmp_path / "area.csv").write_text("-2,-2\n2,-2\n2,2\n-2,2\n")
    folder = tmp_path / "sweep"
    stack.jezero("takeoff", "4")
    area = ["--polygon", str(tmp_path / "area.csv"), "--metres", "--z", "-4", "--resolution", "1.5"]
    sweep = stack.start("gridsweep", *area, "--out", str(folder))
    wait_for(lambda: len(list(folder.glob("images/*.jpg"))) >= 3 or sweep.poll() is not None, 120.0, "three images")
    sweep.send_signal(signal.SIGKILL)
    assert sweep.wait() == -signal.SIGKILL, sweep.communicate()
    sweep.communicate()
    listed = json.loads((folder / LISTING).read_text())["images"]
    assert len(listed) >= 2
    for command in ("report", "map"):
        assert "wrote" in stack.jezero(command, str(folder)).stdout
    stack.jezero("abort")
    stack.jezero("gridsweep", "--resume", str(folder))
    indices = [image["index"] for image in json.loads((folder / LISTING).read_text())["images"]]
    assert indices == list(range(len(indices))) and len(indices) > len(listed)
    assert "nothing is missing" in stack.jezero("gridsweep", "--resume", str(folder)).stdout
