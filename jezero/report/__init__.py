"""What a flight leaves behind: its log, and plots that people can read."""

from jezero.base.extras import require

require("jezero.report", "matplotlib", "numpy")
