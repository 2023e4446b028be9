"""What the pages show of the messages that arrived."""

from math import inf, nan
from typing import Any

import msgspec
import pytest

from jezero.schemas import topics
from jezero.schemas.actions import FeedbackMessage
from jezero.schemas.fence import Fence, FenceState, Zone
from jezero.schemas.goals import ImagesFeedback, LandFeedback
from jezero.schemas.preflight import Check, PreflightReport
from jezero.schemas.sensors import Altimeter
from jezero.schemas.state import Battery
from jezero.schemas.topics import feedback_of, health_of
from jezero.services.ground_station import views
from jezero.services.ground_station.state import ShownState
from tests.services.ground_station.messages import IMAGE, Flight, health, relative, rover

FLIGHT = Flight()


def reading(state: ShownState, label: str, now_s: float) -> dict[str, Any]:
    return next(row for row in state.readings(now_s) if row["label"] == label)


def shown(now_s: float = 0.0, **fields: Any) -> ShownState:
    """A state with one status."""
    state = ShownState()
    state.update(now_s, topics.STATUS, FLIGHT.status(**fields))
    return state


def test_without_any_message_the_page_says_what_is_missing() -> None:
    line = ShownState().status_line(0.0, "no router at tcp/127.0.0.1:7447")
    assert line["words"] == "No vehicle"
    assert line["why"] == "no router at tcp/127.0.0.1:7447"


def test_without_any_message_no_value_is_a_number() -> None:
    rows = ShownState().readings(0.0)
    assert {row["text"] for row in rows} == {"–"}
    assert all(row["late"] for row in rows)


def test_a_value_turns_grey_after_a_second_and_disappears_after_ten() -> None:
    state = shown()
    assert reading(state, "north", 0.9) == {"label": "north", "text": "1.00", "unit": "m", "age": "now", "late": False}
    assert reading(state, "north", 3.2) == {
        "label": "north",
        "text": "1.00",
        "unit": "m",
        "age": "3 s ago",
        "late": True,
    }
    assert reading(state, "north", 11.0)["text"] == "–"


def test_an_altimeter_that_meets_nothing_shows_no_number() -> None:
    state = shown()
    state.update(0.0, topics.ALTIMETER, Altimeter(t_ns=0, range_m=None))
    assert reading(state, "over ground", 0.1)["text"] == "–"
    state.update(0.2, topics.ALTIMETER, Altimeter(t_ns=0, range_m=1.5))
    assert reading(state, "over ground", 0.3)["text"] == "1.50"


def test_an_unknown_battery_shows_no_number() -> None:
    assert reading(shown(battery=None), "battery", 0.1)["text"] == "–"
    assert reading(shown(), "battery", 0.1)["text"] == "80"


def test_the_height_counts_from_where_the_vehicle_stood_before_it_was_armed() -> None:
    state = ShownState()
    stands = FLIGHT.at(0.0, 0.0, -0.4).status(code=0, armed=False, landed=True, in_charge="none")
    state.update(0.0, topics.STATUS, stands)
    assert (state.start_z_ned_m, reading(state, "height", 0.1)["text"]) == (-0.4, "0.00")
    state.update(0.2, topics.STATUS, FLIGHT.at(0.0, 0.0, -2.4).status(code=1, takeoff_ned_m=(0.0, 0.0, -0.4)))
    assert (state.start_z_ned_m, reading(state, "height", 0.3)["text"]) == (-0.4, "2.00")
    state.update(0.4, topics.STATUS, FLIGHT.at(0.0, 0.0, -2.4).status(code=1))
    assert (state.start_z_ned_m, reading(state, "height", 0.5)["text"]) == (0.0, "2.40")


def test_the_status_line_tells_who_is_in_charge_and_for_how_long() -> None:
    state = shown(0.0, code=4, in_charge="goal", action="go_to", goal_id="a", text="flying")
    state.update(
        5.0, topics.STATUS, FLIGHT.status(code=4, in_charge="goal", action="go_to", goal_id="a", text="flying")
    )
    line = state.status_line(5.1, "")
    assert (line["words"], line["charge"], line["since"]) == ("Flying to a point", "the goal go to", "for 5 s")
    assert line["why"] == "flying"


