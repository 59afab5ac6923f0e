"""Anchors: keyframes with the point cloud that was measured there, and regions of them."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.errors import SlamError
from explore_slam.geometry import Array, Pose2, between
from explore_slam.registration import LocalMap, PointCloud, merged

Integers = NDArray[np.int64]

REGION_SPACING = 3.0  # m of way between the centres of regions; neighbours overlap
REGION_HALF = 5.0  # m of way on either side of the centre that a region's map is made of
_MOST_IN_REGION = 40  # anchors; more of them are taken in turn
_QUERY_ANCHORS = 12
QUERY_WAY = 6.0  # m; one scan is ambiguous, 6 m of building hardly ever are
# A region's map is used again until a pose in it has moved by this: a fifth of a grid cell.
_SAME_POSITION = 0.01  # m
_SAME_HEADING = 0.003  # rad
_MAPS_KEPT = 48
_QUERY_SURFACES = 600  # returns with a normal that are aligned; more change nothing


@dataclass(frozen=True, eq=False)
class Anchor:
    """A keyframe with a cloud in the frame of its vehicle.

    way (m): driven by the vehicle until there; stamp (s).
    """

    keyframe: int
    vehicle: int
    way: float
    stamp: float
    cloud: PointCloud


@dataclass(frozen=True)
class Query:
    """The last anchors of a vehicle as one cloud in the frame of the newest.

    surfaces: returns with a normal, for alignment; points (n, 2): all, thinned for correlation.
    """

    anchor: Anchor
    surfaces: PointCloud
    points: Array


@dataclass(frozen=True)
class Region:
    """The map of the anchors around a centre, in the frame of the centre's anchor."""

    centre: Anchor
    anchors: tuple[Anchor, ...]
    offsets: Array  # (n, 3): poses of the anchors in the frame of the centre
    map: LocalMap


@dataclass
class _Trail:
    """Anchors of one vehicle in the order of its way."""

    anchors: list[Anchor] = field(default_factory=list)
    ways: list[float] = field(default_factory=list)

    def around(self, way: float, half: float, newest_way: float) -> list[Anchor]:
        """Return the anchors within half (m of way), none beyond newest_way."""
        ways = np.array(self.ways)
        first = int(np.searchsorted(ways, way - half, 'left'))
        last = int(np.searchsorted(ways, min(way + half, newest_way), 'right'))
        found = self.anchors[first:last]
        step = 1 + (len(found) - 1) // _MOST_IN_REGION
        return found[::step]


class AnchorTable(NamedTuple):
    """Anchors as arrays (n,), in the order in which they were added."""

    keyframes: Integers
    vehicles: Integers
    ways: Array
    stamps: Array


