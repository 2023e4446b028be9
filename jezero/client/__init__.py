"""The Python SDK: needs only zenoh, msgspec and cryptography."""

from jezero.client.errors import Aborted, Canceled, JezeroError, Refused, TimedOut, Unreachable
from jezero.client.goal import Goal
from jezero.client.vehicle import Vehicle

__all__ = ["Aborted", "Canceled", "Goal", "JezeroError", "Refused", "TimedOut", "Unreachable", "Vehicle"]
