"""Units that every layer shares."""

NS_PER_S = 1_000_000_000
"""Nanoseconds per second: all times on the bus are integers in ns."""
GRAVITY_MPS2 = 9.81
"""The Earth's gravity, which PX4 assumes too; vehicle and simulator fly in it."""
