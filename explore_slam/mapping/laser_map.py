"""The grid drawn along the best particle's own path, redrawn from where lineages part.

Scans are kept with the keyframe they were taken at. A redraw compares the new path with the one
drawn last: scans before the first difference stand, the grid goes back to the newest snapshot
before it, and the rest is drawn again in the order in which it came. A cell is clamped, so order
matters; because it is kept, the result equals a drawing from scratch bit for bit.
"""

import logging
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from explore_slam.data import LaserScan
from explore_slam.errors import MappingError
from explore_slam.geometry import IDENTITY, Array, Pose2
from explore_slam.mapping.config import GridConfig
from explore_slam.mapping.occupancy_grid import NO_BODIES, OccupancyGrid

LOGGER = logging.getLogger(__name__)
SPACING = 16  # scans between the closest snapshots


class Body(NamedTuple):
    """Another vehicle at the time of a scan: last keyframe, pose since then, radius (m).

    keyframe -1 means that the offset is a pose in the map frame.
    """

    keyframe: int
    offset: Pose2
    radius: float


class KeyframeScan(NamedTuple):
    """One scan as it is kept, with the pose of the laser in its keyframe and the bodies around."""

    keyframe: int
    vehicle: str
    scan: LaserScan
    laser_in_keyframe: Pose2
    bodies: tuple[Body, ...]


class RedrawSummary(NamedTuple):
    """What a redraw did, in scans: stood, drawn, waiting for a keyframe, refused by the grid."""

    kept: int
    drawn: int
    waiting: int
    refused: int


def _snapshot_positions(count: int) -> set[int]:
    """Numbers of scans at which a snapshot is worth keeping: denser towards the present."""
    kept: set[int] = set()
    spacing = SPACING
    while spacing <= count:
        last = count // spacing * spacing
        kept.update({last, last - spacing})
        spacing *= 2
    return kept - {0}


class LaserMap:
    """All scans with their keyframes, and the grid along the best path."""

    def __init__(self, config: GridConfig | None = None) -> None:
        self.config = config or GridConfig()
        self.grid = OccupancyGrid(self.config)
        self._scans: list[KeyframeScan] = []
        self._drawn = 0
        self._path: Array = np.empty((0, 3))
        self._snapshots: dict[int, OccupancyGrid] = {}

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
        bodies: Sequence[Body] = (),
    ) -> None:
        """Keep a scan; it enters the grid at the next redraw whose path holds its keyframes."""
        if keyframe < 0:
            raise MappingError(f'keyframe is {keyframe}, expected the number of a keyframe, >= 0')
        self._scans.append(KeyframeScan(keyframe, vehicle, scan, laser_in_keyframe, tuple(bodies)))

    def redraw(self, path: ArrayLike) -> RedrawSummary:
        """Bring the grid onto the path (K, 3) of all keyframes.

        A path that is not finite is a MappingError and changes nothing; a scan that the grid
        refuses (too far out) is left out, logged and counted.
        """
        poses = np.array(path, np.float64)
        if poses.ndim != 2 or poses.shape[1] != 3 or not np.isfinite(poses).all():
            raise MappingError(
                f'path has shape {poses.shape} or values that are not finite, expected (K, 3)'
            )
        kept = self._standing_scans(poses)
        if kept < self._drawn:
            self._go_back(kept)
        start, refused = self._drawn, 0
        self._path = poses
        while self._drawn < len(self._scans) and self._can_draw(self._scans[self._drawn], poses):
            try:
                self._draw(self._scans[self._drawn], poses)
            except MappingError as error:
                LOGGER.warning('scan of keyframe %d: %s', self._scans[self._drawn].keyframe, error)
                refused += 1
            self._drawn += 1
            if self._drawn % SPACING == 0:
                self._keep_snapshot()
        return RedrawSummary(start, self._drawn - start, len(self._scans) - self._drawn, refused)

    def _standing_scans(self, poses: Array) -> int:
        """Count the drawn scans before the first whose poses differ from those it was drawn at."""
        common = min(len(poses), len(self._path))
        changed = np.ones(max(len(self._path), len(poses)) + 1, np.bool_)
        changed[:common] = (poses[:common] != self._path[:common]).any(axis=1)
        changed[-1] = False  # keyframe -1: the map frame itself
        if not changed[: len(self._path)].any():
            return self._drawn
        for number, item in enumerate(self._scans[: self._drawn]):
            if changed[item.keyframe] or any(changed[body.keyframe] for body in item.bodies):
                return number
        return self._drawn

    def _go_back(self, kept: int) -> None:
        older = [count for count in self._snapshots if count <= kept]
        self._drawn = max(older, default=0)
        grid = self._snapshots[self._drawn].copy() if older else OccupancyGrid(self.config)
        self.grid = grid
        self._snapshots = {count: self._snapshots[count] for count in older}

    @staticmethod
    def _can_draw(item: KeyframeScan, poses: Array) -> bool:
        newest = max([item.keyframe, *(body.keyframe for body in item.bodies)])
        return newest < len(poses)

    def _draw(self, item: KeyframeScan, poses: Array) -> None:
        keyframe = Pose2(*poses[item.keyframe].tolist())
        ignore = NO_BODIES
        if item.bodies:
            rows = []
            for body in item.bodies:
                base = IDENTITY if body.keyframe < 0 else Pose2(*poses[body.keyframe].tolist())
                place = base.compose(body.offset)
                rows.append((place.x, place.y, body.radius))
            ignore = np.array(rows)
        self.grid.insert_scan(keyframe.compose(item.laser_in_keyframe), item.scan, ignore)

    def _keep_snapshot(self) -> None:
        worth = _snapshot_positions(self._drawn)
        self._snapshots = {n: grid for n, grid in self._snapshots.items() if n in worth}
        size = self.grid.evidence().nbytes / 1e6
        room = int(self.config.snapshot_memory / size) if size > 0.0 else 0
        if room > 0:
            self._snapshots[self._drawn] = self.grid.copy()
        for oldest in sorted(self._snapshots)[: max(0, len(self._snapshots) - room)]:
            del self._snapshots[oldest]
