"""Which inputs are selected, by the parameters and by the lease of a goal."""

import pytest

from jezero.base.frames import Vec3
from jezero.schemas.estimate import Lease, SetParameters
from jezero.schemas.units import NS_PER_S
from jezero.services.estimator.config import Tuning
from jezero.services.estimator.selection import InputSelection

BEGIN_NS = 10 * NS_PER_S
PLACE_M: Vec3 = (1.0, 2.0, 0.0)


def leased(goal_id: str = "land-1", *, uwb: bool = True, tag: bool = False, pos_ned_m: Vec3 | None = None) -> Lease:
    return Lease(goal_id=goal_id, use_uwb=uwb, use_tag=tag, pos_rover_ned_m=pos_ned_m)


def test_a_refused_lease_says_how_long_the_other_goal_holds_it() -> None:
    selection = InputSelection(Tuning())
    assert selection.lease(BEGIN_NS, leased("first")).until_t_ns == BEGIN_NS + 3 * NS_PER_S
    for passed_s, left in ((0, "3.0"), (2, "1.0"), (4, "0.0")):
        reply = selection.lease(BEGIN_NS + passed_s * NS_PER_S, leased("second"))
        assert not reply.accepted
        assert reply.reason == f"goal first holds the lease for {left} s more"


def test_a_lease_ends_three_seconds_after_its_last_renewal() -> None:
    selection = InputSelection(Tuning())
    for passed_s in (0, 2):
        assert selection.lease(BEGIN_NS + passed_s * NS_PER_S, leased()).accepted
    selection.expire(BEGIN_NS + 5 * NS_PER_S - 1)
    assert (selection.goal_id, selection.use_uwb, selection.use_tag) == ("land-1", True, False)
    selection.expire(BEGIN_NS + 5 * NS_PER_S)
    assert (selection.goal_id, selection.use_uwb, selection.use_tag) == ("", True, True)


def test_a_release_by_another_goal_is_accepted_and_leaves_the_lease() -> None:
    selection = InputSelection(Tuning())
    selection.lease(BEGIN_NS, leased("first"))
    release = Lease(goal_id="second", use_uwb=True, use_tag=True, release=True)
    assert selection.lease(BEGIN_NS, release).accepted
    assert selection.goal_id == "first"
    assert selection.lease(BEGIN_NS, Lease(goal_id="first", use_uwb=True, use_tag=True, release=True)).accepted
    assert selection.goal_id == ""


def test_a_lease_without_an_input_is_refused_with_the_reason_and_changes_nothing() -> None:
    selection = InputSelection(Tuning())
    reply = selection.lease(BEGIN_NS, leased(uwb=False, tag=False))
    assert not reply.accepted
    assert reply.reason == "neither use_uwb nor use_tag: there is nothing to lease"
    assert selection.goal_id == ""


@pytest.mark.parametrize(("uwb", "tag"), [(True, False), (False, True), (True, True)])
def test_a_lease_selects_its_own_inputs_whatever_the_parameters_say(uwb: bool, tag: bool) -> None:
    selection = InputSelection(Tuning(use_uwb=not uwb, use_tag=not tag))
    selection.lease(BEGIN_NS, leased(uwb=uwb, tag=tag))
    assert (selection.use_uwb, selection.use_tag) == (uwb, tag)
    selection.end_lease()
    assert (selection.use_uwb, selection.use_tag) == (not uwb, not tag)


def test_the_position_of_a_lease_counts_before_that_of_the_parameters_and_a_renewal_keeps_it() -> None:
    selection = InputSelection(Tuning())
    selection.set(SetParameters(pos_rover_ned_m=(9.0, 9.0, 0.0)))
    assert selection.prior_pos_rover_ned_m == (9.0, 9.0, 0.0)
    selection.lease(BEGIN_NS, leased(pos_ned_m=PLACE_M))
    selection.lease(BEGIN_NS, leased(pos_ned_m=(7.0, 7.0, 0.0)))
    assert selection.prior_pos_rover_ned_m == PLACE_M
    selection.end_lease()
    selection.lease(BEGIN_NS, leased())
    assert selection.prior_pos_rover_ned_m == (9.0, 9.0, 0.0)


def test_the_version_counts_the_changes_of_parameters_and_not_the_refused_and_empty_requests() -> None:
    selection = InputSelection(Tuning())
    assert selection.set(SetParameters(std_uwb_m=0.5)).version == 1
    assert selection.set(SetParameters(use_tag=False, std_altimeter_m=0.1)).version == 2
    assert selection.set(SetParameters()).version == 2
    refused = selection.set(SetParameters(std_uwb_m=20.0, std_altimeter_m=0.3))
    assert (refused.accepted, refused.version, refused.parameters) == (False, 2, None)
    assert (selection.tuning.std_uwb_m, selection.tuning.use_tag, selection.tuning.std_altimeter_m) == (0.5, False, 0.1)


@pytest.mark.parametrize(("std_m", "accepted"), [(0.0009, False), (0.001, True), (10.0, True), (10.1, False)])
def test_a_parameter_may_have_its_least_and_its_greatest_value(std_m: float, accepted: bool) -> None:
    reply = InputSelection(Tuning()).set(SetParameters(std_uwb_m=std_m))
    assert reply.accepted is accepted
    assert reply.reason == ("" if accepted else f"std_uwb_m = {std_m:g} is not within 0.001 to 10")


def test_the_position_of_the_rover_stays_when_another_parameter_is_set() -> None:
    selection = InputSelection(Tuning())
    selection.set(SetParameters(pos_rover_ned_m=PLACE_M))
    reply = selection.set(SetParameters(std_uwb_m=0.5))
    assert reply.parameters is not None
    assert (reply.parameters.pos_rover_ned_m, reply.parameters.std_uwb_m) == (PLACE_M, 0.5)