class Anchors:
    """All anchors of a team."""

    def __init__(self) -> None:
        self._trails: dict[int, _Trail] = {}
        self._by_keyframe: dict[int, Anchor] = {}
        self._maps: dict[tuple[int, int], Region] = {}
        self._rows = np.empty((0, 4))

    def __len__(self) -> int:
        return len(self._by_keyframe)

    def __iter__(self) -> Iterator[Anchor]:
        return iter(self._by_keyframe.values())

    def __contains__(self, keyframe: int) -> bool:
        return keyframe in self._by_keyframe

    def table(self) -> AnchorTable:
        """Return all anchors as arrays."""
        known = len(self._rows)
        if known < len(self):
            new = list(self._by_keyframe.values())[known:]
            rows = [(a.keyframe, a.vehicle, a.way, a.stamp) for a in new]
            self._rows = np.concatenate([self._rows, np.array(rows, dtype=np.float64)])
        keyframes, vehicles, ways, stamps = self._rows.T
        return AnchorTable(keyframes.astype(np.int64), vehicles.astype(np.int64), ways, stamps)

    def of_keyframe(self, keyframe: int) -> Anchor:
        """Return the anchor of a keyframe."""
        found = self._by_keyframe.get(keyframe)
        if found is None:
            raise SlamError(f'keyframe {keyframe} has no anchor')
        return found

    def add(self, anchor: Anchor) -> None:
        """Add an anchor at the end of its vehicle's way."""
        if anchor.keyframe in self._by_keyframe:
            raise SlamError(f'keyframe {anchor.keyframe} has an anchor already')
        trail = self._trails.setdefault(anchor.vehicle, _Trail())
        if not (np.isfinite(anchor.way) and np.isfinite(anchor.stamp)):
            raise SlamError(
                f'anchor {anchor.keyframe}: way is {anchor.way} m and stamp {anchor.stamp} s, '
                'expected finite values'
            )
        if trail.ways and anchor.way < trail.ways[-1]:
            raise SlamError(
                f'anchor {anchor.keyframe} lies at {anchor.way} m of way, '
                f'expected at least {trail.ways[-1]} m'
            )
        trail.anchors.append(anchor)
        trail.ways.append(anchor.way)
        self._by_keyframe[anchor.keyframe] = anchor

    def remove(self, keyframe: int) -> None:
        """Forget an anchor."""
        anchor = self.of_keyframe(keyframe)
        trail = self._trails[anchor.vehicle]
        at = trail.anchors.index(anchor)
        del trail.anchors[at], trail.ways[at], self._by_keyframe[keyframe]
        self._rows = np.empty((0, 4))

    def number_in_trail(self, anchor: Anchor) -> int:
        """Return the place of an anchor among those of its vehicle, counted from 1."""
        return self._trails[anchor.vehicle].anchors.index(anchor) + 1

    def query(self, anchor: Anchor, poses: Array, way: float = QUERY_WAY) -> Query:
        """Return the anchor and those on the way just driven as one cloud in its frame."""
        trail = self._trails[anchor.vehicle]
        last = trail.anchors.index(anchor)
        chosen = [
            other
            for other in trail.anchors[max(last - _QUERY_ANCHORS + 1, 0) : last + 1]
            if anchor.way - other.way <= way
        ]
        offsets = between(
            pose_of(poses, anchor.keyframe), np.array([pose_of(poses, a.keyframe) for a in chosen])
        )
        cloud = merged_at(chosen, offsets)
        on_surfaces = cloud.only(cloud.on_surfaces)
        step = 1 + (len(on_surfaces) - 1) // _QUERY_SURFACES
        taken = np.arange(len(on_surfaces)) % step == 0
        return Query(anchor, on_surfaces.only(taken), cloud.query_points)

    def region(self, vehicle: int, number: int, poses: Array, newest_way: float) -> Region | None:
        """Return the map of a region, None where it has no anchors up to newest_way (m).

        number: of the centre, in steps of REGION_SPACING along the way of the vehicle.
        """
        way = number * REGION_SPACING
        anchors = self._trails[vehicle].around(way, REGION_HALF, newest_way)
        if not anchors:
            return None
        centre = min(anchors, key=lambda anchor: (abs(anchor.way - way), anchor.keyframe))
        offsets = between(
            pose_of(poses, centre.keyframe),
            np.array([pose_of(poses, anchor.keyframe) for anchor in anchors]),
        )
        known = self._maps.pop((vehicle, number), None)
        if known is None or not _is_same(known, tuple(anchors), offsets):
            known = Region(centre, tuple(anchors), offsets, local_map_at(anchors, offsets))
        self._maps[vehicle, number] = known
        if len(self._maps) > _MAPS_KEPT:
            del self._maps[next(iter(self._maps))]
        return known


def pose_of(poses: Array, keyframe: int) -> Array:
    """Return the pose (3,) of a keyframe from those of all keyframes (K, 3)."""
    if keyframe >= len(poses):
        raise SlamError(f'poses end at keyframe {len(poses) - 1}, expected {keyframe} too')
    pose: Array = poses[keyframe]
    return pose


def merged_at(anchors: list[Anchor], offsets: Array) -> PointCloud:
    """Return the clouds of anchors at poses (n, 3) as one."""
    placed = zip(anchors, offsets, strict=True)
    return merged([anchor.cloud.moved(Pose2.from_array(at)) for anchor, at in placed])


def local_map_at(anchors: list[Anchor], offsets: Array) -> LocalMap:
    """Return the map of the clouds of anchors at poses (n, 3)."""
    return LocalMap.of(
        [anchor.cloud for anchor in anchors], [Pose2.from_array(at) for at in offsets]
    )


def _is_same(region: Region, anchors: tuple[Anchor, ...], offsets: Array) -> bool:
    if region.anchors != anchors:
        return False
    moved = np.abs(between(region.offsets, offsets))
    return bool((moved[:, :2] < _SAME_POSITION).all() and (moved[:, 2] < _SAME_HEADING).all())
