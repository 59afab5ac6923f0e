"""Occupancy grid along the most likely path, redrawn from where that path changed.

Scans are stored with the keyframe at which they were taken. A redraw compares the new path with
the one drawn last: the grid returns to the newest snapshot before the first scan whose keyframe
moved noticeably, and the scans from there on are drawn again in their order. Cells are clamped, so
that order matters; because it is preserved, the result equals a grid drawn from scratch along the
path that `LaserMap.path` returns, bit for bit.
"""

import logging
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from explore_slam.data import LaserScan
from explore_slam.errors import MappingError
from explore_slam.geometry import IDENTITY, Array, Pose2, wrap_angles
from explore_slam.mapping.config import GridConfig
from explore_slam.mapping.no_return import NoReturnJudge
from explore_slam.mapping.occupancy_grid import NO_BODIES, OccupancyGrid, PlacedScan

logger = logging.getLogger(__name__)
SNAPSHOT_SPACING = 16  # scans between the closest snapshots; powers of two of it further back
# A scan is drawn again when its keyframe has moved by more than this distance (m), its turn
# counted by the effect on returns at a typical range (m): less than half a cell shows nothing.
REDRAW_DISTANCE, REDRAW_RANGE = 0.02, 3.0
MAP_FRAME = -1  # in place of a keyframe: the offset is a pose in the map frame


class VehicleDisc(NamedTuple):
    """Disc that covers another vehicle at the time of a scan.

    keyframe: its newest keyframe, or MAP_FRAME.
    offset: its pose relative to the keyframe.
    radius: of the disc (m).
    """

    keyframe: int
    offset: Pose2
    radius: float


class KeyframeScan(NamedTuple):
    """A scan with its keyframe, the pose of the laser relative to it, and the other vehicles."""

    keyframe: int
    vehicle: str
    scan: LaserScan
    laser_in_keyframe: Pose2
    bodies: tuple[VehicleDisc, ...]


class RedrawSummary(NamedTuple):
    """Numbers of scans after a redraw.

    kept: unchanged since the last redraw.
    drawn: drawn by this one, those refused included.
    waiting: for a keyframe that is not on the path yet.
    refused: by the grid, because they lie too far out.
    """

    kept: int
    drawn: int
    waiting: int
    refused: int


def _snapshot_positions(count: int) -> set[int]:
    """Return the numbers of scans at which snapshots are kept: denser towards the present."""
    kept: set[int] = set()
    spacing = SNAPSHOT_SPACING
    while spacing <= count:
        last = count // spacing * spacing
        kept.update({last, last - spacing})
        spacing *= 2
    return kept - {0}


