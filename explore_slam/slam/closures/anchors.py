"""Anchors: keyframes with the point cloud that was measured there, and regions of them."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from explore_slam.errors import SlamError
from explore_slam.geometry import Array, Pose2, between
from explore_slam.registration import LocalMap, PointCloud, merged
from explore_slam.slam.checkpoint import State, text_array, text_value

Integers = NDArray[np.int64]

# Chosen on the Intel, ACES and Belgioioso logs; `benchmarks/laser_graph_slam.py` shows what a
# change does.
REGION_SPACING = 3.0  # m driven between the centres of regions; neighbours overlap
REGION_HALF = 5.0  # m driven on either side of the centre that a region's map is made of
_MAXIMUM_ANCHORS_IN_REGION = 40  # anchors; more of them are taken in turn
_QUERY_ANCHORS = 12  # spread over the query
QUERY_LENGTH = 6.0  # m; one scan is ambiguous, 6 m of building hardly ever are
# A region's map is used again until a pose in it has moved by this: a fifth of a grid cell.
_SAME_POSITION = 0.01  # m
_SAME_HEADING = 0.003  # rad
_MAPS_KEPT = 48  # of the regions used last: those around all vehicles of a team
_QUERY_SURFACES = 600  # returns with a normal that are aligned; more change nothing


@dataclass(frozen=True, eq=False)
class Anchor:
    """A keyframe with a cloud in the frame of its vehicle.

    distance_driven (m): by the vehicle until there; stamp (s).
    """

    keyframe: int
    vehicle: int
    distance_driven: float
    stamp: float
    cloud: PointCloud


@dataclass(frozen=True)
class Query:
    """The last anchors of a vehicle as one cloud in the frame of the newest.

    middle: the anchor halfway; surfaces: returns with a normal, for alignment; points (n, 2): all,
    thinned for correlation; distance_driven (m): from the first to the newest of the anchors.
    """

    anchor: Anchor
    middle: Anchor
    surfaces: PointCloud
    points: Array
    distance_driven: float


@dataclass(frozen=True, eq=False)
class Region:
    """The anchors around a centre, and the map that they make in the frame of its anchor.

    offsets (n, 3): poses of the anchors in that frame.
    """

    centre: Anchor
    anchors: tuple[Anchor, ...]
    offsets: Array

    @cached_property
    def map(self) -> LocalMap:
        """The clouds of the anchors at their poses."""
        poses = [Pose2.from_array(at) for at in self.offsets]
        return LocalMap.of([anchor.cloud for anchor in self.anchors], poses)


@dataclass
class _Trail:
    """Anchors of one vehicle in the order of its path; added counts removed ones too."""

    anchors: list[Anchor] = field(default_factory=list)
    distances_driven: list[float] = field(default_factory=list)
    added: int = 0

    def around(self, distance_driven: float, half: float, newest_distance: float) -> list[Anchor]:
        """Return the anchors within half (m driven), none beyond newest_distance (m driven)."""
        distances_driven = np.array(self.distances_driven)
        first = int(np.searchsorted(distances_driven, distance_driven - half, 'left'))
        last = int(
            np.searchsorted(
                distances_driven, min(distance_driven + half, newest_distance), 'right'
            )
        )
        found = self.anchors[first:last]
        step = 1 + (len(found) - 1) // _MAXIMUM_ANCHORS_IN_REGION
        return found[::step]


class AnchorTable(NamedTuple):
    """Anchors as arrays (n,), in the order in which they were added."""

    keyframes: Integers
    vehicles: Integers
    distances_driven: Array
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

    def state_dict(self) -> State:
        """Return the anchors and the poses in the maps of regions as named arrays."""
        table, clouds = self.table(), [anchor.cloud for anchor in self]
        regions = [
            (key, region.centre.keyframe, [anchor.keyframe for anchor in region.anchors])
            for key, region in self._maps.items()
        ]
        offsets = [region.offsets for region in self._maps.values()]
        return {
            'keyframes': table.keyframes,
            'vehicles': table.vehicles,
            'distances_driven': table.distances_driven,
            'stamps': table.stamps,
            'counts': np.array([len(cloud) for cloud in clouds], np.int64),
            'clouds': np.concatenate(
                [np.c_[c.points, c.normals, c.weights] for c in clouds] or [np.empty((0, 5))]
            ),
            'added': np.array([(v, trail.added) for v, trail in self._trails.items()], np.int64),
            'regions': text_array(regions),
            'offsets': np.concatenate(offsets or [np.empty((0, 3))]),
        }

    @classmethod
    def from_state(cls, state: State) -> Self:
        """Make the anchors that `state_dict` returned."""
        made = cls()
        parts = np.split(state['clouds'], np.cumsum(state['counts'])[:-1])
        columns = (
            state[name].tolist()
            for name in ('keyframes', 'vehicles', 'distances_driven', 'stamps')
        )
        for (keyframe, vehicle, distance_driven, stamp), part in zip(
            zip(*columns, strict=True), parts, strict=False
        ):
            cloud = PointCloud(part[:, :2].copy(), part[:, 2:4].copy(), part[:, 4].copy())
            made.add(Anchor(keyframe, vehicle, distance_driven, stamp, cloud))
        for vehicle, added in state['added'].tolist():
            made._trails.setdefault(vehicle, _Trail()).added = added
        first = 0
        for key, centre, keyframes in text_value(state['regions']):
            anchors = tuple(made._by_keyframe[keyframe] for keyframe in keyframes)
            offsets = state['offsets'][first : first + len(anchors)]
            first += len(anchors)
            vehicle, number = key
            made._maps[vehicle, number] = Region(made._by_keyframe[centre], anchors, offsets)
        return made

    def table(self) -> AnchorTable:
        """Return all anchors as arrays."""
        known = len(self._rows)
        if known < len(self):
            new = list(self._by_keyframe.values())[known:]
            rows = [(a.keyframe, a.vehicle, a.distance_driven, a.stamp) for a in new]
            self._rows = np.concatenate([self._rows, np.array(rows, dtype=np.float64)])
        keyframes, vehicles, distances_driven, stamps = self._rows.T
        return AnchorTable(
            keyframes.astype(np.int64), vehicles.astype(np.int64), distances_driven, stamps
        )

    def of_keyframe(self, keyframe: int) -> Anchor:
        """Return the anchor of a keyframe."""
        found = self._by_keyframe.get(keyframe)
        if found is None:
            raise SlamError(f'keyframe {keyframe} has no anchor')
        return found

    def add(self, anchor: Anchor) -> None:
        """Add an anchor at the end of its vehicle's path."""
        if anchor.keyframe in self._by_keyframe:
            raise SlamError(f'keyframe {anchor.keyframe} has an anchor already')
        trail = self._trails.setdefault(anchor.vehicle, _Trail())
        if not (np.isfinite(anchor.distance_driven) and np.isfinite(anchor.stamp)):
            raise SlamError(
                f'anchor {anchor.keyframe}: distance_driven is {anchor.distance_driven} m and '
                f'stamp {anchor.stamp} s, expected finite values'
            )
        if trail.distances_driven and anchor.distance_driven < trail.distances_driven[-1]:
            raise SlamError(
                f'anchor {anchor.keyframe} lies at {anchor.distance_driven} m driven, '
                f'expected at least {trail.distances_driven[-1]} m'
            )
        trail.anchors.append(anchor)
        trail.distances_driven.append(anchor.distance_driven)
        trail.added += 1
        self._by_keyframe[anchor.keyframe] = anchor

    def remove(self, keyframe: int) -> None:
        """Forget an anchor."""
        anchor = self.of_keyframe(keyframe)
        trail = self._trails[anchor.vehicle]
        at = trail.anchors.index(anchor)
        del trail.anchors[at], trail.distances_driven[at], self._by_keyframe[keyframe]
        self._rows = np.empty((0, 4))
        self._maps = {k: r for k, r in self._maps.items() if anchor not in r.anchors}

    def number_added(self, vehicle: int) -> int:
        """Return how many anchors of a vehicle were ever added."""
        return self._trails[vehicle].added

    def query(self, anchor: Anchor, poses: Array, distance_driven: float = QUERY_LENGTH) -> Query:
        """Return the anchor and those just passed as one cloud in its frame."""
        trail = self._trails[anchor.vehicle]
        recent = trail.anchors[: trail.anchors.index(anchor) + 1]
        recent = [
            other
            for other in recent
            if anchor.distance_driven - other.distance_driven <= distance_driven
        ]
        spread = np.linspace(0, len(recent) - 1, min(len(recent), _QUERY_ANCHORS))
        chosen = [recent[n] for n in np.round(spread).astype(int)]
        offsets = between(
            pose_of(poses, anchor.keyframe), np.array([pose_of(poses, a.keyframe) for a in chosen])
        )
        cloud = merged_at(chosen, offsets)
        on_surfaces = cloud.only(cloud.on_surfaces)
        step = 1 + (len(on_surfaces) - 1) // _QUERY_SURFACES
        taken = np.arange(len(on_surfaces)) % step == 0
        distance_driven = anchor.distance_driven - chosen[0].distance_driven
        middle = chosen[len(chosen) // 2]
        return Query(anchor, middle, on_surfaces.only(taken), cloud.query_points, distance_driven)

    def region_numbers(self, vehicle: int) -> list[int]:
        """Return the numbers of the regions that a vehicle has anchors in, ascending."""
        trail = self._trails.get(vehicle)
        distances_driven = [] if trail is None else trail.distances_driven
        return sorted(
            {round(distance_driven / REGION_SPACING) for distance_driven in distances_driven}
        )

    def region(
        self, vehicle: int, number: int, poses: Array, newest_distance: float = math.inf
    ) -> Region | None:
        """Return the map of a region, None where it has no anchors up to newest_distance (m).

        number: of the centre, in steps of REGION_SPACING of distance driven by the vehicle.
        """
        distance_driven = number * REGION_SPACING
        anchors = self._trails[vehicle].around(distance_driven, REGION_HALF, newest_distance)
        if not anchors:
            return None
        centre = min(
            anchors,
            key=lambda anchor: (abs(anchor.distance_driven - distance_driven), anchor.keyframe),
        )
        offsets = between(
            pose_of(poses, centre.keyframe),
            np.array([pose_of(poses, anchor.keyframe) for anchor in anchors]),
        )
        known = self._maps.pop((vehicle, number), None)
        if known is None or not _is_same(known, tuple(anchors), offsets):
            known = Region(centre, tuple(anchors), offsets)
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


def _is_same(region: Region, anchors: tuple[Anchor, ...], offsets: Array) -> bool:
    if region.anchors != anchors:
        return False
    moved = np.abs(between(region.offsets, offsets))
    return bool((moved[:, :2] < _SAME_POSITION).all() and (moved[:, 2] < _SAME_HEADING).all())
