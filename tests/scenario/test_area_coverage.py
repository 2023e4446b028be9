"""A coverage in wind, in virtual time, through all services: tracked as required, and aborted at once."""

import pytest

from benchmarks.quality.coverage import measure
from benchmarks.quality.covering import Covering
from jezero.schemas import topics
from jezero.schemas.actions import Rejected, Result
from jezero.schemas.commands import Abort
from jezero.schemas.goals import AreaCoverageGoal
from jezero.schemas.state import StatusCode

SQUARE = ((0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0))


@pytest.mark.long
def test_a_coverage_in_wind_stays_on_its_path_and_takes_its_pictures() -> None:
    figures = measure(seed=2, resolution_m=0.5, polygon_ned_m=SQUARE)
    assert figures.across_m <= 0.05
    assert figures.height_m <= 0.05
    assert figures.place_m <= 0.06
    assert abs(figures.pictures - figures.pictures / figures.pictures_per_length) <= 1.0
    assert figures.covered >= 0.99 and figures.flown_covered >= 0.95


def test_an_abort_is_obeyed_at_once_while_a_coverage_is_planned_and_while_it_flies() -> None:
    flight = Covering(seed=3, rendered=False)
    flight.climb()
    goal = AreaCoverageGoal(polygon_ned_m=SQUARE, z_ned_m=-4.0, resolution_m=0.5)
    planning = flight.bus.send_request(topics.AREA_COVERAGE.endpoint, goal)
    flight.bus.run_for(0.3)
    abort = flight.bus.send_request(topics.ABORT, Abort())
    assert flight.bus.run_for(0.1, lambda: abort.ended)
    assert flight.bus.run_for(3.0, lambda: planning.ended)
    assert isinstance(planning.replies[-1], Rejected) and "before the last abort" in planning.replies[-1].reason
    flying = flight.bus.send_request(topics.AREA_COVERAGE.endpoint, goal)
    flight.bus.run_for(20.0, lambda: flight.mapping_ns is not None)
    assert flight.mapping_ns is not None and not flying.ended
    flight.bus.run_for(1.0)
    flight.bus.send_request(topics.ABORT, Abort(reason="enough"))
    assert flight.bus.run_for(
        0.2, lambda: flight.status is not None and flight.status.code in (StatusCode.ABORT, StatusCode.HOVER)
    )
    assert flight.bus.run_for(1.0, lambda: flying.ended)
    result = flying.replies[-1]
    assert isinstance(result, Result) and result.outcome == "aborted" and "enough" in result.reason
    assert result.result is not None and result.result.resume is not None
    assert result.result.resume.first_picture == len(result.result.images)
