"""The plots of a whole flight."""

from jezero.report.plots import WORDS, upwards
from jezero.schemas.state import StatusCode


def test_every_status_code_has_words_for_its_plot() -> None:
    assert set(WORDS) == set(StatusCode)


def test_a_climb_goes_up_in_the_plot_of_the_position() -> None:
    assert upwards((1.0, 2.0, -3.0)) == (1.0, 2.0, 3.0)
