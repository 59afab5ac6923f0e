"""Transforms of /tf and /tf_static: a tree of frames in which poses are looked up."""

import math
from typing import Any

from explore_slam.geometry import Pose3

_LONGEST_CHAIN = 100  # frames; a longer chain of parents is a circle


def frame_name(name: str) -> str:
    """Return the name of a frame without leading slashes, which tf of ROS 1 had."""
    return name.lstrip('/')


def transform_pose(transform: Any) -> Pose3 | None:
    """Return the pose in a geometry_msgs/Transform; None if it is not one."""
    t, q = transform.translation, transform.rotation
    position = (float(t.x), float(t.y), float(t.z))
    quaternion = (float(q.x), float(q.y), float(q.z), float(q.w))
    length = math.hypot(*quaternion)
    if not all(map(math.isfinite, (*position, *quaternion))) or length == 0.0:
        return None
    x, y, z, w = (value / length for value in quaternion)
    return Pose3(position, (x, y, z, w))


class TransformTree:
    """The newest pose of every frame in its parent.

    Transforms on a vehicle's own topics take precedence over those on topics that all vehicles
    share, where another vehicle may use the same frame names. A message does not name its
    publisher; so when shared static transforms of one frame contradict each other, the tree can
    only report that (`is_contradicted`).
    """

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, Pose3]] = {}
        self._own: set[str] = set()
        self._static: set[str] = set()  # frames with a static pose on a shared topic
        self._contradicted: set[str] = set()  # frames with several such poses

    def __contains__(self, frame: str) -> bool:
        """Return whether a frame is part of the tree."""
        name = frame_name(frame)
        return name in self._parents or any(p == name for p, _ in self._parents.values())

    def add(self, message: Any, shared: bool = False, static: bool = False) -> None:
        """Add the transforms of a tf2_msgs/TFMessage; those that are not finite are omitted.

        shared: it came on a topic that all vehicles share. static: its transforms never change.
        """
        for stamped in message.transforms:
            child, parent = frame_name(stamped.child_frame_id), frame_name(stamped.header.frame_id)
            pose = transform_pose(stamped.transform)
            if pose is None or not child or not parent or child == parent:
                continue
            if not shared:
                self._own.add(child)
                self._contradicted.discard(child)
            elif child in self._own:
                continue
            elif static:
                if child in self._static and self._parents[child] != (parent, pose):
                    self._contradicted.add(child)
                self._static.add(child)
            self._parents[child] = (parent, pose)

    def lookup(self, base: str, frame: str) -> Pose3 | None:
        """Return the pose of a frame in a base frame; None where the tree does not join them."""
        base_chain, frame_chain = self._chain(frame_name(base)), self._chain(frame_name(frame))
        common = next((name for name in frame_chain if name in base_chain), None)
        if common is None:
            return None
        return base_chain[common].inverse().compose(frame_chain[common])

    def is_contradicted(self, base: str, frame: str) -> bool:
        """Return whether a frame, or one between it and the base, has had several static poses."""
        base_chain = self._chain(frame_name(base))
        for name in self._chain(frame_name(frame)):
            if name in base_chain:
                return False
            if name in self._contradicted:
                return True
        return False

    def _chain(self, frame: str) -> dict[str, Pose3]:
        """Return the pose of a frame in itself and in each of its ancestors, nearest first."""
        pose = Pose3((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
        chain = {frame: pose}
        while frame in self._parents and len(chain) < _LONGEST_CHAIN:
            frame, step = self._parents[frame]
            pose = step.compose(pose)
            if frame in chain:
                break
            chain[frame] = pose
        return chain
