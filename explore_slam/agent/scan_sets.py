"""Scans of several lasers of one vehicle, which are matched together.

Each of two lasers sees half of a place. Matched one by one, each would be compared with what the
other one has seen, and the kept scans would show one half only; matched together they are as good
as one laser that sees all around.
"""

from typing import NamedTuple

from explore_slam.registration import PointCloud

_SILENT = 1.0  # s; a laser without a scan for longer is not waited for
# Share of the time between two scans of a laser after which its scan is not held back for the
# others any more: the next set, with its next scan, is closer together.
_LATE = 0.6


class PlacedCloud(NamedTuple):
    """The cloud of a scan, in the vehicle frame at its stamp (s)."""

    stamp: float
    cloud: PointCloud


class ScanSets:
    """Collects the clouds of a vehicle's lasers to sets of one cloud per laser at most.

    A set is complete when it holds a cloud of every laser that is at work. With one laser, every
    cloud is a set.
    """

    def __init__(self) -> None:
        self._pending: dict[str, PlacedCloud] = {}
        self._newest: dict[str, float] = {}  # laser -> stamp (s)
        self._periods: dict[str, float] = {}  # laser -> time between its two newest scans (s)

    @property
    def first(self) -> float:
        """Stamp (s) of the oldest cloud that waits for others; inf if none does."""
        return min((item.stamp for item in self._pending.values()), default=float('inf'))

    def add(self, laser: str, stamp: float, cloud: PointCloud) -> list[list[PlacedCloud]]:
        """Add the cloud of a laser; return the sets that are complete, oldest first.

        Stamps ascend.
        """
        ready = []
        if laser in self._newest:
            self._periods[laser] = stamp - self._newest[laser]
        self._newest[laser] = stamp
        if laser in self._pending or self._is_late(stamp):
            ready.append(self._take())
        self._pending[laser] = PlacedCloud(stamp, cloud)
        working = {name for name, last in self._newest.items() if last > stamp - _SILENT}
        if working <= self._pending.keys():
            ready.append(self._take())
        return [clouds for clouds in ready if clouds]

    def _is_late(self, stamp: float) -> bool:
        """Return whether a cloud that waits is farther from a stamp than its successor will be."""
        return any(
            stamp - item.stamp > _LATE * self._periods.get(name, float('inf'))
            for name, item in self._pending.items()
        )

    def _take(self) -> list[PlacedCloud]:
        clouds = sorted(self._pending.values(), key=lambda item: item.stamp)
        self._pending.clear()
        return clouds

    def clear(self) -> None:
        """Forget all: the clock has jumped."""
        self._pending.clear()
        self._newest.clear()
        self._periods.clear()
