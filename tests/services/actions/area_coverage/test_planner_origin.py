"""An area in degrees is flown only by a vehicle that has the origin around which the client placed the area."""

from math import nan

import msgspec
import pytest

from jezero.base.frames import Vec3, geodetic_from_ned
from jezero.schemas.goals import AreaCoverageGoal
from jezero.schemas.state import Odometry, Status
from jezero.services.actions.area_coverage.planner import AreaCoveragePlanner
from jezero.services.actions.config import ActionsConfig
from jezero.services.actions.motion.behaviour import Plan, Refusal
from tests.services.actions.test_behaviours import a_status

ORIGIN_DEG = (47.397742, 8.545594, 488.0)
GOAL = AreaCoverageGoal(
    polygon_ned_m=((0.0, 0.0), (0.0, 20.0), (20.0, 20.0), (20.0, 0.0)), z_ned_m=-5.0, resolution_m=2.0
)


def status_of(origin_deg: Vec3 | None) -> Status:
    """Status of a vehicle whose autopilot has this origin."""
    odometry = Odometry(
        t_ns=0,
        epoch_id=1,
        pos_uav_ned_m=(0.0, 0.0, -3.0),
        vel_uav_ned_mps=(0.0, 0.0, 0.0),
        q_ned_from_frd=(1.0, 0.0, 0.0, 0.0),
        rates_uav_frd_rps=(0.0, 0.0, 0.0),
        origin_deg=origin_deg,
    )
    return msgspec.structs.replace(a_status(3), odometry=odometry)


def plan(status: Status, *around: float) -> Plan | Refusal:
    """Plan or refusal of an area that was placed around a latitude and longitude, or of one in metres."""
    config = ActionsConfig()
    goal = GOAL if not around else msgspec.structs.replace(GOAL, origin_deg=around)
    return AreaCoveragePlanner(config).plan(goal, status)


def reason(status: Status, *around: float) -> str:
    refusal = plan(status, *around)
    assert isinstance(refusal, Refusal)
    return refusal.reason


def test_an_area_that_was_placed_around_another_origin_is_refused_with_both_and_their_distance() -> None:
    """A thousandth of a degree of latitude is 111.2 m on PX4's sphere."""
    assert reason(status_of(ORIGIN_DEG), 47.398742, 8.545594) == (
        "the area was placed around the origin 47.3987420, 8.5455940, and the vehicle's is at 47.3977420, 8.5455940, "
        "111 m away: place it again around the vehicle's origin, which `jezero status` shows"
    )


@pytest.mark.parametrize(("north_m", "flown"), [(0.0, True), (0.9, True), (1.1, False), (20_000_000.0, False)])
def test_origins_may_differ_by_less_than_gnss_does(north_m: float, flown: bool) -> None:
    latitude_deg, longitude_deg, _ = geodetic_from_ned((north_m, 0.0, 0.0), ORIGIN_DEG)
    assert isinstance(plan(status_of(ORIGIN_DEG), latitude_deg, longitude_deg), Plan if flown else Refusal)


def test_origins_on_both_sides_of_the_date_line_are_near_each_other() -> None:
    assert isinstance(plan(status_of((-17.0, 179.999999, 0.0)), -17.0, -179.999999), Plan)


@pytest.mark.parametrize("status", [a_status(3), status_of(None)], ids=["no odometry", "no origin"])
def test_an_area_in_degrees_waits_for_the_vehicles_origin(status: Status) -> None:
    assert reason(status, 47.397742, 8.545594).startswith(
        "the area is in degrees, and the vehicle's autopilot has not sent its origin yet: wait"
    )


@pytest.mark.parametrize("status", [a_status(3), status_of(None), status_of(ORIGIN_DEG)])
def test_an_area_in_metres_needs_no_origin(status: Status) -> None:
    assert isinstance(plan(status), Plan)


def test_an_origin_without_numbers_is_refused() -> None:
    assert isinstance(plan(status_of(ORIGIN_DEG), nan, nan), Refusal)
