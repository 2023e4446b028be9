"""Replays of recordings: their messages on a bus again, or a recorded service, made again, on its recorded inputs."""

from jezero.base.extras import require

require("jezero.replay", "mcap", "numpy")

NAME = "replay"
"""Name under which a replay on a bus is alive there and publishes its health, as services do."""
