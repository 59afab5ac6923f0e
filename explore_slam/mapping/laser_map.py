"""Occupancy grid along the most likely path; see explore_slam.mapping.path_drawing."""

import logging
from collections.abc import Collection, Sequence
from typing import NamedTuple

from explore_slam.data import LaserScan
from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.mapping.config import GridConfig
from explore_slam.mapping.no_return import NoReturnJudge
from explore_slam.mapping.occupancy_grid import OccupancyGrid, PlacedScan
from explore_slam.mapping.path_drawing import PathDrawing, VehicleDisc

logger = logging.getLogger(__name__)


class KeyframeScan(NamedTuple):
    """A scan with its keyframe, the pose of the laser relative to it, and the other vehicles."""

    keyframe: int
    vehicle: str
    scan: LaserScan
    laser_in_keyframe: Pose2
    bodies: tuple[VehicleDisc, ...]

    @property
    def sensor(self) -> str:
        """Which laser of the vehicle it is from."""
        return self.scan.sensor


class LaserMap(PathDrawing[KeyframeScan, OccupancyGrid]):
    """Scans with their keyframes, and the occupancy grid along the most likely path.

    known_free: vehicles of whose beams it is known that those without return are free.
    """

    def __init__(self, config: GridConfig | None = None, known_free: Collection[str] = ()) -> None:
        self.config = config or GridConfig()
        super().__init__(self.config.snapshot_memory)
        self._known_free = frozenset(known_free)
        self._judges: dict[str, NoReturnJudge] = {}
        self._not_free: set[str] = set()  # vehicles whose no returns the drawn scans did not free

    def _empty(self) -> OccupancyGrid:
        return OccupancyGrid(self.config)

    @property
    def grid(self) -> OccupancyGrid:
        """The grid as it was drawn last."""
        return self._canvas

    @property
    def no_returns(self) -> dict[str, tuple[float, bool]]:
        """Share of the beams without return of each vehicle, and whether they free cells."""
        return {name: (judge.share, self._is_free(name)) for name, judge in self._judges.items()}

    def _is_free(self, vehicle: str) -> bool:
        meaning = self.config.no_return_meaning
        if meaning == 'auto':
            return vehicle in self._known_free or self._judges[vehicle].is_free
        return meaning == 'free'

    @property
    def scans(self) -> Sequence[KeyframeScan]:
        """The scans that are kept, in the order in which they were added."""
        return tuple(self._held())

    def add(
        self,
        keyframe: int,
        vehicle: str,
        scan: LaserScan,
        laser_in_keyframe: Pose2 = IDENTITY,
        bodies: Sequence[VehicleDisc] = (),
    ) -> None:
        """Store a scan; it enters the grid at the next redraw whose path holds its keyframes."""
        self._append(KeyframeScan(keyframe, vehicle, scan, laser_in_keyframe, tuple(bodies)))
        self._judges.setdefault(vehicle, NoReturnJudge()).add(scan)

    def _must_start_over(self) -> bool:
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
            item.vehicle in changed for item in self._held(stop=self._drawn)
        )

    def _draw_items(self, items: Sequence[KeyframeScan]) -> int:
        errors = self.grid.insert_scans([self._placed(item) for item in items])
        for error in errors:
            logger.warning('%s', error)
        return len(errors)

    def _pose(self, item: KeyframeScan) -> Pose2:
        return Pose2(*self._path[item.keyframe].tolist()).compose(item.laser_in_keyframe)

    def _placed(self, item: KeyframeScan) -> PlacedScan:
        """Return a scan at the pose that its keyframe has on the path."""
        is_free = item.vehicle not in self._not_free
        return PlacedScan(self._pose(item), item.scan, self._discs(item), is_free)
