"""Short messages over the page."""

from nicegui import ui

from jezero.services.ground_station.words import Tone, in_words

KINDS = {"good": "positive", "plain": "info", "warning": "warning", "bad": "negative"}
TIMEOUT_MS = 6000


def show_toast(tone: Tone, text: str) -> None:
    """Show a message at the bottom, where neither the state nor the buttons that stop the vehicle are."""
    ui.notify(in_words(text), type=KINDS[tone], position="bottom", timeout=TIMEOUT_MS, multi_line=True)  # type: ignore[arg-type]
