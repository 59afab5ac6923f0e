"""Trajectories with six degrees of freedom, as motion capture measures them."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation, Slerp

from explore_slam.errors import EvaluationError
from explore_slam.geometry import Array, yaw_from_quaternion
from explore_slam.results.trajectory import Trajectory

# Motion capture runs at 100 Hz or more; a longer gap than this (s) means that markers were hidden.
MAX_GAP = 0.1


class SpatialTrajectory:
    """Positions (T, 3) m and quaternions (T, 4) x, y, z, w at stamps (T,) s, T >= 2.

    Samples may come in any order; of equal stamps the first sample is kept.
    """

    def __init__(self, stamps: ArrayLike, positions: ArrayLike, quaternions: ArrayLike) -> None:
        times, first = np.unique(np.asarray(stamps, dtype=np.float64), return_index=True)
        if times.size < 2:
            raise EvaluationError(
                f'spatial trajectory: {times.size} distinct stamps, expected at least 2'
            )
        self._stamps = times
        self._positions = np.asarray(positions, dtype=np.float64)[first]
        self._quaternions = np.asarray(quaternions, dtype=np.float64)[first]
        if self._positions.shape != (len(times), 3) or self._quaternions.shape != (len(times), 4):
            raise EvaluationError(
                f'spatial trajectory: positions {self._positions.shape} and quaternions '
                f'{self._quaternions.shape} for {len(times)} stamps, expected (T, 3) and (T, 4)'
            )
        self._slerp = Slerp(times, Rotation.from_quat(self._quaternions))

    @property
    def span(self) -> tuple[float, float]:
        """First and last stamp (s)."""
        return float(self._stamps[0]), float(self._stamps[-1])

    def at(self, stamp: float, max_gap: float = MAX_GAP) -> tuple[Array, Array] | None:
        """Return the rotation (3, 3) and the position (3,) m at a stamp (s).

        Positions are interpolated linearly, rotations along the great circle (Shoemake, 1985).
        None outside the trajectory, and inside a gap of more than max_gap (s).
        """
        right = int(np.searchsorted(self._stamps, stamp))
        if right < len(self._stamps) and self._stamps[right] == stamp:
            return self._slerp(stamp).as_matrix(), self._positions[right].copy()
        if not 0 < right < len(self._stamps):
            return None
        before, after = self._stamps[right - 1], self._stamps[right]
        if after - before > max_gap:
            return None
        fraction = (stamp - before) / (after - before)
        step = self._positions[right] - self._positions[right - 1]
        return self._slerp(stamp).as_matrix(), self._positions[right - 1] + fraction * step

    def planar(self) -> Trajectory:
        """Return the projection onto the plane: x, y and yaw."""
        yaw = [yaw_from_quaternion(*q) for q in self._quaternions.tolist()]
        return Trajectory.of(self._stamps, np.column_stack([self._positions[:, :2], yaw]))
