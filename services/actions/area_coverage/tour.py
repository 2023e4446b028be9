"""The order in which the tracks are flown, and the end from which each is flown."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from jezero.services.actions.area_coverage.tracks import Track

Array = NDArray[np.float64]
TRIALS_MAX = 400


def order_tracks(tracks: Sequence[Track], start_m: Array | None) -> list[Array]:
    """Order the tracks so that the ways between them are short: nearest neighbour, then 2-opt.

    Distances are those of straight lines; the ways themselves are found later.
    """
    if not tracks:
        return []
    ends = _Ends(
        [np.array([way[0] for way in track.variants]) for track in tracks],
        [np.array([way[-1] for way in track.variants]) for track in tracks],
    )
    order = _nearest(ends, start_m)
    cost, chosen = _choose(order, ends, start_m)
    trials = 0
    improved = True
    while improved and trials < TRIALS_MAX:
        improved = False
        for i in range(len(order) - 1):
            for j in range(i + 1, len(order)):
                trial = order[:i] + order[i : j + 1][::-1] + order[j + 1 :]
                trial_cost, trial_chosen = _choose(trial, ends, start_m)
                trials += 1
                if trial_cost < cost - 1e-9:
                    order, cost, chosen, improved = trial, trial_cost, trial_chosen, True
            if trials >= TRIALS_MAX:
                break
    return [tracks[i].variants[variant] for i, variant in zip(order, chosen, strict=True)]


class _Ends:
    """Both ends of the variants of all tracks.

    Attributes:
        entries: for each track the (n, 2) begins of its variants.
        exits: for each track the (n, 2) ends of its variants.
    """

    def __init__(self, entries: list[Array], exits: list[Array]) -> None:
        self.entries = entries
        self.exits = exits
        self._gaps_m: dict[tuple[int, int], Array] = {}

    def gaps_m(self, before: int, after: int) -> Array:
        """Distances from the exits of one track, in rows, to the entries of another one; the trials repeat most."""
        gaps_m = self._gaps_m.get((before, after))
        if gaps_m is None:
            between = self.exits[before][:, None, :] - self.entries[after][None, :, :]
            gaps_m = self._gaps_m[before, after] = np.sqrt(np.einsum("ijk,ijk->ij", between, between))
        return gaps_m


def _nearest(ends: _Ends, start_m: Array | None) -> list[int]:
    entries, exits = ends.entries, ends.exits
    at = entries[0][0] if start_m is None else start_m
    left, order = set(range(len(entries))), []
    while left:
        distances = {i: np.linalg.norm(entries[i] - at, axis=1) for i in left}
        nearest = min(left, key=lambda i: (float(distances[i].min()), i))
        at = exits[nearest][int(np.argmin(distances[nearest]))]
        order.append(nearest)
        left.remove(nearest)
    return order


def _choose(order: list[int], ends: _Ends, start_m: Array | None) -> tuple[float, list[int]]:
    """The variants with the shortest ways between them for a given order, by dynamic programming."""
    first = ends.entries[order[0]]
    costs = np.zeros(len(first)) if start_m is None else np.linalg.norm(first - start_m, axis=1)
    froms: list[NDArray[np.intp]] = []
    for before, after in pairwise(order):
        total = costs[:, None] + ends.gaps_m(before, after)
        nearest = total.argmin(axis=0)
        froms.append(nearest)
        costs = total[nearest, np.arange(total.shape[1])]
    chosen = [int(np.argmin(costs))]
    for back in reversed(froms):
        chosen.append(int(back[chosen[-1]]))
    return float(costs.min()), chosen[::-1]
