"""Scans whose beams were measured one after the other: they wait for odometry of the sweep."""

import logging
from collections import deque

import numpy as np

from explore_slam.agent.measurement_queue import MeasurementQueue
from explore_slam.agent.odometry import OdometryBuffer
from explore_slam.agent.sweep_detection import SweepDetector
from explore_slam.data import LaserScan, OdometryReading
from explore_slam.geometry import Pose2
from explore_slam.sweeps import NO_TEST, Sweep, SweepJudge, SweepTest, deskewed

logger = logging.getLogger(__name__)

# Scans of a turning vehicle are held back once, until they have shown the timing of sweeps.
_LONGEST_HOLD = 4.0  # s; the first turn of the sensor rig takes less
_MOST_HELD = 40  # scans; fewer than the 50 that may wait for odometry by default
_DISTORTED = 0.01  # rad; a turn within a sweep from which a scan is held back: half a cell at 3 m


class _Waiting:
    """A scan that waits for odometry.

    sweep: None if all beams were measured at one moment. stamp: of the scan after deskewing (s).
    test: assumed durations of the sweep while its timing is unknown.
    """

    def __init__(self, scan: LaserScan, sweep: Sweep | None, test: SweepTest) -> None:
        self.scan, self.sweep, self.test = scan, sweep, test
        self.stamp = self.end = scan.stamp
        if sweep is not None:
            self.stamp += sweep.middle
            self.end += sweep.begin + sweep.duration
        if test.duration:
            self.end = max(self.end, scan.stamp + test.longest)


class SweepQueues:
    """The sweeps of all lasers of a vehicle, one queue per laser."""

    def __init__(self, vehicle: str) -> None:
        self._vehicle = vehicle
        # it knows the odometry from before the first scan, and becomes that of the first laser
        self._first = SweepQueue(vehicle)
        self._by_laser: dict[str, SweepQueue] = {}
        self._may_hold = True

    def of(self, laser: str) -> 'SweepQueue':
        """Return the queue of a laser; '' is that of a vehicle with one laser."""
        queue = self._by_laser.get(laser)
        if queue is None:
            queue = SweepQueue(self._vehicle) if self._by_laser else self._first
            if laser:
                queue.name(f'{self._vehicle}, {laser}')
            if not self._may_hold:
                queue.never_hold()
            self._by_laser[laser] = queue
        return queue

    @property
    def all(self) -> list['SweepQueue']:
        """The queues of all lasers."""
        return list(self._by_laser.values()) or [self._first]

    @property
    def several(self) -> bool:
        """Whether the vehicle has several lasers."""
        return len(self._by_laser) > 1

    @property
    def first(self) -> float:
        """Stamp (s) at which the oldest waiting scan will count as measured; inf when empty."""
        return min(queue.first for queue in self.all)

    def never_hold(self) -> None:
        """Hold no scan back until its timing is known: scans are all that shows the motion."""
        self._may_hold = False

    def found(self) -> dict[str, Sweep]:
        """Return laser -> what its scans have shown, where they have shown it."""
        return {
            laser: queue.judge.found
            for laser, queue in self._by_laser.items()
            if queue.judge.found is not None
        }

    def add_odometry(self, reading: OdometryReading, jumped: bool) -> None:
        """Add a reading as the base reports it; jumped: it does not continue those before."""
        for queue in self.all:
            if jumped:
                queue.detector.clear()
            queue.detector.add_odometry(reading)

    def keep_knowledge(self, other: 'SweepQueues') -> None:
        """Take over what the scans have shown to other queues of the same vehicle."""
        for laser, queue in other._by_laser.items():
            self.of(laser).keep_knowledge(queue)

    def clear(self) -> None:
        """Drop what waits: the clock has jumped."""
        for queue in self.all:
            queue.clear()


