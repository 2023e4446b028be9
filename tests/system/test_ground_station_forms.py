"""Forms and areas of the ground station in a real browser, with a hand-made server in the place of a stack."""

import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import msgspec
import pytest

pytest.importorskip("nicegui", reason="the extra jezero[ground] is not installed")
pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

from playwright.sync_api import expect

from jezero.schemas import topics
from jezero.schemas.actions import CancelReply, PlannedCoverage, PlanReply, Rejected, RunningGoal
from jezero.schemas.commands import AbortReply, HoverReply
from jezero.schemas.state import StatusCode
from jezero.schemas.topics import ACTIONS, AREA_COVERAGE, GO_TO, TAKEOFF
from tests.client.rig import ODOMETRY, Server, a_status, own_stack, published
from tests.system.ground_screen import CHROMIUM, Screen, browser_started, open_screen

ORIGIN_DEG = (18.4447, 77.4508, 0.0)
FLYING = msgspec.structs.replace(
    a_status(StatusCode.GO_TO),
    odometry=msgspec.structs.replace(ODOMETRY, origin_deg=ORIGIN_DEG),
    in_charge="goal",
    action="go_to",
    goal_id="theirs-1",
)
PLAN = PlanReply(
    accepted=True,
    duration_s=65.0,
    distance_m=40.0,
    battery_used=0.05,
    battery_remaining=0.9,
    coverage=PlannedCoverage(
        plan_id="ab",
        path_ned_m=((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0)),
        pictures_ned_m=((-1.0, -1.0), (1.0, 1.0)),
        start_ned_m=(0.0, 0.0),
        line_distance_m=2.0,
        picture_distance_m=2.0,
        length_m=40.0,
        duration_s=65.0,
        covered=1.0,
        photographed=0.97,
    ),
)
WAY = PlanReply(
    accepted=True,
    duration_s=34.0,
    distance_m=41.0,
    battery_used=0.05,
    path_ned_m=((1.0, 2.0, -2.0), (1.0, 2.0, -6.0), (1.0, 40.0, -6.0)),
)
WAY_WORDS = "Confirm: 34 s, 41 m, 5 % of the battery, up to 6 m"
OUTLINE_PX = ((-60.0, -60.0), (-60.0, 60.0), (60.0, 60.0), (60.0, -60.0))
HOLE_PX = ((20.0, 20.0), (20.0, 45.0), (45.0, 45.0))
FIELD = '{"type": "Polygon", "coordinates": [[[0, 0], [0, 1], [1, 1], [0, 0]]]}'

pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium on the path"),
    pytest.mark.timeout(300),
]