def test_a_vehicle_that_is_not_ready_tells_why() -> None:
    line = shown(code=0, armed=False, ready=False, in_charge="none", not_ready_reason="no GNSS fix").status_line(
        0.1, ""
    )
    assert (line["words"], line["tone"], line["why"]) == ("On the ground, not ready", "warning", "no GNSS fix")


def standing(state: ShownState, now_s: float, **fields: Any) -> dict[str, Any]:
    """The state line of a vehicle that stands on the ground and is ready, unless `fields` say otherwise."""
    on_ground: dict[str, Any] = {"code": 0, "armed": False, "landed": True, "in_charge": "none"}
    state.update(now_s, topics.STATUS, FLIGHT.status(**(on_ground | fields)))
    return state.status_line(now_s, "")


def report(*failed: str) -> PreflightReport:
    """A preflight report in which these checks have failed."""
    names = ("battery", "gnss")
    checks = [Check(name=n, verdict="failed" if n in failed else "passed", text="12 %") for n in names]  # type: ignore[arg-type]
    return PreflightReport(t_ns=0, epoch_id=1, checks=tuple(checks))


def test_a_vehicle_is_green_only_when_a_fresh_preflight_report_has_no_failure() -> None:
    state = ShownState()
    line = standing(state, 0.0)
    assert (line["words"], line["tone"]) == ("On the ground, not checked", "warning")
    state.update(1.0, topics.PREFLIGHT, report("battery"))
    line = standing(state, 1.1)
    assert (line["words"], line["tone"]) == ("On the ground, preflight failed", "warning")
    assert line["why"] == "battery: 12 %"
    state.update(2.0, topics.PREFLIGHT, report())
    line = standing(state, 2.1)
    assert (line["words"], line["tone"]) == ("On the ground, ready", "good")
    assert standing(state, 2.2, ready=False)["tone"] == "warning"
    assert standing(state, 33.0)["words"] == "On the ground, not checked"


def test_a_preflight_report_from_before_the_flight_makes_nothing_green() -> None:
    state = ShownState()
    state.update(0.0, topics.PREFLIGHT, report())
    assert standing(state, 0.1)["tone"] == "good"
    state.update(1.0, topics.STATUS, FLIGHT.status(code=1, in_charge="goal", action="takeoff", goal_id="a"))
    assert standing(state, 4.0)["words"] == "On the ground, not checked"
    state.update(6.0, topics.PREFLIGHT, report())
    assert standing(state, 6.1)["words"] == "On the ground, ready"


@pytest.mark.parametrize(
    ("mode", "in_charge", "words"),
    [
        ("AUTO.LAND", "failsafe", "Landing, failsafe"),
        ("AUTO.RTL", "failsafe", "Returning, failsafe"),
        ("AUTO.LAND", "external", "Landing, external pilot"),
        ("POSCTL", "external", "Flying, external pilot"),
    ],
)
def test_whoever_flies_instead_of_the_bridge_is_named_beside_what_the_vehicle_does(
    mode: str, in_charge: str, words: str
) -> None:
    line = shown(code=13, in_charge=in_charge, autopilot_mode=mode, text="why").status_line(0.1, "")
    assert (line["words"], line["tone"], line["why"]) == (words, "bad", "why")


LOST = {"code": 13, "in_charge": "failsafe", "action": ""}


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"text": "motors cut on request"}, "Motors cut on request (5 s ago)"),
        ({"text": "failsafe: low battery"}, "Ended by a failsafe: low battery (5 s ago)"),
        (
            {"text": "taken over: armed, and not by the bridge", "in_charge": "external"},
            "Taken over by an external pilot: armed, and not by the bridge (5 s ago)",
        ),
    ],
)
def test_what_ended_a_flight_stays_until_somebody_takes_note_of_it(fields: dict[str, Any], words: str) -> None:
    state = shown()
    state.update(1.0, topics.STATUS, FLIGHT.status(**(LOST | fields)))
    state.update(2.0, topics.STATUS, FLIGHT.status(**(LOST | fields | {"text": "landed and disarmed"})))
    standing(state, 5.0)
    assert state.notice(6.0) == words
    state.flight_end.take_note()
    standing(state, 7.0)
    assert state.notice(7.0) == ""


