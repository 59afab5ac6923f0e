"""Motion within a sweep: when each beam of a scan was measured, and scans as of one moment.

A spinning lidar measures its beams one after the other while the vehicle moves. At 5.5 Hz and
0.9 rad/s, the last beam of a turn is 9° off the first one. `deskewed` places every beam by the
poses of the vehicle at its own time; all that uses the scan afterwards takes it as measured at
one moment, the middle of the sweep, where the error of the poses matters least.
"""

import logging
import math
from collections import deque
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import LaserScan, SweepTiming
from explore_slam.geometry import Array, Pose2
from explore_slam.settings import Section, setting

logger = logging.getLogger(__name__)

LONGEST_SWEEP = 1.0  # s; the slowest spinning lidars turn at 1 Hz
# A sweep may take this many intervals between scans: stamps jitter, and scans are lost in pairs.
_LONGEST_SHARE = 1.5
# A laser that spins all the time sweeps from one scan to the next. A stated duration that differs
# from the interval by more than the first share is put to the test, until it differs by less than
# the second one. The first one turns the outermost beams by 0.012 rad too far or too little, a
# cell at 4 m (5.5 Hz, 0.9 rad/s). On the sensor rig, 20 % put 4 % of the cells off the walls,
# 14 % 2 %; statements that are right stay within both: the median interval hardly varies.
_IMPLAUSIBLE, _PLAUSIBLE = 0.15, 0.1
_ALL_AROUND = math.radians(350.0)  # field of view from which a laser counts as a spinning one
_INTERVALS = 9  # newest intervals between scans; their median is used
_FEWEST_INTERVALS = 3


@dataclass(frozen=True)
class SweepConfig(Section):
    """When the laser of a vehicle measures its beams."""

    sweep_time: float = setting(
        -1.0,
        'Time from the first to the last beam of a scan; 0: all at one moment; negative: as its '
        'messages say (time_increment), or as its scans show',
        unit='s',
        low=-1.0,
        high=LONGEST_SWEEP,
        tier='basic',
    )
    sweep_direction: str = setting(
        'auto',
        'Order in which the laser measures the beams of a message: forward, backward (for drivers '
        'that reverse the order of the beams), or auto, which is forward unless the scans show '
        'otherwise',
        choices=('auto', 'forward', 'backward'),
    )
    sweep_stamp: str = setting(
        'auto',
        'Which beam is measured at the stamp of a message: first, last (for drivers that stamp a '
        'scan when it is complete), or auto, which is first unless the scans show otherwise',
        choices=('auto', 'first', 'last'),
    )

    @property
    def record(self) -> SweepTiming:
        """The settings as they travel with a scan."""
        duration = None if self.sweep_time < 0.0 else self.sweep_time
        return SweepTiming(duration, self.sweep_direction, self.sweep_stamp)


class Sweep(NamedTuple):
    """When the beams of a scan are measured.

    duration: from the first beam to the last one (s). backward: against the order of the ranges.
    last: the stamp is that of the last beam by time, not of the first one.
    """

    duration: float
    backward: bool = False
    last: bool = False

    @property
    def begin(self) -> float:
        """Time of the first beam after the stamp (s)."""
        return -self.duration if self.last else 0.0

    @property
    def middle(self) -> float:
        """Time of the middle of the sweep after the stamp (s)."""
        return self.begin + 0.5 * self.duration

    def times(self, beams: int) -> Array:
        """Return when each beam is measured (B,), in s after the stamp."""
        shares = np.arange(beams) / max(beams - 1, 1)
        if self.backward:
            shares = 1.0 - shares
        return self.begin + self.duration * shares

    def __str__(self) -> str:
        order = 'last beam first' if self.backward else 'in the order of the message'
        at = 'last' if self.last else 'first'
        return f'a sweep of {self.duration:.3f} s, {order}, stamped at the {at} beam by time'


class SweepTest(NamedTuple):
    """Durations (s) of a sweep that scans are to be tested for, beside all beams at one moment.

    duration: 0 if no test is needed. stated: what the message states, if that is implausible and
    `duration` is the time between scans; else 0.
    """

    duration: float = 0.0
    stated: float = 0.0

    @property
    def longest(self) -> float:
        """The longest of the durations (s)."""
        return max(self)


NO_TEST = SweepTest()


