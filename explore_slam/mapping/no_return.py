"""What beams without return (+inf) mean: nothing within range, or nothing measured.

REP-117 has +inf for objects beyond the range of the scanner. Many scanners report it as well where
light is absorbed or reflected away (dark or shiny surfaces, glass, grazing incidence); cells along
such beams must not be freed.

The ranges themselves tell which it is. In a scene of scattered objects, free paths are
distributed exponentially, P(r > x) = exp(-x / mean free path). So if a share s of the beams goes
beyond the range R, a share s^(2/3) - s ends between 2/3 R and R. Where nearly none do, although
many beams have no return, it is not for the distance. Open space in a wide sector, as beside a
building, is no such scene and does not count.
"""

import math

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import LaserScan

_OUTER = 2.0 / 3.0  # of the range: from there on beams count as long
# Share of beams without return from which on it is judged what they mean, as fewer change little,
# and below which they count as free again.
_LEAST_SHARE, _FEW = 0.05, 0.03
_LEAST_EXPECTED = 0.03  # share of long beams; with fewer expected, as in the open, none is no sign
_LEAST_BEAMS = 500
# Angle of a sector in which no beam returns, from which on it is open space. The lidar that loses
# 23 % of its beams (bags/turtlebot_lidar_turned) loses up to 35 degrees in a row.
_OPEN_SECTOR = math.radians(60.0)
# Share of the expected long beams from which on they are believed, and below which they are not.
# test_no_return shows what they decide; it is 0.06 for the lidar named above.
_BELIEVED, _DOUBTED = 0.2, 0.12


class NoReturnJudge:
    """Decides for one vehicle whether its beams without return were long.

    It depends on the scans in their order alone.
    """

    def __init__(self) -> None:
        self._valid = self._no_returns = 0
        self._judged = self._doubtful = self._long = 0  # without sectors of open space
        self._is_free = True

    def add(self, scan: LaserScan) -> None:
        """Count the beams of a scan."""
        ranges = scan.ranges
        valid = int(np.count_nonzero(ranges >= scan.range_min))  # neither NaN nor -inf
        none = ranges > scan.range_max
        doubtful, no_returns = _in_short_runs(none, scan.angle_increment), int(none.sum())
        self._valid += valid
        self._no_returns += no_returns
        self._judged += valid - no_returns + doubtful
        self._doubtful += doubtful
        self._long += int(np.count_nonzero((ranges > _OUTER * scan.range_max) & ~none))
        if self._judged < _LEAST_BEAMS:
            return
        share = self._doubtful / self._judged
        expected = share**_OUTER - share
        ratio = self._long / self._judged / max(expected, _LEAST_EXPECTED)
        few = share < (_LEAST_SHARE if self._is_free else _FEW)
        if few or expected < _LEAST_EXPECTED or ratio > _BELIEVED:
            self._is_free = True
        elif ratio < _DOUBTED:
            self._is_free = False

    @property
    def share(self) -> float:
        """Share of the beams without return."""
        return self._no_returns / max(self._valid, 1)

    @property
    def is_free(self) -> bool:
        """Whether space along beams without return is taken to be free."""
        return self._is_free


def _in_short_runs(none: NDArray[np.bool_], step: float) -> int:
    """Count the beams without return that lie in no sector of open space; step: rad."""
    others = np.flatnonzero(~none)
    if not others.size:
        return 0
    runs = np.diff(others, append=others[0] + none.size) - 1  # the last one may go round
    return int(runs[runs * abs(step) < _OPEN_SECTOR].sum())
