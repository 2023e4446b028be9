"""What people read has no code names, numbers of states or ids."""

import pytest

from jezero.schemas.state import STATUS_WORDS, StatusCode
from jezero.services.ground_station.words import in_words


@pytest.mark.parametrize(
    ("sentence", "words"),
    [
        ("land_on_spot: $.altitude_m is 9000", "land on spot: altitude is 9000"),
        ("landing_spot_ned_m is needed without use_uwb", "landing spot is needed without use uwb"),
        ("canceled by another client, py-0123456789ab", "canceled by another client"),
        ("it was switched to AUTO.LAND (low battery)", "it was switched to land mode (low battery)"),
        ("its arming checks don't pass yet in mode AUTO.LOITER", "its arming checks don't pass yet in hold mode"),
        ("taken over: switched to POSCTL", "taken over: switched to position mode"),
        ("see /var/my_runs/flight_1.mcap", "see /var/my_runs/flight_1.mcap"),
        ("target z = 3 m is too low: NED counts down, 5 m up is −5", "target height -3 m is too low"),
        ("set JEZERO_ROUTER", "set JEZERO_ROUTER"),
    ],
)  # fmt: skip
def test_a_sentence_of_the_stack_is_shown_in_words(sentence: str, words: str) -> None:
    assert in_words(sentence) == words


def test_each_state_has_words() -> None:
    assert set(STATUS_WORDS) == set(StatusCode)