class SweepQueue:
    """Undoes the motion within the sweeps of one vehicle's laser.

    A scan waits until odometry has reached its last beam, at most a second of odometry after its
    first one: no sweep takes longer. It then leaves as a scan of one moment. Where the timing of
    the sweeps is unknown, the scans of the first turn are held back until they have shown it.
    """

    def __init__(self, vehicle: str) -> None:
        self.judge = SweepJudge(vehicle)
        self.detector = SweepDetector(vehicle)
        self._waiting: MeasurementQueue[_Waiting] = MeasurementQueue()
        self._held: deque[LaserScan] = deque()
        self._may_hold = True
        self.newest_end = -np.inf  # s; of the last beam of the newest scan

    def never_hold(self) -> None:
        """Hold no scan back."""
        self._may_hold = False

    def name(self, laser: str) -> None:
        """Name the laser in all messages."""
        self.judge.vehicle = self.detector.vehicle = laser

    @property
    def first(self) -> float:
        """Stamp (s) at which the oldest waiting scan will count as measured; inf when empty.

        Scans that are held back do not count: nothing else waits for them.
        """
        return self._waiting.first

    def takes(self, scan: LaserScan, capacity: int) -> bool | None:
        """Queue a scan if the motion within its sweep may have to be undone.

        Return None for a scan that can be used as it is, else whether the oldest one was dropped
        to keep the capacity.
        """
        sweep = self.judge.sweep_of(scan)
        test = NO_TEST if self.detector.is_done else self.judge.doubtful(scan)
        item = _Waiting(scan, sweep, test)
        self.newest_end = item.end
        if sweep is None and not test.duration and not len(self._waiting):
            return None  # else it waits behind earlier scans, so that they stay in order
        return self._waiting.push(item, capacity)

    def pop(self, odometry: OdometryBuffer, laser: Pose2) -> LaserScan | None:
        """Return the oldest scan whose sweep odometry covers, as of one moment, or None.

        laser: its pose in the vehicle frame, for scans without mount.
        """
        while len(self._waiting) and self._waiting.oldest.end <= odometry.last:
            item = self._waiting.pop()
            scan, mount = item.scan, item.scan.mount or laser
            sweep = item.sweep
            if item.test.duration:
                held = self._holds(scan, item.test.longest)
                if not self.detector.is_done:
                    self._test(scan, item.test, mount, held)
                if held:
                    self._hold(scan)
                    continue
                sweep = self.judge.known_sweep(scan)
            if sweep is None:
                return scan
            begin = scan.stamp + sweep.begin
            at, poses = odometry.path(begin, begin + sweep.duration)
            return deskewed(scan, sweep, np.array(at), np.array(poses), mount)
        return None

    def _test(self, scan: LaserScan, test: SweepTest, laser: Pose2, held: bool) -> None:
        """Compare a scan with earlier ones, which may show the timing of the sweeps."""
        self.detector.add(scan, test.duration, laser, test.stated)
        found = self.detector.found
        if found is None:
            return
        if not held and self.judge.known_sweep(scan) != found and found.duration > 0.0:
            logger.warning(
                '%s: the motion within its sweeps was not undone rightly until now; call the '
                'service reset if the map so far is distorted',
                self.judge.vehicle,
            )
        self.judge.found = found

    def _holds(self, scan: LaserScan, duration: float) -> bool:
        """Return whether a scan is to be held back: the vehicle turns, or those before it are."""
        if not self._may_hold or self.detector.is_done:
            return False
        turn = self.detector.turn_within(scan, duration)
        return bool(self._held) or turn >= _DISTORTED

    def _hold(self, scan: LaserScan) -> None:
        """Hold a scan back; queue all again when the timing is known, or in the end."""
        self._held.append(scan)
        waited = scan.stamp - self._held[0].stamp
        if self.detector.is_done or waited > _LONGEST_HOLD or len(self._held) >= _MOST_HELD:
            self._may_hold = False
            for one in self._held:
                again = _Waiting(one, self.judge.known_sweep(one), NO_TEST)
                self._waiting.push(again, len(self._waiting) + 1)
            self._held.clear()

    def keep_knowledge(self, other: 'SweepQueue') -> None:
        """Take over what the scans have shown to another queue of the same laser."""
        self.judge, self.detector = other.judge, other.detector
        self._may_hold = other._may_hold
        self.detector.clear()

    def clear(self) -> None:
        """Drop what waits: the clock has jumped."""
        self.newest_end = -np.inf
        self._waiting.clear()
        self._held.clear()
        self.detector.clear()