def deskewed(scan: LaserScan, sweep: Sweep, at: Array, poses: Array, laser: Pose2) -> LaserScan:
    """Return a scan as if all its beams had been measured at once, in the middle of the sweep.

    at (m,) s, ascending, and poses (m, 3) of the vehicle there, in any frame; laser: its pose in
    the vehicle frame.

    A return becomes the range and bearing at which the laser would see it from where it is in the
    middle of the sweep; its end point is exact. The ray to it begins at that one place instead of
    where the laser was, which is beside it by half the motion in a sweep: 0.04 m at 0.4 m/s and
    5.5 Hz, less than a cell, where the vehicle itself has just been, and nothing at the end
    point. Beams without a return keep their range and are turned with the vehicle.
    """
    moment = scan.stamp + sweep.middle
    heading = np.unwrap(poses[:, 2])
    columns = (poses[:, 0], poses[:, 1], heading)
    times = scan.stamp + sweep.times(scan.ranges.size)
    x, y, theta = (np.interp(times, at, column) for column in columns)
    x0, y0, theta0 = (float(np.interp(moment, at, column)) for column in columns)
    # pose of the laser at each beam, in the frame of the vehicle in the middle of the sweep
    c, s = math.cos(theta0), math.sin(theta0)
    dx, dy, turn = x - x0, y - y0, theta - theta0
    cos, sin = np.cos(turn), np.sin(turn)
    mount_x = c * dx + s * dy + cos * laser.x - sin * laser.y - laser.x
    mount_y = c * dy - s * dx + sin * laser.x + cos * laser.y - laser.y
    # and from there into the frame of the laser in the middle of the sweep
    c, s = math.cos(laser.theta), math.sin(laser.theta)
    bearings = scan.angles + turn
    ranges = scan.ranges.astype(np.float64)
    valid = (ranges >= scan.range_min) & (ranges <= scan.range_max)
    reach = np.where(valid, ranges, 0.0)
    ends_x = c * mount_x + s * mount_y + reach * np.cos(bearings)
    ends_y = c * mount_y - s * mount_x + reach * np.sin(bearings)
    seen = np.hypot(ends_x, ends_y)
    bearings = np.where(valid, np.arctan2(ends_y, ends_x), bearings)
    # readings outside the limits stay what they are although the limits make room for the others
    ranges[ranges > scan.range_max] = np.inf
    ranges[np.isfinite(ranges) & (ranges < scan.range_min)] = np.nan
    ranges[valid] = seen[valid]
    made: NDArray[np.float32] = ranges.astype(np.float32)
    nearest = float(made[valid].min()) if valid.any() else scan.range_min
    farthest = float(made[valid].max()) if valid.any() else scan.range_max
    return replace(
        scan,
        stamp=moment,
        ranges=made,
        range_min=min(scan.range_min, nearest),
        range_max=max(scan.range_max, farthest),
        time_increment=sweep.duration / max(scan.ranges.size - 1, 1),
        bearings=bearings.astype(np.float32),
    )


class SweepJudge:
    """Determines when the beams of one laser are measured; implausible messages are logged once.

    found: the sweep that its scans have shown, where messages and settings do not give it.
    """

    def __init__(self, vehicle: str) -> None:
        self.vehicle = vehicle
        self.found: Sweep | None = None
        self._stamps: deque[float] = deque(maxlen=_INTERVALS + 1)
        self._warned = False
        self._implausible = False

    @property
    def interval(self) -> float | None:
        """Median time between the newest scans (s), None before there are enough."""
        if len(self._stamps) <= _FEWEST_INTERVALS:
            return None
        return float(np.median(np.diff(self._stamps)))

    def sweep_of(self, scan: LaserScan) -> Sweep | None:
        """Return when the beams of the newest scan were measured; None: at one moment, or unknown.

        Settings take precedence over what the scans have shown, and that over the messages.
        """
        if self._stamps and scan.stamp < self._stamps[-1] - LONGEST_SWEEP:
            self._stamps.clear()  # the clock has jumped back
        if not self._stamps or scan.stamp > self._stamps[-1]:
            self._stamps.append(scan.stamp)
        return self.known_sweep(scan)

    def known_sweep(self, scan: LaserScan) -> Sweep | None:
        """Return when the beams of a scan were measured, as far as known now; see sweep_of."""
        timing, found = scan.timing, self.found
        duration = timing.duration
        if duration is None:
            duration = found.duration if found is not None else self._stated(scan)
        if not duration or scan.ranges.size < 2:
            return None
        backward, last = timing.direction == 'backward', timing.stamp == 'last'
        if found is not None:
            backward = found.backward if timing.direction == 'auto' else backward
            last = found.last if timing.stamp == 'auto' else last
        return Sweep(duration, backward, last)

    def doubtful(self, scan: LaserScan) -> SweepTest:
        """Return how long a sweep takes if its beams are measured one after the other.

        No test is needed where the settings give the sweep, the scans have shown it, or the field
        of view is not that of a spinning lidar, so that the message is believed, and the beams
        count as measured at one moment if it states nothing. Call it after `sweep_of`.
        """
        beams, timing = scan.ranges.size, scan.timing
        if self.found is not None or timing.duration == 0.0 or beams < 2:
            return NO_TEST
        if beams * abs(scan.angle_increment) < _ALL_AROUND:
            return NO_TEST
        known = timing.duration or self._stated(scan)
        interval = self.interval
        between = 0.0
        if interval is not None:
            between = min(interval, LONGEST_SWEEP) * (beams - 1) / beams
        if not known:
            return SweepTest(between)
        if timing.duration is None and between and self._contradicts(known, between):
            return SweepTest(between, known)
        if 'auto' not in (timing.direction, timing.stamp):
            return NO_TEST
        return SweepTest(known)

    def _contradicts(self, stated: float, between: float) -> bool:
        """Return whether a stated duration is implausible for a laser that spins all the time.

        between: duration of a sweep that lasts from one scan to the next (s).
        """
        limit = _PLAUSIBLE if self._implausible else _IMPLAUSIBLE
        self._implausible = abs(stated - between) > limit * between
        return self._implausible

    def _stated(self, scan: LaserScan) -> float:
        """Return the duration of a sweep by the message (s), 0 if it gives none."""
        increment = scan.time_increment
        if increment == 0.0:
            return 0.0
        duration = increment * (scan.ranges.size - 1)
        problem = ''
        interval = self.interval or (scan.scan_time if scan.scan_time > 0.0 else math.inf)
        longest = min(LONGEST_SWEEP, _LONGEST_SHARE * interval)
        if not math.isfinite(increment) or increment < 0.0:
            problem = 'expected 0 or more'
        elif duration > longest:
            problem = f'that is {duration:.3g} s for a scan, expected at most {longest:.3g} s'
        if not problem:
            return duration
        if not self._warned:
            self._warned = True
            logger.warning(
                '%s: time_increment of the scans is %.4g s: %s. It is not used; correct the '
                'driver, or set %s.sweep_time (with sweep_direction: backward if the laser '
                'measures the last beam of a message first)',
                self.vehicle, increment, problem, self.vehicle,
            )  # fmt: skip
        return 0.0
