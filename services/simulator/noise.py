"""Seeded random numbers, one stream per name, and a slowly varying error."""

import zlib
from collections.abc import Callable, Iterator
from math import exp, sqrt

import numpy as np

BLOCK = 1024


def generator(seed: int, name: str) -> np.random.Generator:
    """The generator that belongs to a seed and a name; streams of different names are independent."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, zlib.crc32(name.encode())])))


Normals = Callable[[], float]
"""Standard normal numbers one at a time."""


def normals_of(rng: np.random.Generator) -> Normals:
    """Standard normal numbers, drawn in blocks, which is ten times faster than one by one."""
    return _stream(rng).__next__


def _stream(rng: np.random.Generator) -> Iterator[float]:
    while True:
        yield from rng.standard_normal(BLOCK).tolist()


class Wander:
    """First-order Gauss–Markov process: a random constant at the start, with the time constant `tau_s`.

    Discretised exactly, so that its standard deviation is `std` at every instant and any `dt_s`.
    """

    def __init__(self, std: float, tau_s: float, dt_s: float, normals: Normals) -> None:
        self.value = std * normals()
        self._keep = exp(-dt_s / tau_s)
        self._std_step = std * sqrt(1.0 - self._keep * self._keep)
        self._normals = normals

    def step(self) -> float:
        """Advance by `dt_s`."""
        self.value = self._keep * self.value + self._std_step * self._normals()
        return self.value
