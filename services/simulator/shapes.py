"""Shapes of visible and solid things: triangles with a normal and a colour at each corner."""

from math import cos, pi, sin

import numpy as np
import numpy.typing as npt

from jezero.base.arrays import Array

Mesh = npt.NDArray[np.float32]
"""(3 x triangles, 9): position, normal, colour (roots of reflectances), in the frame of its body."""
Colour = tuple[float, float, float]
Point = tuple[float, float, float]


def mesh_of(triangles: Array, colour: Colour) -> Mesh:
    """(n, 3, 3) corners, counter-clockwise from outside, as flat faces of one colour."""
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    corners = triangles.reshape(-1, 3)
    colours = np.broadcast_to(np.array(colour), corners.shape)
    return np.hstack([corners, np.repeat(normals, 3, axis=0), colours]).astype(np.float32)


def box(middle_m: Point, half_m: Point, colour: Colour, turn_pitch_rad: float = 0.0) -> Mesh:
    """A box, turned about its second axis."""
    signs = np.array([(a, b, c) for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)], dtype=np.float64)
    quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    faces = [(q[0], q[1], q[2]) for q in quads] + [(q[0], q[2], q[3]) for q in quads]
    c, s = cos(turn_pitch_rad), sin(turn_pitch_rad)
    turn = np.array(((c, 0.0, s), (0.0, 1.0, 0.0), (-s, 0.0, c)))
    corners = (signs * np.array(half_m)) @ turn.T + np.array(middle_m)
    return mesh_of(corners[np.array(faces)], colour)


def rod(start_m: Point, end_m: Point, radius_m: float, colour: Colour, sides: int = 8) -> Mesh:
    """A closed cylinder from one point to another."""
    start, end = np.array(start_m), np.array(end_m)
    axis = (end - start) / np.linalg.norm(end - start)
    across = np.cross(axis, (0.0, 0.0, 1.0) if abs(axis[2]) < 0.9 else (1.0, 0.0, 0.0))
    across /= np.linalg.norm(across)
    other = np.cross(axis, across)
    angles = 2.0 * pi * np.arange(sides) / sides
    ring = radius_m * (np.cos(angles)[:, None] * across + np.sin(angles)[:, None] * other)
    after = np.roll(ring, -1, axis=0)
    triangles = [
        np.stack([start + ring, start + after, end + after], axis=1),
        np.stack([start + ring, end + after, end + ring], axis=1),
        np.stack([np.broadcast_to(end, ring.shape), end + ring, end + after], axis=1),
        np.stack([np.broadcast_to(start, ring.shape), start + after, start + ring], axis=1),
    ]
    return mesh_of(np.concatenate(triangles), colour)
