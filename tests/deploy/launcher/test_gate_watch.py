"""The gate is started anew where a link is up and passes nothing, and left alone otherwise."""

from jezero.deploy.launcher.gate_watch import RESTART_PERIOD_MIN_S, SILENT_MAX_S, GateWatch
from jezero.schemas.health import GateLinks

OWN, OTHER = "aa", "bb"
PROCESS = "uav pid 7"
STEP_S = 0.5


def links(gate: str, *linked: str) -> GateLinks:
    return GateLinks(t_ns=0, gate=gate, process=PROCESS if gate == OWN else "ground pid 7", linked=linked)


def watch(beats: tuple[GateLinks, ...], replies: tuple[GateLinks, ...], for_s: float, watch: GateWatch) -> list[str]:
    """Problems within a time in which these beats and replies arrive twice a second."""
    problems = []
    for step in range(int(for_s / STEP_S)):
        now_s = 100.0 + step * STEP_S
        for beat in beats:
            watch.on_beat(beat, now_s, is_reply=False)
        for reply in replies:
            watch.on_beat(reply, now_s, is_reply=True)
        problems.append(watch.problem(PROCESS, 100.0, now_s))
    return [problem for problem in problems if problem]


def test_links_that_pass_and_a_gate_without_links_are_left_alone() -> None:
    both = (links(OWN, OTHER), links(OTHER, OWN))
    assert watch(both, both, 60.0, GateWatch()) == []
    alone = (links(OWN),)
    assert watch(alone, alone, 60.0, GateWatch()) == []


def test_a_link_without_beats_or_without_replies_is_named() -> None:
    own, both = (links(OWN, OTHER),), (links(OWN, OTHER), links(OTHER, OWN))
    assert watch(own, both, SILENT_MAX_S + 1.0, GateWatch()) == [
        f"the link with the gate {OTHER} is up and brings no beats for 4 s"
    ]
    assert watch(both, own, SILENT_MAX_S + 1.0, GateWatch()) == [
        f"the link with the gate {OTHER} is up and brings no replies for 4 s"
    ]


def test_a_gate_that_is_not_heard_at_all_is_named() -> None:
    assert watch((), (), SILENT_MAX_S + 1.0, GateWatch()) == ["the gate itself is up and brings no beats for 4 s"]


def test_a_gate_that_begins_anew_in_the_same_process_is_not_missed_before_its_first_reply() -> None:
    watched, own = GateWatch(), links(OWN)
    assert watch((own,), (own,), 20.0, watched) == []
    anew = GateLinks(t_ns=0, gate="cc", process=PROCESS, linked=())
    for is_reply in (False, True):
        watched.on_beat(anew, 120.0, is_reply=is_reply)
        assert watched.problem(PROCESS, 100.0, 120.0) == ""


def test_a_link_that_has_ended_is_not_missed() -> None:
    watched = GateWatch()
    both = (links(OWN, OTHER), links(OTHER, OWN))
    assert watch(both, both, 10.0, watched) == []
    alone = (links(OWN),)
    assert watch(alone, alone, 60.0, watched) == []


def test_restarts_that_do_not_help_become_rarer() -> None:
    own = (links(OWN, OTHER),)
    problems = watch(own, own, 10 * RESTART_PERIOD_MIN_S, GateWatch())
    assert len(problems) == 4  # after 4, 24, 64 and 144 s
