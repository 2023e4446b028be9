"""Recordings of flights: MCAP files of all messages, which Foxglove, PlotJuggler and this package read."""

from jezero.base.extras import require

require("jezero.recording", "mcap", "numpy")

from jezero.recording.goals import RecordedGoal
from jezero.recording.mcap_file import RecordingError
from jezero.recording.reader import Entry, Recording, Summary, open_recording
from jezero.recording.table import Table

__all__ = ["Entry", "RecordedGoal", "Recording", "RecordingError", "Summary", "Table", "open_recording"]
