"""Spec §3's table of transitions, with the codes 14 and 15 of packages' actions: every row, and no other."""

from contextlib import nullcontext
from itertools import product

import pytest

from jezero.schemas.commands import Phase
from jezero.schemas.state import StatusCode
from jezero.services.vehicle_bridge.admission import CODE_OF, TransitionError, completed, is_allowed, require

SPEC = (
    [(0, 1), (1, 2), (2, 3), (1, 4)]
    + [(3, code) for code in (4, 6, 8, 10, 14)]
    + [(4, 5), (6, 7), (10, 11), (14, 15), (5, 3), (7, 3), (11, 3), (15, 3)]
    + [(8, 9), (9, 0)]
    + [(code, 12) for code in (1, 4, 6, 8, 10, 14)]
    + [(12, 3), (12, 0)]
    + [(code, 13) for code in range(16) if code != 13]
    + [(13, 0), (13, 3)]
)


@pytest.mark.parametrize(("before", "after"), list(product(range(16), range(16))))
def test_a_transition_is_allowed_exactly_when_the_specification_names_it(before: int, after: int) -> None:
    assert is_allowed(StatusCode(before), StatusCode(after)) == ((before, after) in SPEC)
    with nullcontext() if (before, after) in SPEC else pytest.raises(TransitionError):
        require(StatusCode(before), StatusCode(after))


def test_every_phase_has_a_code_and_the_next_one_says_that_it_is_done() -> None:
    assert {phase: int(completed(CODE_OF[phase])) for phase in Phase} == {
        Phase.TAKEOFF: 2,
        Phase.GO_TO: 5,
        Phase.GET_IMAGES: 7,
        Phase.LANDING: 9,
        Phase.COVERAGE: 11,
        Phase.ACTION: 15,
    }
