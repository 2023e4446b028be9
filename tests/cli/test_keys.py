"""`jezero keys` on the command line."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from jezero.cli.main import main


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    return tmp_path


def keys(*words: str) -> Result:
    return CliRunner().invoke(main, ["keys", *words])


def test_a_team_is_made_listed_renewed_and_revoked(home: Path) -> None:
    team = home / "jezero" / "team"
    assert str(team) in keys("init").output
    assert str(team / "vehicle-uav1") in keys("add", "vehicle", "uav1", "--host", "192.168.1.10").output
    added = keys("add", "pilot", "ana", "--days", "10").output
    assert "into the bundles of vehicle-uav1, whose routers follow it by themselves, also in flight" in added
    assert "restart" not in added
    assert sorted(path.name for path in (team / "pilot-ana").iterdir()) == [
        "ca.pem",
        "certificate.pem",
        "key.pem",
        "mavlink.key",
        "members.json",
    ]
    listed = keys("list").output
    assert "in 9 days" in listed and "192.168.1.10" in listed and "authority" in listed
    assert "in 9 days" not in keys("renew", "pilot-ana").output + keys("list").output
    assert "pilot-ana is revoked" in keys("revoke", "pilot-ana").output
    read = json.loads(keys("list", "--json").output)
    assert [(member["name"], member["revoked"]) for member in read["members"]] == [
        ("pilot-ana", True),
        ("vehicle-uav1", False),
    ]


def test_nothing_secret_is_printed(home: Path) -> None:
    printed = "".join(
        keys(*words).output
        for words in (
            ("init",), ("add", "rover", "r1"), ("add", "pilot", "ana"), ("renew", "pilot-ana"), ("list",),
            ("list", "--json"),
        )
    )  # fmt: skip
    for path in (*home.rglob("key.pem"), *home.rglob("mavlink.key")):
        secret = path.read_text().splitlines()[-2 if path.suffix == ".pem" else 0]
        assert secret not in printed
    assert "PRIVATE" not in printed


def test_a_router_without_addresses_is_named(home: Path) -> None:
    keys("init")
    assert "without --host others can't connect to it" in keys("add", "ground", "lab").output


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["list"], "`jezero keys init` makes one"),
        (["add", "vehicle", "uav1"], "`jezero keys init` makes one"),
        (["revoke", "pilot-ana"], "`jezero keys init` makes one"),
        (["add", "captain", "ana"], "is not one of"),
        (["add", "pilot", "ana", "--days", "0"], "is not in the range"),
    ],
)
def test_wrong_words_get_a_sentence(home: Path, words: list[str], sentence: str) -> None:
    done = keys(*words)
    assert done.exit_code in (1, 2)
    assert sentence in done.output


@pytest.mark.parametrize("command", [["status"], ["ground"], ["watch", "--foxglove"], ["replay", "no.mcap"]])
def test_an_address_with_tls_needs_a_bundle(home: Path, command: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    router = ["--router", "tls/127.0.0.1:1"]
    (home / "no.mcap").touch()
    monkeypatch.chdir(home)
    assert "name the folder of a bundle with --keys or JEZERO_KEYS" in invoke([*command, *router])
    assert "ca.pem is missing: copy the whole folder" in invoke([*command, *router, "--keys", str(home)])
    assert "does not exist" in invoke([*command, *router, "--keys", "nowhere"])
    monkeypatch.setenv("JEZERO_KEYS", str(home))
    assert "ca.pem is missing: copy the whole folder" in invoke([*command, *router])


@pytest.mark.parametrize("command", [["status"], ["ground"], ["watch", "--foxglove"], ["replay", "no.mcap"]])
def test_a_bundle_that_others_can_read_is_refused_with_the_command_to_type(home: Path, command: list[str]) -> None:
    keys("init")
    keys("add", "pilot", "ana")
    bundle = home / "jezero" / "team" / "pilot-ana"
    bundle.chmod(0o750)
    (home / "no.mcap").touch()
    words = [*command, "--router", "tls/127.0.0.1:1", "--keys", str(bundle)]
    words = [str(home / word) if word.endswith(".mcap") else word for word in words]
    assert f"other users can read or change {bundle}, and could pretend to be its owner: type" in invoke(words)


@pytest.mark.parametrize("command", [["status"], ["ground"], ["takeoff", "3"]])
def test_another_computer_needs_tls_or_the_word_insecure(command: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("JEZERO_INSECURE", raising=False)
    said = invoke([*command, "--router", "tcp/192.0.2.1:7447"])
    assert "write tls/… and name the bundle" in said and "--insecure or JEZERO_INSECURE=1" in said


def test_up_refuses_to_listen_to_other_computers_without_tls(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("JEZERO_INSECURE", raising=False)
    monkeypatch.setenv("JEZERO_ROUTER", "tcp/0.0.0.0:7447")
    done = CliRunner().invoke(main, ["up"])
    assert done.exit_code == 1 and "without TLS whoever is on the network of tcp/0.0.0.0:7447 could fly" in done.output


def invoke(words: list[str]) -> str:
    """What a command says that is refused."""
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 2
    return " ".join(done.output.split())


def test_the_help_of_jezero_imports_no_cryptography() -> None:
    program = (
        "import sys\nfrom jezero.cli.main import main\n"
        "try:\n    main(['--help'])\nexcept SystemExit:\n    pass\n"
        "sys.exit('cryptography' in sys.modules or 'ssl' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", program], capture_output=True, check=False).returncode == 0
