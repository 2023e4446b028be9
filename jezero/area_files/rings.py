"""Which outlines lie in each other, on a map of latitudes and longitudes."""

from collections.abc import Iterator

from jezero.area_files.polygon import Corner, Ring


def ring_area(ring: Ring) -> float:
    """Size of the area inside an outline, in degrees of latitude times degrees of longitude."""
    return 0.5 * abs(sum(a[0] * b[1] - a[1] * b[0] for a, b in _edges(ring)))


def beside(ring: Ring, longitude_deg: float) -> Ring:
    """The ring with longitudes within half a turn of a given one, so beyond 180° where it crosses that meridian."""
    return tuple((corner[0], corner[1] - 360.0 * round((corner[1] - longitude_deg) / 360.0)) for corner in ring)


def overlap(a: Ring, b: Ring) -> bool:
    """Whether two outlines have an area in common."""
    a, b = (beside(ring, a[0][1]) for ring in (a, b))
    if any(_inside(corner, b) for corner in a) or any(_inside(corner, a) for corner in b):
        return True
    return any(_cross(p, q, r, s) for p, q in _edges(a) for r, s in _edges(b))


def with_holes(rings: list[Ring]) -> list[tuple[Ring, ...]]:
    """Outlines, each with its holes, from rings in any order and direction.

    A ring inside an odd number of others is a hole in the smallest of them.
    """
    ordered = sorted((beside(ring, rings[0][0][1]) for ring in rings), key=ring_area, reverse=True)
    areas: dict[int, list[Ring]] = {}
    for index, ring in enumerate(ordered):
        around = [larger for larger in range(index) if _mostly_inside(ring, ordered[larger])]
        if len(around) % 2 == 0 or around[-1] not in areas:
            areas[index] = [ring]
        else:
            areas[around[-1]].append(ring)
    return [tuple(area) for area in areas.values()]


def joined_at_180(areas: list[tuple[Ring, ...]]) -> list[tuple[Ring, ...]]:
    """Areas that were cut along the meridian of 180°, as GeoJSON wants it, in one piece again; others as they are.

    Args:
        areas: each an outline with its holes.
    """
    if len(areas) < 2 or {abs(corner[1]) for area in areas for corner in area[0]}.isdisjoint({180.0}):
        return areas
    import shapely  # only few files need it

    turned = [tuple(beside(ring, 180.0) for ring in area) for area in areas]
    polygons = [shapely.Polygon(outline, holes) for outline, *holes in turned]
    parts = shapely.get_parts(shapely.union_all(polygons)) if all(polygon.is_valid for polygon in polygons) else ()
    if not 0 < len(parts) < len(areas):
        return areas
    return [
        tuple(tuple((a, b) for a, b in ring.coords[:-1]) for ring in (part.exterior, *part.interiors)) for part in parts
    ]


def _mostly_inside(ring: Ring, other: Ring) -> bool:
    """Whether most corners of a ring are inside another; a corner on its outline may count as inside or outside."""
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
    """Twice the area of a triangle, positive if its corners follow each other clockwise, seen from above."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
