"""The arithmetic of a 3D viewer with frames."""

from typing import Any

from jezero.frames import Vec3, add, quat_rotate


def in_map(transforms: Any, frame: str, point_m: Vec3 = (0.0, 0.0, 0.0)) -> Vec3:
    """A point of a frame in the root frame, from a decoded message of transforms."""
    by_child = {each["child_frame_id"]: each for each in transforms["transforms"]}
    while frame != "map":
        pose = by_child[frame]
        turn, move = pose["rotation"], pose["translation"]
        point_m = quat_rotate((turn["w"], turn["x"], turn["y"], turn["z"]), point_m)
        point_m = add(point_m, (move["x"], move["y"], move["z"]))
        frame = pose["parent_frame_id"]
    return point_m
