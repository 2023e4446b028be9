"""The plots of a whole flight."""

from types import SimpleNamespace

from jezero.report.plots import WORDS, code_spans, upwards
from jezero.schemas.state import StatusCode


def test_every_status_code_has_words_for_its_plot() -> None:
    assert set(WORDS) == set(StatusCode)


def test_a_climb_goes_up_in_the_plot_of_the_position() -> None:
    assert upwards((1.0, 2.0, -3.0)) == (1.0, 2.0, 3.0)


def test_a_code_of_one_message_is_a_span_until_the_next() -> None:
    codes = [0, 0, 1, 1, 2, 3, 3, 0]
    status = [SimpleNamespace(t_ns=i * 100_000_000, code=code) for i, code in enumerate(codes)]
    expected = [(0, 0.0, 0.2), (1, 0.2, 0.4), (2, 0.4, 0.5), (3, 0.5, 0.7), (0, 0.7, 0.7)]
    assert code_spans(status) == expected
