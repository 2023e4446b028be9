"""Units that every layer shares."""

NS_PER_S = 1_000_000_000
"""Nanoseconds per second: all times on the bus are integers in ns."""
