"""What is drawn along the most likely path, redrawn from where that path changed.

Items (scans, views of depth cameras) are stored with the keyframe at which they were taken. A
redraw compares the new path with the one drawn last: the drawing returns to the newest snapshot
before the first item whose keyframe moved noticeably, and the items from there on are drawn again
in their order. Cells are clamped, so that order matters; because it is preserved, the result
equals a drawing of all items from scratch along the path that `PathDrawing.path` returns, bit for
bit, until items are given up:

Memory is bounded by the area: of the items that one sensor has taken at one place in the map,
ITEMS_PER_PLACE are kept. A new one takes the place of the one taken nearest to its pose: a vehicle
that stands still replaces its own items, not what it has seen in other directions. Items that are
given up stay in the drawing until it is redrawn from before them; others have shown the same by
then.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from explore_slam.errors import MappingError
from explore_slam.geometry import IDENTITY, Array, Pose2, wrap_angle, wrap_angles
from explore_slam.mapping.occupancy_grid import NO_BODIES

SNAPSHOT_SPACING = 16  # items between the closest snapshots; powers of two of it further back
# An item is drawn again when its keyframe has moved by more than this distance (m), its turn
# counted by the effect on returns at a typical range (m): less than half a cell shows nothing.
REDRAW_DISTANCE, REDRAW_RANGE = 0.02, 3.0
# A place is a square of this side (m) and one of so many sectors of headings. Driving straight
# through leaves about ten scans there (ScanConfig.map_scan_distance).
PLACE_SIDE, PLACE_SECTORS, ITEMS_PER_PLACE = 1.0, 8, 10
_TURN_RANGE = 1.0  # m; a turn counts as the distance by which it moves what is so far away
MAP_FRAME = -1  # in place of a keyframe: the offset is a pose in the map frame


class VehicleDisc(NamedTuple):
    """Disc that covers another vehicle at the time of an item.

    keyframe: its newest keyframe, or MAP_FRAME.
    offset: its pose relative to the keyframe.
    radius: of the disc (m).
    """

    keyframe: int
    offset: Pose2
    radius: float


class Place(NamedTuple):
    """A place of a sensor: square of the map by column and row, and sector of headings."""

    vehicle: str
    sensor: str
    column: int
    row: int
    sector: int


class RedrawSummary(NamedTuple):
    """Numbers of items after a redraw.

    kept: unchanged since the last redraw.
    drawn: drawn by this one, those refused included.
    waiting: for a keyframe that is not on the path yet.
    refused: by the grid, because they lie too far out.
    """

    kept: int
    drawn: int
    waiting: int
    refused: int


class Anchored(Protocol):
    """An item: taken by a vehicle at a keyframe, while other vehicles were within discs."""

    @property
    def keyframe(self) -> int:
        """Number of the keyframe."""

    @property
    def vehicle(self) -> str:
        """Name of the vehicle."""

    @property
    def sensor(self) -> str:
        """Which of its sensors of one kind; '' where there is one only."""

    @property
    def bodies(self) -> tuple[VehicleDisc, ...]:
        """The other vehicles."""


class Canvas(Protocol):
    """What items are drawn into."""

    @property
    def nbytes(self) -> int:
        """Memory that it takes."""

    def copy(self) -> Self:
        """Return an independent copy."""


def snapshot_positions(count: int) -> set[int]:
    """Return the numbers of items at which snapshots are kept: denser towards the present."""
    kept: set[int] = set()
    spacing = SNAPSHOT_SPACING
    while spacing <= count:
        last = count // spacing * spacing
        kept.update({last, last - spacing})
        spacing *= 2
    return kept - {0}


class PathDrawing[I: Anchored, C: Canvas](ABC):
    """Items with their keyframes, and the drawing of them along the most likely path.

    snapshot_memory: for snapshots (MB).
    """

    def __init__(self, snapshot_memory: float) -> None:
        self._snapshot_memory = snapshot_memory
        self._canvas = self._empty()
        self._items: list[I | None] = []  # None: given up
        self._drawn = 0
        self._places: dict[Place, dict[int, Pose2]] = {}  # poses of items there by number
        self._given_up = 0
        self._path: Array = np.empty((0, 3))
        self._in_map: NDArray[np.bool_] = np.empty(0, np.bool_)  # which of these keyframes
        self._snapshots: dict[int, C] = {}
        self.revision = 0  # counts the redraws that have changed the drawing

    def __len__(self) -> int:
        return len(self._items) - self._given_up

    @abstractmethod
    def _empty(self) -> C:
        """Return an empty drawing."""

    @abstractmethod
    def _pose(self, item: I) -> Pose2:
        """Return the pose on the path at which an item was taken."""

    @abstractmethod
    def _draw_items(self, items: Sequence[I]) -> int:
        """Draw items that are in the map along the path; return how many are refused."""

    def _held(self, start: int = 0, stop: int | None = None) -> list[I]:
        """Return the items with numbers from start to before stop that have not been given up."""
        return [item for item in self._items[start:stop] if item is not None]

    def _must_start_over(self) -> bool:
        """Return whether what is drawn would be drawn differently now."""
        return False

    def _append(self, item: I) -> None:
        """Store an item; it is drawn by the next redraw whose path holds its keyframes."""
        if item.keyframe < 0:
            raise MappingError(
                f'keyframe is {item.keyframe}, expected the number of a keyframe, >= 0'
            )
        self._items.append(item)

    def redraw(self, path: ArrayLike, in_map: NDArray[np.bool_] | None = None) -> RedrawSummary:
        """Redraw along the path (K, 3) of all keyframes.

        in_map (K,): keyframes whose poses are in the map; items and vehicles at others are not
        drawn as long as that is so. Default: all. A path that is not finite is a MappingError and
        changes nothing; an item that the grid refuses because it lies too far out is skipped,
        logged and counted.
        """
        poses = np.array(path, np.float64)
        if poses.ndim != 2 or poses.shape[1] != 3 or not np.isfinite(poses).all():
            raise MappingError(
                f'path has shape {poses.shape} or values that are not finite, expected (K, 3)'
            )
        placed = np.ones(len(poses), np.bool_) if in_map is None else np.array(in_map, np.bool_)
        if placed.shape != (len(poses),):
            raise MappingError(f'in_map has shape {placed.shape}, expected ({len(poses)},)')
        moved = self._moved(poses)
        common = len(moved)
        moved |= placed[:common] != self._in_map[:common]
        kept = self._count_unchanged(moved)
        if self._must_start_over():
            kept = 0
        restored = kept < self._drawn
        if restored:
            self._restore_snapshot(kept)
        start, refused = self._drawn, 0
        poses[: len(moved)][~moved] = self._path[: len(moved)][~moved]
        self._path, self._in_map = poses, placed
        end = self._drawn
        while end < len(self._items) and self._can_draw(self._items[end], poses):
            end += 1
        drawn = len(self._held(start, end))
        # only snapshots that remain at the end are worth a copy
        for stop in [*sorted(n for n in snapshot_positions(end) if n > start), end]:
            items = self._held(self._drawn, stop)
            self._drawn = stop
            refused += self._draw_items([i for i in items if self._in_map[i.keyframe]])
            if stop % SNAPSHOT_SPACING == 0 and stop > start:
                self._keep_snapshot()
        self.revision += restored or drawn > 0
        self._thin_out(start)
        return RedrawSummary(start, drawn, len(self._items) - self._drawn, refused)

    @property
    def path(self) -> Array:
        """Poses (K, 3) of the keyframes that it is drawn along; a copy."""
        return self._path.copy()

    def _moved(self, poses: Array) -> NDArray[np.bool_]:
        """Return which keyframes of both paths have moved noticeably since they were drawn."""
        common = min(len(poses), len(self._path))
        off = poses[:common] - self._path[:common]
        distance = np.hypot(off[:, 0], off[:, 1])
        turn = np.abs(wrap_angles(off[:, 2]))
        moved: NDArray[np.bool_] = distance + REDRAW_RANGE * turn > REDRAW_DISTANCE
        return moved

    def _count_unchanged(self, moved: NDArray[np.bool_]) -> int:
        """Return the number of drawn items before the first one whose keyframes have moved."""
        changed = np.ones(len(self._path) + 1, np.bool_)
        changed[: len(moved)] = moved
        changed[MAP_FRAME] = False  # the last element, which belongs to no keyframe
        if not changed.any():
            return self._drawn
        for number, item in enumerate(self._items[: self._drawn]):
            if item is None:
                continue
            if changed[item.keyframe] or any(changed[body.keyframe] for body in item.bodies):
                return number
        return self._drawn

    def _restore_snapshot(self, kept: int) -> None:
        """Return to the newest snapshot of at most this many items, or to an empty drawing."""
        older = [count for count in self._snapshots if count <= kept]
        self._drawn = max(older, default=0)
        self._canvas = self._snapshots[self._drawn].copy() if older else self._empty()
        self._snapshots = {count: self._snapshots[count] for count in older}
        self._forget_places(self._drawn)

    @staticmethod
    def _can_draw(item: Anchored | None, poses: Array) -> bool:
        """Return whether the path (K, 3) holds all keyframes of an item."""
        if item is None:
            return True
        newest = max([item.keyframe, *(body.keyframe for body in item.bodies)])
        return newest < len(poses)

    def _discs(self, item: Anchored) -> ArrayLike:
        """Return x, y and radius (V, 3) m of the other vehicles of an item, in the map."""
        poses = self._path
        ignore: ArrayLike = NO_BODIES
        if item.bodies:
            rows = []
            for body in item.bodies:
                base = IDENTITY
                if body.keyframe != MAP_FRAME:
                    if not self._in_map[body.keyframe]:
                        continue
                    base = Pose2(*poses[body.keyframe].tolist())
                pose = base.compose(body.offset)
                rows.append((pose.x, pose.y, body.radius))
            ignore = np.array(rows).reshape(-1, 3)
        return ignore

    def _thin_out(self, start: int) -> None:
        """Note the places of the items drawn from a number on; give up others taken there."""
        for number in range(start, self._drawn):
            item = self._items[number]
            if item is None or not self._in_map[item.keyframe]:
                continue
            pose = self._pose(item)
            there = self._places.setdefault(_place(item, pose), {})
            if len(there) >= ITEMS_PER_PLACE:
                nearest = min(there, key=lambda other: _distance(pose, there[other]))
                del there[nearest]
                self._items[nearest] = None
                self._given_up += 1
            there[number] = pose

    def _forget_places(self, start: int) -> None:
        """Forget where the items from a number on were taken: the path has moved."""
        for place, there in list(self._places.items()):
            kept = {number: pose for number, pose in there.items() if number < start}
            if kept:
                self._places[place] = kept
            else:
                del self._places[place]

    def _keep_snapshot(self) -> None:
        """Store the current drawing; drop old snapshots by position and by memory."""
        positions = snapshot_positions(self._drawn)
        self._snapshots = {n: one for n, one in self._snapshots.items() if n in positions}
        size = self._canvas.nbytes / 1e6
        capacity = int(self._snapshot_memory / size) if size > 0.0 else 0
        if capacity > 0:
            self._snapshots[self._drawn] = self._canvas.copy()
        for oldest in sorted(self._snapshots)[: max(0, len(self._snapshots) - capacity)]:
            del self._snapshots[oldest]


def _place(item: Anchored, pose: Pose2) -> Place:
    """Return the place of an item that was taken at a pose."""
    return Place(
        item.vehicle,
        item.sensor,
        math.floor(pose.x / PLACE_SIDE),
        math.floor(pose.y / PLACE_SIDE),
        math.floor(pose.theta / math.tau * PLACE_SECTORS) % PLACE_SECTORS,
    )


def _distance(one: Pose2, other: Pose2) -> float:
    """Return how far two poses are apart (m), turns included."""
    turn = abs(wrap_angle(one.theta - other.theta))
    return math.hypot(one.x - other.x, one.y - other.y) + _TURN_RANGE * turn
