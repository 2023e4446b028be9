"""Which outlines lie in each other, on a plane with any units."""

from collections.abc import Iterator

from jezero.area_files.polygon import Corner, Ring


def ring_area(ring: Ring) -> float:
    """Size of the area inside an outline."""
    return 0.5 * abs(sum(a[0] * b[1] - a[1] * b[0] for a, b in _edges(ring)))


def overlap(a: Ring, b: Ring) -> bool:
    """Whether two outlines have an area in common."""
    if any(_inside(corner, b) for corner in a) or any(_inside(corner, a) for corner in b):
        return True
    return any(_cross(p, q, r, s) for p, q in _edges(a) for r, s in _edges(b))


def with_holes(rings: list[Ring]) -> list[tuple[Ring, ...]]:
    """Outlines, each with its holes, from rings in any order and direction.

    A ring inside an odd number of others is a hole in the smallest of them.
    """
    ordered = sorted(rings, key=ring_area, reverse=True)
    areas: dict[int, list[Ring]] = {}
    for index, ring in enumerate(ordered):
        around = [larger for larger in range(index) if _mostly_inside(ring, ordered[larger])]
        if len(around) % 2 == 0 or around[-1] not in areas:
            areas[index] = [ring]
        else:
            areas[around[-1]].append(ring)
    return [tuple(area) for area in areas.values()]


def _mostly_inside(ring: Ring, other: Ring) -> bool:
    """Whether most corners are inside; one that touches the outline may count either way."""
    return 2 * sum(_inside(corner, other) for corner in ring) > len(ring)


def _edges(ring: Ring) -> Iterator[tuple[Corner, Corner]]:
    return zip(ring, ring[1:] + ring[:1], strict=True)


def _inside(point: Corner, ring: Ring) -> bool:
    """Whether a ray from the point crosses the outline an odd number of times."""
    x, y = point
    between = ((a, b) for a, b in _edges(ring) if (a[1] > y) != (b[1] > y))
    return sum(x < a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]) for a, b in between) % 2 == 1


def _cross(p: Corner, q: Corner, r: Corner, s: Corner) -> bool:
    """Whether two edges cross."""
    return _side(p, q, r) * _side(p, q, s) < 0.0 and _side(r, s, p) * _side(r, s, q) < 0.0


def _side(a: Corner, b: Corner, c: Corner) -> float:
    """Twice the area of a triangle, positive if it turns one way and negative for the other."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
