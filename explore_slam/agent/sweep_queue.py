"""Scans whose beams were measured one after the other: they wait for odometry of the sweep."""

import numpy as np

from explore_slam.agent.measurement_queue import MeasurementQueue
from explore_slam.agent.odometry import OdometryBuffer
from explore_slam.data import LaserScan
from explore_slam.geometry import Pose2
from explore_slam.sweeps import Sweep, SweepJudge, deskewed


class _Waiting:
    """A scan with its sweep; stamp: that of the scan as of one moment."""

    def __init__(self, scan: LaserScan, sweep: Sweep) -> None:
        self.scan, self.sweep = scan, sweep
        self.stamp = scan.stamp + sweep.middle
        self.end = scan.stamp + sweep.begin + sweep.duration


class SweepQueue:
    """Undoes the motion within the sweeps of one vehicle's laser.

    A scan waits until odometry has reached its last beam, at most a second of odometry after its
    first one: no sweep takes longer. It then leaves as a scan of one moment.
    """

    def __init__(self, vehicle: str) -> None:
        self.judge = SweepJudge(vehicle)
        self._waiting: MeasurementQueue[_Waiting] = MeasurementQueue()

    @property
    def first(self) -> float:
        """Stamp (s) at which the oldest waiting scan will count as measured; inf when empty."""
        return self._waiting.first

    def push(self, scan: LaserScan, sweep: Sweep, capacity: int) -> bool:
        """Queue a scan; return whether the oldest was dropped to keep the capacity."""
        return self._waiting.push(_Waiting(scan, sweep), capacity)

    def pop(self, odometry: OdometryBuffer, laser: Pose2) -> LaserScan | None:
        """Return the oldest scan whose sweep odometry covers, as of one moment, or None.

        laser: its pose in the vehicle frame, for scans without mount.
        """
        if not len(self._waiting) or self._waiting.oldest.end > odometry.last:
            return None
        item = self._waiting.pop()
        begin = item.scan.stamp + item.sweep.begin
        at, poses = odometry.path(begin, item.end)
        return deskewed(
            item.scan, item.sweep, np.array(at), np.array(poses), item.scan.mount or laser
        )

    def clear(self) -> None:
        """Drop what waits: the clock has jumped."""
        self._waiting.clear()
