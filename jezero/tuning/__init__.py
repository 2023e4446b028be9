"""Tuning of the estimator: its innovations in recorded flights, and the noise settings that fit them."""

from jezero.base.extras import require

require("jezero.tuning", "scipy", "mcap", "numpy")