def test_a_failsafe_after_a_takeover_is_told_and_control_that_was_taken_back_ends_it() -> None:
    state = shown(0.0, **(LOST | {"in_charge": "external", "text": "taken over: by a switch"}))
    assert state.notice(0.0).startswith("Taken over")
    state.update(1.0, topics.STATUS, FLIGHT.status(**(LOST | {"text": "failsafe: low battery"})))
    assert state.notice(1.0) == "Ended by a failsafe: low battery (0 s ago)"
    state.update(2.0, topics.STATUS, FLIGHT.status())
    assert state.notice(2.0) == ""


def test_a_silent_bridge_is_a_lost_link_and_the_last_state_is_still_told() -> None:
    line = shown().status_line(4.0, "")
    assert (line["words"], line["tone"]) == ("Link lost", "lost")
    assert line["why"] == "The vehicle is silent for 4 s; its last state was: Hovering."
    assert line["charge"] == ""


def test_a_service_that_stopped_publishing_is_silent() -> None:
    state = ShownState()
    state.update(0.0, health_of("estimator"), health())
    assert state.services(1.0)[0]["state"] == "ok"
    assert state.services(5.0)[0]["state"] == "silent"


def test_the_trail_begins_again_in_a_new_epoch() -> None:
    state = shown()
    state.update(1.0, topics.STATUS, FLIGHT.at(5.0, 0.0, -3.0).status())
    assert state.trail() == [[1.0, 2.0, -3.0], [5.0, 0.0, -3.0]]
    restarted = Flight(position_m=(0.0, 0.0, 0.0), epoch_id=2)
    state.update(2.0, topics.STATUS, restarted.status())
    assert state.trail() == [[0.0, 0.0, 0.0]]


def test_a_vehicle_that_stands_adds_nothing_to_the_trail() -> None:
    state = shown(armed=False, landed=True, code=0, in_charge="none")
    assert state.trail() == []


def test_a_vehicle_that_is_lost_for_long_is_not_drawn() -> None:
    state = shown()
    assert state.scene(0.5)["vehicle"]["late"] is False
    assert state.scene(2.0)["vehicle"]["late"] is True
    assert state.scene(20.0)["vehicle"] is None


def test_events_tell_changes_once_and_the_newest_first() -> None:
    state = shown(0.0, code=0, armed=False, in_charge="none")
    state.update(1.0, topics.STATUS, FLIGHT.status(code=1, in_charge="goal", action="takeoff", goal_id="a"))
    state.update(2.0, topics.STATUS, FLIGHT.status(code=1, in_charge="goal", action="takeoff", goal_id="a"))
    state.update(3.0, topics.STATUS, FLIGHT.status(in_charge="failsafe", code=13))
    texts = [row["text"] for row in state.event_rows(3.0)]
    assert texts == [
        "Flying, failsafe",
        "In charge now: a failsafe of the autopilot",
        "Taking off",
        "Motors on",
        "Connected: On the ground, not checked",
    ]


def test_a_restarted_service_is_an_event() -> None:
    state = ShownState()
    state.update(0.0, health_of("vehicle_bridge"), health("vehicle_bridge"))
    state.update(1.0, health_of("vehicle_bridge"), health("vehicle_bridge", boot_id=2))
    assert [row["text"] for row in state.event_rows(1.0)] == ["vehicle bridge was restarted"]


@pytest.mark.parametrize("value", [None, nan, inf, -inf])
def test_a_value_that_is_absent_or_not_finite_is_a_dash(value: float | None) -> None:
    row = views.reading("speed", value, "m/s", 0.1)
    assert (row.text, row.unit, row.late) == ("–", "", True)


