"""The choice of the image that shows each cell of the map.

Each cell shows one image: the one that looks most steeply down on it, unless what it shows moved (most images show
something else there), and such that neighbouring cells of two images look the same on both sides of the seam between
them. So seams go around what stands on the ground, and it comes from one image as a whole.

The choice minimizes a sum of costs of cells and seams by expansions, each a minimum cut of a graph.
Source: Boykov, Veksler and Zabih 2001, Fast approximate energy minimization via graph cuts; the cost of seams is
that of Agarwala et al. 2004, Interactive digital photomontage.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
import scipy.sparse
from numpy.typing import NDArray
from scipy.sparse.csgraph import breadth_first_order, maximum_flow

from jezero.mapping.projection import CELL_PX, Field, Patch, Place

Labels = NDArray[np.int32]
"""Number of the image that each cell shows; -1 where no image shows the ground."""
SLANT_COST = 30.0
"""Of a cell that is seen at 45°, in levels of brightness as all costs. Grows with the squared tangent."""
EDGE_COST = 20.0
"""Of a cell of which the image shows nothing but an edge."""
MOVED_COST = 60.0
MOVED_LEVELS = 10.0
"""A cell that differs by more from what most images show is of a thing that moved, e.g. the vehicle's shadow."""
SEAM_COST = 1.0
"""Of a seam between two cells that look the same in both images."""
SEAM_UNKNOWN_COST = 15.0
"""Of a seam beyond which one of the images shows nothing."""
TALL_LEVELS = 5.0
"""Where at least half of the images differ by more from the middle one, something stands on the ground."""
TALL_COST_PER_LEVEL = 2.0
"""Of a seam through it, because each image shows it elsewhere, also where both show the same colour."""
TALL_GAP_CELLS = 9
"""A part of it in which the images happen to agree is smaller than this."""
SWEEPS = 2
BLOCK = 64
CAPACITY_PER_LEVEL = 16
NEIGHBOURS = ((0, 1), (1, 0))


@dataclass
class SeamView:
    """An image's part of the map in cells.

    Attributes:
        place: rows and columns of cells.
        colours: (h, w, 3) mean colours; NaN where the image shows nothing.
        costs: (h, w) costs of the cells; infinite where the image shows nothing.
    """

    place: Place
    colours: Field
    costs: Field = field(repr=False)