class LaserMap:
    """All scans with their keyframes, and the occupancy grid along the most likely path."""

    def __init__(self, config: GridConfig | None = None) -> None:
        self.config = config or GridConfig()
        self.grid = OccupancyGrid(self.config)
        self._scans: list[KeyframeScan] = []
        self._drawn = 0
        self._path: Array = np.empty((0, 3))
        self._in_map: NDArray[np.bool_] = np.empty(0, np.bool_)  # which of these keyframes
        self._snapshots: dict[int, OccupancyGrid] = {}
        self._judges: dict[str, NoReturnJudge] = {}
        self._not_free: set[str] = set()  # vehicles whose no returns the drawn scans did not free

    @property
    def no_returns(self) -> dict[str, tuple[float, bool]]:
        """Share of the beams without return of each vehicle, and whether they free cells."""
        return {name: (judge.share, self._is_free(name)) for name, judge in self._judges.items()}

    def _is_free(self, vehicle: str) -> bool:
        meaning = self.config.no_return_meaning
        return self._judges[vehicle].is_free if meaning == 'auto' else meaning == 'free'

    @property
    def scans(self) -> Sequence[KeyframeScan]:
        """All scans in the order in which they were added."""
        return tuple(self._scans)

    def add(
        self,
        keyframe: int,
        vehicle: str,
        scan: LaserScan,
        laser_in_keyframe: Pose2 = IDENTITY,
        bodies: Sequence[VehicleDisc] = (),
    ) -> None:
        """Store a scan; it enters the grid at the next redraw whose path holds its keyframes."""
        if keyframe < 0:
            raise MappingError(f'keyframe is {keyframe}, expected the number of a keyframe, >= 0')
        self._judges.setdefault(vehicle, NoReturnJudge()).add(scan)
        self._scans.append(KeyframeScan(keyframe, vehicle, scan, laser_in_keyframe, tuple(bodies)))

    def redraw(self, path: ArrayLike, in_map: NDArray[np.bool_] | None = None) -> RedrawSummary:
        """Redraw the grid along the path (K, 3) of all keyframes.

        in_map (K,): keyframes whose poses are in the map; scans and vehicles at others are not
        drawn as long as that is so. Default: all. A path that is not finite is a MappingError and
        changes nothing; a scan that the grid refuses because it lies too far out is skipped,
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
        if self._meaning_changed():
            kept = 0
        if kept < self._drawn:
            self._restore_snapshot(kept)
        start, refused = self._drawn, 0
        poses[: len(moved)][~moved] = self._path[: len(moved)][~moved]
        self._path, self._in_map = poses, placed
        end = self._drawn
        while end < len(self._scans) and self._can_draw(self._scans[end], poses):
            end += 1
        # only snapshots that remain at the end are worth a copy of the grid
        for stop in [*sorted(n for n in _snapshot_positions(end) if n > start), end]:
            refused += self._draw(stop)
            if stop % SNAPSHOT_SPACING == 0 and stop > start:
                self._keep_snapshot()
        return RedrawSummary(start, self._drawn - start, len(self._scans) - self._drawn, refused)

    def _meaning_changed(self) -> bool:
        """Decide what beams without return mean; return whether drawn scans took them otherwise.

        It changes once, after the first scans, if at all.
        """
        not_free = {vehicle for vehicle in self._judges if not self._is_free(vehicle)}
        changed, self._not_free = not_free ^ self._not_free, not_free
        for vehicle in sorted(changed):
            logger.warning(
                '%s: %.0f %% of the beams have no return (+inf), and %s: they free %s '
                '(no_return_meaning)', vehicle, 100.0 * self._judges[vehicle].share,
                *(
                    ('hardly any other is long', 'no cells')
                    if vehicle in not_free
                    else ('others are long as well', 'cells')
                ),
            )  # fmt: skip
        return bool(changed) and any(
            item.vehicle in changed for item in self._scans[: self._drawn]
        )

    @property
    def path(self) -> Array:
        """Poses (K, 3) of the keyframes that the grid is drawn along; a copy."""
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
        """Return the number of drawn scans before the first one whose keyframes have moved."""
        changed = np.ones(len(self._path) + 1, np.bool_)
        changed[: len(moved)] = moved
        changed[MAP_FRAME] = False  # the last element, which belongs to no keyframe
        if not changed.any():
            return self._drawn
        for number, item in enumerate(self._scans[: self._drawn]):
            if changed[item.keyframe] or any(changed[body.keyframe] for body in item.bodies):
                return number
        return self._drawn

    def _restore_snapshot(self, kept: int) -> None:
        """Return to the newest snapshot of at most this number of scans, or to an empty grid."""
        older = [count for count in self._snapshots if count <= kept]
        self._drawn = max(older, default=0)
        grid = self._snapshots[self._drawn].copy() if older else OccupancyGrid(self.config)
        self.grid = grid
        self._snapshots = {count: self._snapshots[count] for count in older}

    @staticmethod
    def _can_draw(item: KeyframeScan, poses: Array) -> bool:
        """Return whether the path (K, 3) holds all keyframes of a scan."""
        newest = max([item.keyframe, *(body.keyframe for body in item.bodies)])
        return newest < len(poses)

    def _draw(self, stop: int) -> int:
        """Draw the scans up to a number; return how many the grid refused."""
        items = self._scans[self._drawn : stop]
        self._drawn = stop
        placed = [self._placed(item) for item in items if self._in_map[item.keyframe]]
        errors = self.grid.insert_scans(placed)
        for error in errors:
            logger.warning('%s', error)
        return len(errors)

    def _placed(self, item: KeyframeScan) -> PlacedScan:
        """Return a scan at the pose that its keyframe has on the path."""
        poses = self._path
        keyframe = Pose2(*poses[item.keyframe].tolist())
        ignore = NO_BODIES
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
        pose = keyframe.compose(item.laser_in_keyframe)
        return PlacedScan(pose, item.scan, ignore, item.vehicle not in self._not_free)

    def _keep_snapshot(self) -> None:
        """Store the current grid; drop old snapshots by position and by memory."""
        positions = _snapshot_positions(self._drawn)
        self._snapshots = {n: grid for n, grid in self._snapshots.items() if n in positions}
        size = self.grid.evidence().nbytes / 1e6
        capacity = int(self.config.snapshot_memory / size) if size > 0.0 else 0
        if capacity > 0:
            self._snapshots[self._drawn] = self.grid.copy()
        for oldest in sorted(self._snapshots)[: max(0, len(self._snapshots) - capacity)]:
            del self._snapshots[oldest]