def test_no_reading_of_messages_full_of_nan_is_a_number() -> None:
    status = FLIGHT.at(nan, nan, nan).status(
        battery=Battery(voltage_v=nan, remaining=nan), wind_ned_mps=(nan, nan, nan)
    )
    assert status.odometry is not None
    broken = msgspec.structs.replace(
        status.odometry, vel_uav_ned_mps=(nan, nan, nan), q_ned_from_frd=(nan, nan, nan, nan), std_pos_m=nan
    )
    state = ShownState()
    state.update(0.0, topics.STATUS, msgspec.structs.replace(status, odometry=broken))
    state.update(0.0, topics.ALTIMETER, Altimeter(t_ns=0, range_m=nan))
    state.update(0.0, topics.RELATIVE, relative(pos_uav_rel_rover_ned_m=(nan, nan, nan), cov=(nan,) * 21))
    state.update(0.0, topics.ROVER_ESTIMATE, rover(vel_rover_ned_mps=(nan, nan, nan)))
    assert {row["text"] for row in state.readings(0.1)} == {"–"}
    scene = state.scene(0.1)
    assert (scene["vehicle"], scene["ellipsoid"], scene["wind_words"]) == (None, None, "unknown")
    msgspec.json.encode(scene)


def test_every_value_of_a_vehicle_that_went_silent_is_grey_and_has_its_age() -> None:
    state = shown()
    state.update(0.0, topics.ALTIMETER, Altimeter(t_ns=0, range_m=1.5))
    state.update(0.0, topics.RELATIVE, relative())
    state.update(0.0, topics.ROVER_ESTIMATE, rover())
    seen = [row for row in state.readings(2.0) if row["age"]]
    assert {row["age"] for row in seen} == {"2 s ago"}
    assert all(row["late"] for row in state.readings(2.0))


def test_where_the_vehicle_was_last_is_kept_when_its_link_is_lost() -> None:
    state = shown()
    assert state.scene(0.5)["lost"] is None
    assert state.scene(25.0)["lost"] == {"pos": [1.0, 2.0, -3.0], "age": "25 s ago"}


def test_the_places_of_the_images_are_those_of_the_newest_goal() -> None:
    state = ShownState()
    for number, goal_id in enumerate(("first", "second", "second")):
        state.update(0.0, topics.STATUS, FLIGHT.status(in_charge="goal", goal_id=goal_id))
        image = msgspec.structs.replace(IMAGE, index=number, pos_camera_ned_m=(float(number), 0.0, -4.0))
        feedback = ImagesFeedback(pos_uav_ned_m=(0.0, 0.0, -4.0), taken=1, planned=12, images=(image,))
        message = FeedbackMessage(t_ns=0, goal_id=goal_id, action="get_images", code=6, feedback=feedback)
        state.update(0.0, feedback_of(topics.GET_IMAGES), message)
    assert state.photos() == [[1.0, 0.0, -4.0], [2.0, 0.0, -4.0]]


def test_a_landing_in_charge_has_a_target_view_and_an_old_one_has_none() -> None:
    feedback = LandFeedback(pos_uav_ned_m=(0.0, 0.0, -3.0), pos_rel_ned_m=(0.3, 0.4, -3.0), phase="descent")
    message = FeedbackMessage(t_ns=0, goal_id="theirs", action="land_on_spot", code=8, feedback=feedback)
    state = shown(code=8, in_charge="goal", action="land_on_spot", goal_id="theirs")
    state.update(0.0, feedback_of(topics.LAND_ON_SPOT), message)
    assert state.landing(0.1) is not None
    state.update(0.2, topics.STATUS, FLIGHT.status(goal_id=""))
    assert state.landing(0.3) is None


def test_the_zones_of_the_fence_are_drawn_with_their_side() -> None:
    state = ShownState()
    assert state.fence() == []
    field = Zone(name="field", corners_ned_m=((0.0, 0.0), (9.0, 0.0), (9.0, 9.0)))
    crater = Zone(name="crater", corners_ned_m=((4.0, 1.0), (6.0, 1.0), (6.0, 3.0)))
    fence = Fence(keep_in=field, keep_out=(crater,))
    state.update(1.0, topics.FENCE, FenceState(t_ns=1, fence=fence, fence_id="1"))
    assert state.fence() == [
        {"name": "field", "keep_in": True, "corners": field.corners_ned_m},
        {"name": "crater", "keep_in": False, "corners": crater.corners_ned_m},
    ]
