"""The arithmetic of a 3D viewer with frames."""

from bisect import bisect
from collections import defaultdict
from collections.abc import Iterable
from typing import Any

import numpy as np

from jezero.base.frames import Quat, Vec3, add, quat_between, quat_conjugate, quat_rotate, scale, subtract

Pose = tuple[Vec3, Quat]
"""Translation and rotation of a frame in its parent."""


def in_map(transforms: Any, frame: str, point_m: Vec3 = (0.0, 0.0, 0.0)) -> Vec3:
    """A point of a frame in the root frame, from a decoded message of transforms."""
    by_child = {each["child_frame_id"]: each for each in transforms["transforms"]}
    while frame != "map":
        point_m = to_parent(pose_of(by_child[frame]), point_m)
        frame = by_child[frame]["parent_frame_id"]
    return point_m


def pose_of(transform: Any) -> Pose:
    move, turn = transform["translation"], transform["rotation"]
    return (move["x"], move["y"], move["z"]), (turn["w"], turn["x"], turn["y"], turn["z"])


def to_parent(pose: Pose, point_m: Vec3) -> Vec3:
    return add(quat_rotate(pose[1], point_m), pose[0])


def from_parent(pose: Pose, point_m: Vec3) -> Vec3:
    return quat_rotate(quat_conjugate(pose[1]), subtract(point_m, pose[0]))


def time_ns(stamp: Any) -> int:
    return int(stamp["sec"]) * 1_000_000_000 + int(stamp["nsec"])


class Motion:
    """Poses of all frames over time, interpolated as Foxglove does it."""

    def __init__(self, messages: Iterable[Any]) -> None:
        poses: dict[str, dict[int, Pose]] = defaultdict(dict)
        for message in messages:
            for each in message["transforms"]:
                poses[each["child_frame_id"]][time_ns(each["timestamp"])] = pose_of(each)
        self._poses = {frame: sorted(by_time.items()) for frame, by_time in poses.items()}

    def at(self, frame: str, t_ns: int) -> Pose:
        """Pose of a frame in its parent at one time."""
        poses = self._poses[frame]
        later = min(max(bisect([time for time, _ in poses], t_ns), 1), len(poses) - 1)
        (before_ns, before), (after_ns, after) = poses[later - 1], poses[later]
        fraction = float(np.clip((t_ns - before_ns) / (after_ns - before_ns), 0.0, 1.0))
        moved_m = add(before[0], scale(subtract(after[0], before[0]), fraction))
        return moved_m, quat_between(before[1], after[1], fraction)
