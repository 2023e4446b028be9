"""The ground station's page in a real browser: what a person clicks flies a real stack.

All tests of the file share one stack and one page. Each leaves the vehicle where the next one expects it.
"""

from collections.abc import Iterator

import pytest

pytest.importorskip("nicegui", reason="the extra jezero[ground] is not installed")
pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

from playwright.sync_api import expect

from tests.system.ground_screen import FLIES_A_STACK, FLIGHT_TIMEOUT_MS, Screen, open_screen, stack_with_screen

ORBIT_CENTER_PX = (0.0, 80.0)
"""Two metres north of the map's middle: a metre has 40 pixels at first."""
OUTLINE_PX = ((-60.0, -60.0), (-60.0, 60.0), (60.0, 60.0), (60.0, -60.0))
HOLE_PX = ((20.0, 20.0), (20.0, 45.0), (45.0, 45.0))

pytestmark = FLIES_A_STACK


@pytest.fixture(scope="module")
def screen(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Screen]:
    """The page of a stack that is ready."""
    with stack_with_screen(tmp_path_factory.mktemp("ground")) as shown:
        yield shown


def test_goals_of_all_clients_are_shown_and_ended_by_key_and_by_button(screen: Screen) -> None:
    screen.choose("takeoff")
    screen.type_in(takeoff__altitude_m="3")
    screen.send("takeoff")
    screen.has("goal-owner", "sent from this page")
    screen.shows("Hovering")
    with screen.stack.connect() as uav:
        for ending in ("Space", "Escape", "Cancel"):
            goal = uav.go_to(20.0, 0.0, -3.0, speed_mps=0.5)
            screen.shows("Flying to a point")
            screen.has("goal-owner", "sent by another program")
            screen.marked("pause").click()
            screen.shows("Flying to a point, paused")
            screen.has("pause", "Resume")
            screen.marked("pause").click()
            screen.has("pause", "Pause")
            if ending == "Cancel":
                screen.marked("goal-cancel").click()
                screen.tells("go to (sent by another program) is canceled")
            else:
                screen.marked("takeoff-altitude_m" if ending == "Escape" else "fly-takeoff").focus()
                screen.page.keyboard.press(ending)
            screen.shows("Hovering")
            reply = uav.result_of(goal.goal_id)
            assert reply is not None, ending
            assert not reply.running, ending


def test_a_mission_is_flown_by_clicks_alone_and_seen_alike_after_a_reload_and_in_two_browsers(screen: Screen) -> None:
    screen.choose("get_images")
    screen.click_map(*ORBIT_CENTER_PX)
    screen.type_in(get_images__center_ned_m__height="3", get_images__radius_m="2", get_images__num_images="4")
    screen.send("get_images")
    screen.tells("get images was accepted")
    screen.tells("All images taken")

    screen.choose("area_coverage")
    for corner_px in OUTLINE_PX:
        screen.click_map(*corner_px)
    screen.marked("area-hole").click()
    for corner_px in HOLE_PX:
        screen.click_map(*corner_px)
    screen.wait_for_rings([4, 3])
    screen.has("plan-area_coverage", "battery")
    screen.send("area_coverage")
    screen.has("goal", "images")
    screen.marked("pause").click()  # so that the goal lasts for as long as the pages take to open
    screen.has("pause", "Resume")
    screen.page.reload()
    screen.has("goal", "area coverage")
    assert [len(ring) for ring in screen.rings()] == [4, 3]
    other = open_screen(screen.page.context.browser, screen.stack, screen.address)  # type: ignore[arg-type]
    other.has("goal-owner", "sent from another page of this ground station")
    assert other.page.locator(".state-words").inner_text() == screen.page.locator(".state-words").inner_text()
    screen.marked("pause").click()
    expect(screen.marked("goal")).not_to_be_visible(timeout=FLIGHT_TIMEOUT_MS)
    screen.shows("Hovering")
    assert screen.maps > 0

    screen.choose("land_on_spot")
    screen.send("land_on_spot")
    screen.tells("Landing")
    for seen in (screen, other):
        seen.shows("On the ground")
    with screen.stack.connect() as uav:
        assert not uav.status().armed
    for seen in (screen, other):
        assert not seen.errors
        assert not seen.foreign
    other.page.context.close()


def test_the_rover_is_driven_while_its_pad_is_held_and_stops_when_it_is_let_go(screen: Screen) -> None:
    with screen.stack.connect() as uav, uav.subscribe("rover/odometry") as odometry:
        box = screen.marked("rover-pad").bounding_box()
        assert box is not None
        middle = (box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"])
        screen.page.mouse.move(*middle)
        screen.page.mouse.down()
        screen.page.mouse.move(middle[0], middle[1] - 60.0, steps=3)
        assert any(message.speed_rover_body_mps > 0.3 for message in odometry)
        screen.page.mouse.up()
        assert any(abs(message.speed_rover_body_mps) < 0.02 for message in odometry)
    assert not screen.errors
