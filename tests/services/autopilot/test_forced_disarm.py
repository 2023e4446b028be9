"""Who may stop the motors in the air over the link of ground stations: the rule alone."""

import pytest

from jezero.services.autopilot.forced_disarm import ForcedDisarmRule


@pytest.mark.parametrize(
    ("listed", "on_ground", "system", "refusal"),
    [
        ((), (255,), 255, ""),
        ((), (255,), 252, "MAVLink system 252 sent nothing before the takeoff"),
        ((), (), 1, "MAVLink system 1 sent nothing before the takeoff"),
        ((245,), (255,), 245, ""),
        ((245,), (255,), 255, "MAVLink system 255 is not in force_disarm_systems"),
    ],
)
def test_listed_systems_may_and_without_a_list_those_that_were_there_before_the_takeoff(
    listed: tuple[int, ...], on_ground: tuple[int, ...], system: int, refusal: str
) -> None:
    rule = ForcedDisarmRule(listed)
    for each in on_ground:
        rule.on_message_on_ground(each)
    assert rule.refusal(system) == refusal


def test_a_flood_of_denied_commands_is_one_line_in_the_log_of_a_flight(capfd: pytest.CaptureFixture[str]) -> None:
    rule = ForcedDisarmRule(())
    for _ in range(3):
        rule.log("by system 252")
    rule.on_message_on_ground(255)
    rule.log("by system 252")
    assert capfd.readouterr().err == "by system 252\n" * 2
