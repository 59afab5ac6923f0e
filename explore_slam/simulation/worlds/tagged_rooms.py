"""A tag at every room of the twin corridors, and which of them a camera sees.

The rooms stay equal to a laser; the tags tell them apart. A tag is on a sign that stands out from
the wall at the beginning of its room, above the laser, and faces vehicles on their lap.
"""

import math
from typing import NamedTuple

import numpy as np

from explore_slam.data import Intrinsics
from explore_slam.geometry import Array, Pose2
from explore_slam.simulation.worlds.twin_corridors import HALF_WIDTH, SECOND, TwinCorridors
from explore_slam.simulation.worlds.walls import distances_along
from explore_slam.vision import CameraMount
from explore_slam.vision.tag_images import TagInView, corners_in_view

SIZE = 0.2  # m, edge: a tag that fills a sheet of paper (A4)
HEIGHT = 0.8  # m, of the centre above the floor
_OUT = 0.15  # m of the centre of a sign from the wall of the corridor
_MARGIN = 1.25  # edge of the tag with its white margin, in edges of the tag
_REACH = 6.0  # m from which a tag of this size is looked for
_FACING = math.radians(75.0)  # from its normal, from which it is looked for
_CLEAR = 0.02  # m: a ray that gets this near reaches its goal


class RoomTag(NamedTuple):
    """A tag in a room: its number, and its pose in the map: centre (m), where it faces (rad)."""

    tag: int
    pose: Pose2


def tags_of_rooms(world: TwinCorridors) -> list[RoomTag]:
    """Return the tags of a world: numbers 0 … in the first corridor, then in the second.

    The first corridor is driven east, so that its signs face west; the second one is driven back.
    """
    lateral, rooms = HALF_WIDTH - _OUT, round(world.length / world.period)
    first = [RoomTag(n, Pose2(n * world.period, -lateral, math.pi)) for n in range(rooms)]
    second = [
        RoomTag(rooms + n, Pose2((n + 1) * world.period, SECOND + lateral, 0.0))
        for n in range(rooms)
    ]
    return first + second


def tags_in_view(
    world: TwinCorridors, tags: list[RoomTag], pose: Pose2, camera: Intrinsics, mount: CameraMount
) -> list[TagInView]:
    """Return the tags that a camera on a vehicle at a pose sees as a whole."""
    found = []
    position = np.asarray(pose.compose(Pose2(mount.x, mount.y, 0.0)))[:2]
    for item in tags:
        normal = np.array([math.cos(item.pose.theta), math.sin(item.pose.theta)])
        sight = position - item.pose[:2]
        distance = float(np.hypot(*sight))
        if distance > _REACH or sight @ normal < math.cos(_FACING) * distance:
            continue
        seen = _in_view(item, pose, mount)
        corners = corners_in_view(seen, camera, _MARGIN)
        if corners is None or (corners < 0.0).any():
            continue
        if (corners > [camera.width - 1.0, camera.height - 1.0]).any():
            continue
        right = np.array([-normal[1], normal[0]])
        ends = [item.pose[:2] + 0.5 * _MARGIN * SIZE * side * right for side in (-1.0, 1.0)]
        if all(_is_clear(world, position, end) for end in ends):
            found.append(seen)
    return found


def _in_view(item: RoomTag, pose: Pose2, mount: CameraMount) -> TagInView:
    """Return a tag in the optical frame of a camera on a vehicle at a pose."""
    at = pose.between(item.pose)
    normal = np.array([math.cos(at.theta), math.sin(at.theta), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    rotation = np.stack([np.cross(up, normal), up, normal], axis=1)
    place = np.array([at.x, at.y, HEIGHT]) - mount.translation
    turn = mount.rotation.T
    return TagInView(item.tag, SIZE, turn @ rotation, turn @ place)


def _is_clear(world: TwinCorridors, begin: Array, end: Array) -> bool:
    """Return whether no wall stands between two points (2,) m."""
    heading = math.atan2(end[1] - begin[1], end[0] - begin[0])
    free = float(distances_along(world.walls, begin[None], np.array([heading]))[0])
    return free > math.dist(begin, end) - _CLEAR