def view_of(patch: Patch) -> SeamView:
    """Reduce a patch to cells."""
    rows, columns = (part.stop // CELL_PX - part.start // CELL_PX for part in patch.place)
    place = tuple(slice(part.start // CELL_PX, part.stop // CELL_PX) for part in patch.place)

    def reduced(values: NDArray[np.uint8] | Field) -> Field:
        return np.asarray(cv2.resize(values, (columns, rows), interpolation=cv2.INTER_AREA), np.float32)

    share = reduced(patch.seen.astype(np.float32))
    colours = reduced((patch.colours * patch.seen[:, :, None]).astype(np.float32))
    shown = share > 0.0
    colours[shown] /= share[shown][:, None]
    colours[~shown] = np.nan
    costs = SLANT_COST * reduced(patch.slant2) + EDGE_COST * (1.0 - share)
    costs[~shown] = np.inf
    return SeamView((place[0], place[1]), colours, costs)


def choose_images(views: Sequence[SeamView], shape: tuple[int, int]) -> Labels:
    """Choose the image of each cell.

    Args:
        views: the images; their costs are changed.
        shape: rows and columns of cells of the map.
    """
    state = _State(views, shape, _add_costs_of_moved(views, shape))
    for _ in range(SWEEPS):
        changed = sum(state.expand(number) for number in range(len(views)))
        if changed == 0:
            break
    return state.labels


def _add_costs_of_moved(views: Sequence[SeamView], shape: tuple[int, int]) -> Field:
    """Add costs to cells that differ from what most images show; returns the cost of seams where most differ.

    Of two images that differ the lighter one is right: what moves is mostly the vehicle's shadow. Where images differ
    all over, as on something tall, none of them is wrong.
    """
    spread = np.zeros(shape, np.float32)
    for top in range(0, shape[0], BLOCK):
        for left in range(0, shape[1], BLOCK):
            block = (slice(top, min(top + BLOCK, shape[0])), slice(left, min(left + BLOCK, shape[1])))
            shown = [(view, *common) for view in views if (common := common_part(view.place, block)) is not None]
            if len(shown) < 2:
                continue
            stack = np.full((len(shown), block[0].stop - top, block[1].stop - left, 3), np.nan, np.float32)
            for layer, (view, in_view, in_block) in zip(stack, shown, strict=True):
                layer[in_block] = view.colours[in_view]
            moved, spread[block] = _moved(stack)
            for layer, (view, in_view, in_block) in zip(moved, shown, strict=True):
                view.costs[in_view] += MOVED_COST * layer[in_block]
    whole = cv2.morphologyEx(spread, cv2.MORPH_CLOSE, np.ones((TALL_GAP_CELLS, TALL_GAP_CELLS), np.uint8))
    return np.asarray(TALL_COST_PER_LEVEL * np.maximum(whole - TALL_LEVELS, 0.0), np.float32)


def _moved(stack: Field) -> tuple[Field, Field]:
    """How sure it is that each image's cell shows something that moved, and how much the images differ.

    Args:
        stack: (n, h, w, 3) colours of n images.
    Returns:
        (n, h, w) between 0 and 1, and (h, w) median of the differences from the middle image.
    """
    light = np.nan_to_num(stack.mean(axis=3), nan=np.inf)
    count = np.isfinite(light).sum(axis=0)
    order = np.argsort(light, axis=0)
    middle = np.take_along_axis(order, np.minimum(count // 2, np.maximum(count - 1, 0))[None], axis=0)
    reference = np.take_along_axis(stack, middle[..., None], axis=0)
    departure = np.nan_to_num(np.abs(stack - reference).mean(axis=3), nan=np.inf)
    common = np.take_along_axis(np.sort(departure, axis=0), np.maximum(count - 1, 0)[None] // 2, axis=0)
    with np.errstate(invalid="ignore"):
        sure = (departure - 2.0 * common) / MOVED_LEVELS - 1.0
    sure = np.clip(np.nan_to_num(sure), 0.0, 1.0)
    return sure.astype(np.float32), np.where(count > 0, common[0], 0.0).astype(np.float32)


def common_part(place: Place, other: Place) -> tuple[Place, Place] | None:
    """The common part of two places, in rows and columns of each; None without one."""
    starts = [max(a.start, b.start) for a, b in zip(place, other, strict=True)]
    stops = [min(a.stop, b.stop) for a, b in zip(place, other, strict=True)]
    if any(stop <= start for start, stop in zip(starts, stops, strict=True)):
        return None
    inside = [
        tuple(slice(start - part.start, stop - part.start) for part, start, stop in zip(of, starts, stops, strict=True))
        for of in (place, other)
    ]
    return (inside[0][0], inside[0][1]), (inside[1][0], inside[1][1])


class _State:
    """A choice of images that expansions improve.

    Attributes:
        labels: the choice.
    """

    def __init__(self, views: Sequence[SeamView], shape: tuple[int, int], seam_costs: Field) -> None:
        self._views = views
        self._seam_costs = seam_costs
        self.labels: Labels = np.full(shape, -1, np.int32)
        self._costs = np.full(shape, np.inf, np.float32)
        for number, view in enumerate(views):
            costs, labels = self._costs[view.place], self.labels[view.place]
            better = view.costs < costs
            costs[better], labels[better] = view.costs[better], number
        # What a cell's image shows in the cell itself, and in its neighbours.
        self._shows = {offset: np.full((*shape, 3), np.nan, np.float32) for offset in _OFFSETS}
        for number, view in enumerate(views):
            self._show(number, self.labels[view.place] == number)

    def _show(self, number: int, cells: NDArray[np.bool_]) -> None:
        """Note what an image shows in and around cells that show it."""
        view = self._views[number]
        height, width = cells.shape
        padded = np.pad(view.colours, ((1, 1), (1, 1), (0, 0)), constant_values=np.nan)
        for (down, right), shown in self._shows.items():
            shifted = padded[1 + down : 1 + down + height, 1 + right : 1 + right + width]
            shown[view.place][cells] = shifted[cells]

    def expand(self, number: int) -> int:
        """Show an image in more cells where that lowers the costs; returns the number of cells."""
        view = self._views[number]
        # One cell more on each side, whose images stay.
        around = tuple(slice(max(part.start - 1, 0), part.stop + 1) for part in view.place)
        place = (around[0], around[1])
        labels = self.labels[place]
        inside = tuple(
            slice(part.start - big.start, part.stop - big.start) for part, big in zip(view.place, place, strict=True)
        )
        costs = np.full(labels.shape, np.inf, np.float32)
        colours = np.full((*labels.shape, 3), np.nan, np.float32)
        costs[inside], colours[inside] = view.costs, view.colours
        free = np.isfinite(costs) & (labels != number)
        if not free.any():
            return 0
        change = np.where(free, costs, 0.0) - np.where(free, self._costs[place], 0.0)
        expanded = _Cut(free, labels, number, change, self._seam_costs[place]).solve(
            {offset: shown[place] for offset, shown in self._shows.items()}, colours
        )
        labels[expanded] = number
        self._costs[place][expanded] = costs[expanded]
        self._show(number, expanded[inside])
        return int(expanded.sum())


_OFFSETS = ((0, 0), (0, 1), (0, -1), (1, 0), (-1, 0))


class _Cut:
    """One expansion: free cells keep their image (the source's side of the cut) or change to the new one."""

    def __init__(self, free: NDArray[np.bool_], labels: Labels, number: int, change: Field, seam_costs: Field) -> None:
        self._free, self._labels, self._number, self._seam_costs = free, labels, number, seam_costs
        self._index = np.full(free.shape, -1)
        self._index[free] = np.arange(int(free.sum()))
        self._change = change.astype(np.float64)
        """Cost of the new image minus that of the present one, for each cell."""
        self._edges: list[tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]] = []

    def solve(self, shows: dict[tuple[int, int], Field], new: Field) -> NDArray[np.bool_]:
        """Cells that change.

        Args:
            shows: what each cell's image shows in the neighbour at (down, right).
            new: (h, w, 3) what the new image shows.
        """
        for down, right in NEIGHBOURS:
            self._add_pairs(down, right, shows, new)
        return self._minimum()

    def _add_pairs(self, down: int, right: int, shows: dict[tuple[int, int], Field], new: Field) -> None:
        height, width = self._free.shape
        p = (slice(0, height - down), slice(0, width - right))
        q = (slice(down, height), slice(right, width))
        p_shows, p_in_q = shows[0, 0][p], shows[down, right][p]
        q_shows, q_in_p = shows[0, 0][q], shows[-down, -right][q]
        label_p, label_q = self._labels[p], self._labels[q]
        outside = (label_p < 0) | (label_q < 0)  # no seam against cells that no image shows
        extra = SEAM_COST + self._seam_costs[p] + self._seam_costs[q]
        keep = _seam(p_shows, q_in_p, p_in_q, q_shows, extra, (label_p == label_q) | outside)
        q_new = _seam(p_shows, new[p], p_in_q, new[q], extra, (label_p == self._number) | outside)
        p_new = _seam(new[p], q_in_p, new[q], q_shows, extra, (label_q == self._number) | outside)
        free_p, free_q = self._free[p], self._free[q]
        both = free_p & free_q
        # Kolmogorov and Zabih 2004: a pair's four costs as costs of single cells and of one edge.
        self._change[p] += np.where(both, p_new - keep, 0.0) + np.where(free_p & ~free_q, p_new - keep, 0.0)
        self._change[q] += np.where(both, -p_new, 0.0) + np.where(free_q & ~free_p, q_new - keep, 0.0)
        edge = np.maximum(q_new + p_new - keep, 0.0)
        self._edges.append((self._index[p][both], self._index[q][both], edge[both]))

    def _minimum(self) -> NDArray[np.bool_]:
        count = int(self._free.sum())
        source, sink = count, count + 1
        change = self._change[self._free]
        cells = np.arange(count)
        heads = [edge[0] for edge in self._edges] + [np.full(count, source), cells]
        tails = [edge[1] for edge in self._edges] + [cells, np.full(count, sink)]
        # A cell on the source's side keeps its image, and pays the negative change that it misses.
        values = [edge[2] for edge in self._edges] + [np.maximum(change, 0.0), np.maximum(-change, 0.0)]
        capacities = np.rint(CAPACITY_PER_LEVEL * np.concatenate(values)).astype(np.int32)
        shape = (count + 2, count + 2)
        graph = scipy.sparse.csr_matrix((capacities, (np.concatenate(heads), np.concatenate(tails))), shape=shape)
        residual = graph - maximum_flow(graph, source, sink).flow
        residual.data = np.maximum(residual.data, 0)
        residual.eliminate_zeros()
        kept = np.zeros(count + 2, bool)
        kept[breadth_first_order(residual, source, return_predecessors=False)] = True
        changed = np.zeros(self._free.shape, bool)
        changed[self._free] = ~kept[:count]
        return changed


def _seam(
    a_in_p: Field, b_in_p: Field, a_in_q: Field, b_in_q: Field, extra: Field, same: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Costs of seams between cells p of image a and q of image b: how much the images differ on both sides."""
    apart = np.abs(a_in_p - b_in_p).mean(axis=2) + np.abs(a_in_q - b_in_q).mean(axis=2)
    apart = np.where(np.isnan(apart), SEAM_UNKNOWN_COST, apart)
    return np.where(same, 0.0, extra + apart)
