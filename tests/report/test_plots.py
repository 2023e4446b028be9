"""The plots of a whole flight."""

from jezero.report.plots import WORDS
from jezero.schemas.state import StatusCode


def test_every_status_code_has_words_for_its_plot() -> None:
    assert set(WORDS) == set(StatusCode)
