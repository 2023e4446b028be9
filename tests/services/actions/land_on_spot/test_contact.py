"""A contact that slides or leans becomes a go-around; too many of them, or too much wind, end the landing."""

from math import cos, degrees, radians, sin

import msgspec
import pytest

from jezero.frames import Quat
from jezero.schemas.units import NS_PER_S
from jezero.services.actions.land_on_spot.contact import (
    LEAN_S,
    PUSH_ACC_MPS2,
    ContactWatcher,
    GoArounds,
    OnSurface,
    foot_drop_m,
    level_acc_ned_mps2,
)
from jezero.services.actions.motion.behaviour import VehicleState
from jezero.vehicle_config import AirframeConfig

ROOM_M = 0.3
LEVEL: Quat = (1.0, 0.0, 0.0, 0.0)
CENTRED = OnSurface((0.0, 0.0), (0.0, 0.0))


def rolled(angle_deg: float) -> Quat:
    return (cos(radians(angle_deg) / 2.0), sin(radians(angle_deg) / 2.0), 0.0, 0.0)


def state_with(q_ned_from_frd: Quat = LEVEL) -> VehicleState:
    return VehicleState((0.0, 0.0, -1.0), (0.0, 0.0, 0.0), q_ned_from_frd, armed=True, landed=False)


def problem(surface: OnSurface | None, q_ned_from_frd: Quat = LEVEL, after_s: float = 0.1) -> str:
    watcher = ContactWatcher(ROOM_M)
    watcher.begin(0, (0.0, 0.0))
    return watcher.update(int(after_s * NS_PER_S), surface, state_with(q_ned_from_frd))


@pytest.mark.parametrize(
    ("offset_m", "outward_mps", "slides"),
    [
        (0.0, 0.0, False),
        (0.2, 0.4, True),  # 0.2 + 0.3 · 0.4 = 0.32 m, beyond 0.3 m
        (0.2, 0.3, False),  # 0.29 m
        (0.4, 0.1, False),  # slower than the noise of the estimate
        (0.4, -0.5, False),  # comes back
    ],
)
def test_a_vehicle_that_is_about_to_leave_its_place_slides(offset_m: float, outward_mps: float, slides: bool) -> None:
    assert (problem(OnSurface((offset_m, 0.0), (outward_mps, 0.0))) == "slides") is slides


def test_an_uncertain_offset_counts_as_much_nearer_to_the_middle() -> None:
    assert problem(OnSurface((0.25, 0.0), (0.4, 0.0))) == "slides"
    assert problem(OnSurface((0.25, 0.0), (0.4, 0.0), std_m=0.1)) == ""


@pytest.mark.parametrize(("tilt_deg", "leans"), [(15.0, False), (30.0, True), (50.0, True), (90.0, False)])
def test_a_vehicle_leans_when_it_is_tilted_more_than_a_slope_tilts_it_but_can_still_climb(
    tilt_deg: float, leans: bool
) -> None:
    assert (problem(CENTRED, rolled(tilt_deg), after_s=LEAN_S + 0.1) == "leans") is leans


def test_a_short_tilt_is_the_way_to_four_feet() -> None:
    assert problem(CENTRED, rolled(30.0), after_s=LEAN_S - 0.1) == ""


def test_without_a_measured_place_only_the_tilt_counts() -> None:
    assert problem(None) == ""
    assert problem(None, rolled(30.0), after_s=LEAN_S + 0.1) == "leans"


def test_the_thrust_goes_down_only_after_the_touchdown_and_the_tilt_against_the_wind_with_it() -> None:
    watcher = ContactWatcher(ROOM_M)
    watcher.begin(0, (0.1, 0.0))
    assert watcher.push_acc_ned_mps2(0.4) == (0.0, 0.0, 0.0)
    north_mps2, east_mps2, down_mps2 = watcher.push_acc_ned_mps2(0.1)
    assert down_mps2 == PUSH_ACC_MPS2
    assert north_mps2 == pytest.approx(9.81 * 0.1 / (1.0 - 0.01) ** 0.5) == level_acc_ned_mps2((0.1, 0.0))[0]
    assert east_mps2 == 0.0


def test_a_rolled_vehicle_has_one_side_of_its_feet_lower() -> None:
    airframe = AirframeConfig()
    _, right_m = airframe.feet_frd_m
    expected_m = right_m * sin(radians(10.0)) + airframe.height_stand_m * (cos(radians(10.0)) - 1.0)
    assert foot_drop_m(LEVEL, airframe) == pytest.approx(0.0)
    assert foot_drop_m(rolled(10.0), airframe) == pytest.approx(expected_m)


def test_a_landing_ends_after_the_last_go_around_and_names_the_slope_or_the_wind() -> None:
    go_arounds = GoArounds(1)
    leaning = state_with(rolled(degrees(0.3)))
    go_arounds.begin(0, "leans", leaning)
    assert not go_arounds.is_high(NS_PER_S, 1.0)
    assert go_arounds.is_high(NS_PER_S, 1.6)
    assert go_arounds.abort_reason(leaning) == ""
    go_arounds.begin(NS_PER_S, "leans", leaning)
    assert "tilted by 17 degrees on what it touched, in spite of 1 go-arounds" in go_arounds.abort_reason(leaning)
    go_arounds.begin(NS_PER_S, "slides", leaning)
    windy = msgspec.structs.replace(leaning, wind_ned_mps=(6.0, 8.0, 0.0), std_gust_mps=2.0)
    assert "the wind is 10.0 m/s with gusts to 12.0 m/s" in go_arounds.abort_reason(windy)
