"""A revoked member reads that it is revoked, also when only the router knows it: real routers and clients."""

import asyncio
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from jezero import TimedOut, Unreachable, Vehicle, aio
from jezero.cli.terminal import UNREACHABLE
from jezero.keys.team import Team
from jezero.runtime.instance import socket_of
from jezero.runtime.routing import open_router
from jezero.schemas import topics
from jezero.services.ground_station.web.feed import Feed
from tests.client.rig import free_endpoint
from tests.keys.rig import make_team
from tests.runtime.computers import computer

pytestmark = pytest.mark.process

VEHICLE = "uav1"
LATEST_S = 60.0
HIDDEN = "lets viewer-eye connect, and shows it nothing of uav1: viewer-eye is revoked, or"
"""What the router doesn't show is all that the wire says of a revocation."""


@dataclass
class Revoked:
    """A router process, and the bundle of a member that it knows to be revoked.

    Attributes:
        elsewhere: a copy of the bundle with the list from before the revocation.
    """

    address: str
    team: Team
    elsewhere: Path

    def connect(self, bundle: Path) -> Vehicle:
        return Vehicle.connect(VEHICLE, router=self.address, keys=bundle, timeout_s=LATEST_S)


@pytest.fixture(scope="module")
def revoked(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Revoked]:
    folder = tmp_path_factory.mktemp("revoked")
    team = make_team(folder / "team")
    elsewhere = Path(shutil.copytree(team.bundle("viewer-eye"), folder / "viewer-eye"))
    team.revoke("viewer-eye")
    with computer(team, folder) as vehicle:
        address = vehicle.address
        with Vehicle.connect(VEHICLE, router=address, keys=team.bundle("pilot-ana"), timeout_s=LATEST_S):
            pass
        yield Revoked(address, team, elsewhere)


def test_requests_subscriptions_and_waits_of_the_sdk_say_it(revoked: Revoked) -> None:
    with revoked.connect(revoked.elsewhere) as viewer:
        with pytest.raises(Unreachable, match=HIDDEN):
            viewer.status()
        with pytest.raises(TimedOut, match=HIDDEN):
            viewer.wait_ready(timeout_s=1.0)
        with pytest.raises(TimedOut, match=HIDDEN):
            viewer.odometry()
        with viewer.subscribe(topics.CLOCK) as stream, pytest.raises(TimedOut, match=HIDDEN):
            stream.next(timeout_s=0.2)


def test_the_sdk_for_asyncio_says_it(revoked: Revoked) -> None:
    async def use() -> None:
        connecting = aio.Vehicle.connect(VEHICLE, router=revoked.address, keys=revoked.elsewhere, timeout_s=LATEST_S)
        async with await connecting as viewer:
            with pytest.raises(Unreachable, match=HIDDEN):
                await viewer.status()
            async with viewer.subscribe(topics.CLOCK) as stream:
                with pytest.raises(TimedOut, match=HIDDEN):
                    await stream.next(timeout_s=0.2)

    asyncio.run(use())


def test_a_member_whose_own_list_says_it_gets_the_certain_sentence(revoked: Revoked) -> None:
    certain = "viewer-eye is revoked: ask the one who has the team"
    with revoked.connect(revoked.team.bundle("viewer-eye")) as viewer, pytest.raises(Unreachable, match=certain):
        viewer.status()


def test_who_is_not_revoked_is_asked_whether_the_stack_is_up(revoked: Revoked) -> None:
    with revoked.connect(revoked.team.bundle("pilot-ana")) as pilot:
        with pytest.raises(Unreachable, match="is the stack up"):
            pilot.status()
        with pytest.raises(TimedOut, match="is its service up"):
            pilot.odometry()


@pytest.mark.parametrize("words", [("status",), ("mission", "status"), ("watch", "--foxglove")])
def test_the_commands_say_it(revoked: Revoked, words: tuple[str, ...]) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "jezero.cli.main", *words, "--router", revoked.address, "--keys",
         str(revoked.elsewhere)],
        env=os.environ | {"JEZERO_VEHICLE": VEHICLE}, capture_output=True, text=True, timeout=LATEST_S, check=False,
    )  # fmt: skip
    said = " ".join((done.stdout + done.stderr).split())
    assert done.returncode == UNREACHABLE and HIDDEN in said, said


def test_the_page_of_a_computer_that_is_revoked_says_it(
    revoked: Revoked, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("JEZERO_CONNECT", revoked.address)
    monkeypatch.setenv("JEZERO_KEYS", str(revoked.elsewhere))
    endpoint = free_endpoint()

    async def page() -> dict[str, object]:
        feed = Feed(VEHICLE, endpoint)
        await feed.connect()
        try:
            async with asyncio.timeout(LATEST_S):
                while not feed.problem:
                    await asyncio.sleep(0.1)
            return feed.state.status_line(feed.now_s, feed.problem)
        finally:
            await feed.close()

    with open_router(endpoint, socket_of(tmp_path)):
        line = asyncio.run(page())
    assert line["words"] == "No vehicle" and HIDDEN in str(line["why"])