@contextmanager
def pages_for(endpoint: str) -> Iterator[str]:
    """A ground station of its own; its address."""
    words = [sys.executable, "-m", "jezero.cli.main", "ground", "--connect", endpoint, "--vehicle", "v"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        found = re.search(r"http://[\d.:]+\d", process.stdout.readline())
        assert found is not None
        try:
            yield found[0]
        finally:
            process.terminate()


def serve(server: Server) -> None:
    """Reply as a stack that flies another client's goal and refuses a takeoff."""
    for action in ACTIONS.values():
        server.serve(action.describe.name, action.description)
    goal = {"target_ned_m": [5.0, 0.0, -3.0], "frame": "world"}
    server.serve(GO_TO.running.name, RunningGoal(action="go_to", goal_id="theirs-1", clients=("theirs",), goal=goal))
    server.serve(GO_TO.cancel.name, CancelReply(canceled=True))
    server.serve(GO_TO.plan.name, WAY)
    server.serve(GO_TO.endpoint.name, Rejected(reason="another goal flies"))
    too_high = "altitude 9000 m is not within 0.5 to 120 m above the ground"
    server.serve(TAKEOFF.plan.name, PlanReply(accepted=False, reason=too_high))
    server.serve(AREA_COVERAGE.plan.name, PLAN)
    server.serve(topics.HOVER.name, HoverReply(hover_mode=True))
    server.serve(topics.ABORT.name, AbortReply(hovering=True))


@pytest.fixture(scope="module")
def served() -> Iterator[tuple[Screen, Server]]:
    """A page, and the server that it flies."""
    with own_stack() as (endpoint, _, server), ExitStack() as life:
        serve(server)
        life.enter_context(published(server, lambda t_ns: msgspec.structs.replace(FLYING, t_ns=t_ns)))
        browser = life.enter_context(browser_started())
        screen = open_screen(browser, None, life.enter_context(pages_for(endpoint)))
        screen.shows("Flying to a point")
        yield screen, server


@pytest.fixture
def screen(served: tuple[Screen, Server]) -> Screen:
    """The page."""
    return served[0]


@pytest.mark.long
def test_a_refusal_stands_at_the_field_that_it_is_about(screen: Screen) -> None:
    screen.choose("takeoff")
    for typed, reason in (("9000", "120"), ("high", "altitude: expected a number"), ("", "altitude is missing")):
        screen.type_in(takeoff__altitude_m=typed)
        screen.plan("takeoff")
        screen.has("problem-takeoff-altitude_m", reason)
    screen.choose("area_coverage")
    screen.plan("area_coverage")
    screen.has("problem-area_coverage-polygon_ned_m", "Draw the area on the map")


def test_an_area_is_drawn_corrected_exported_and_imported(screen: Screen, tmp_path: Path) -> None:
    screen.choose("area_coverage")
    for corner_px in (*OUTLINE_PX, (90.0, 0.0)):
        screen.click_map(*corner_px)
    screen.click_map(90.0, 0.0, "right")
    screen.marked("area-hole").click()
    for corner_px in HOLE_PX:
        screen.click_map(*corner_px)
    screen.marked("area-hole").click()
    screen.wait_for_rings([4, 3])
    screen.drag_map(OUTLINE_PX[3], (80.0, -60.0))
    screen.drag_map((-60.0, 0.0), (-80.0, 0.0))  # the middle of an edge becomes a corner
    screen.wait_for_rings([5, 3])
    assert max(corner[1] for corner in screen.rings()[0]) == pytest.approx(2.0)
    screen.marked("area-undo").click()
    screen.wait_for_rings([4, 3])

    with screen.page.expect_download() as saved:
        screen.marked("area-export").click()
    file = tmp_path / "area.geojson"
    saved.value.save_as(file)
    drawn = screen.rings()
    screen.marked("area-clear").click()
    screen.wait_for_rings([])
    screen.marked("area-file").set_input_files({"name": "far.geojson", "mimeType": "", "buffer": FIELD.encode()})
    expect(screen.page.locator(".q-notification").filter(has_text="km from the world's origin")).to_be_visible()
    screen.marked("area-file").set_input_files(file)
    screen.wait_for_rings([4, 3])
    for ring, before in zip(screen.rings(), drawn, strict=True):
        for corner, corner_before in zip(ring, before, strict=True):
            assert corner == pytest.approx(corner_before, abs=0.01)
    screen.has("plan-area_coverage", "97 %")
    screen.has("plan-area_coverage", "1 min 5 s")
    screen.has("plan-area_coverage", "5 % of 90 %")


@pytest.mark.long
def test_another_clients_goal_is_shown_and_is_ended_by_button_and_by_keys_whatever_has_the_focus(
    served: tuple[Screen, Server],
) -> None:
    screen, server = served
    screen.choose("takeoff")
    screen.has("goal", "go to")
    screen.has("goal-owner", "sent by another program")
    screen.marked("goal-cancel").click()
    screen.tells("go to (sent by another program) is canceled")
    screen.marked("fly-takeoff").focus()
    screen.page.keyboard.press("Space")
    screen.tells("The vehicle hovers")
    screen.marked("takeoff-altitude_m").focus()
    screen.page.keyboard.press("Escape")
    screen.tells("Aborted")
    asked = [(name, fields) for name, _, fields in server.asked if name.startswith(("@control", GO_TO.cancel.name))]
    assert asked[0] == (GO_TO.cancel.name, {"goal_id": "theirs-1"})
    assert [name for name, _ in asked[1:]] == [topics.HOVER.name, topics.ABORT.name]


def test_a_goal_is_flown_by_a_second_click_on_its_plan_and_by_nothing_else(served: tuple[Screen, Server]) -> None:
    screen, server = served

    def requests(key: str) -> int:
        return sum(name == key for name, _, _ in server.asked)

    aborts = requests(topics.ABORT.name)
    screen.choose("go_to")
    screen.click_map(20.0, 40.0)
    for withdrawal in ("type", "Escape", "Back"):
        screen.plan("go_to")
        screen.has("fly-go_to", WAY_WORDS)
        if withdrawal == "type":
            screen.marked("go_to-target_ned_m-north").fill("2")
        elif withdrawal == "Escape":
            screen.page.keyboard.press("Escape")
        else:
            screen.marked("back-go_to").click()
        expect(screen.marked("fly-go_to")).to_have_text("Fly")
    screen.marked("fly-go_to").dblclick()
    screen.has("fly-go_to", WAY_WORDS)
    for mark in ("fly-go_to", "go_to-target_ned_m-north"):
        screen.marked(mark).focus()
        screen.page.keyboard.press("Enter")
    assert requests(GO_TO.endpoint.name) == 0
    assert requests(topics.ABORT.name) == aborts
    screen.marked("fly-go_to").click()
    screen.has("problem-go_to", "another goal flies")
    assert requests(GO_TO.endpoint.name) == 1


def test_a_click_on_the_map_sets_the_target_and_a_landing_asks_for_what_its_case_needs(screen: Screen) -> None:
    screen.choose("go_to")
    screen.click_map(20.0, 40.0)
    expect(screen.marked("go_to-target_ned_m-north")).not_to_have_value("")
    expect(screen.marked("go_to-target_ned_m-height")).to_have_value("3")
    screen.choose("land_on_spot")
    north = screen.marked("land_on_spot-landing_spot_ned_m-north")
    expect(north).not_to_be_visible()
    screen.marked("land_on_spot-case").get_by_text("Spot", exact=True).click()
    expect(north).to_be_visible()


def test_the_page_is_as_it_was_when_it_is_loaded_again(screen: Screen) -> None:
    before = screen.rings()
    screen.page.reload()
    screen.has("goal-owner", "sent by another program")
    expect(screen.marked("land_on_spot-case")).to_be_visible()
    expect(screen.page.locator(".map canvas")).to_be_visible()
    screen.choose("area_coverage")
    screen.has("plan-area_coverage", "97 %")
    assert screen.rings() == before
    assert not screen.errors
    assert not screen.foreign
