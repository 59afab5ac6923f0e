"""Point clouds of 3-D lidars as scans: the nearest point of each bearing in a band of heights."""

import itertools
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import LaserScan, SweepTiming
from explore_slam.geometry import Array, Pose2, Pose3
from explore_slam.messages.base import seconds
from explore_slam.messages.clouds import cloud_field, cloud_points
from explore_slam.sweeps import LONGEST_SWEEP

_BEAMS = 720  # 0.5°; spinning 3-D lidars measure every 0.1° to 0.4°
# m; nearer points are the lidar's housing, and what drivers write for a ray without return
_NEAREST = 0.1
_FARTHEST = 200.0  # m; beyond the reach of any lidar of a vehicle
# Names that drivers give to the time of a point: velodyne, Ouster, Hesai and RoboSense, Livox
_TIMES = ('time', 't', 'timestamp', 'time_stamp', 'offset_time')
_TIMED_POINTS = 2000  # by which the turn of the lidar is found
_LEAST_TURN = 1.0  # rad in a sweep
# rad; lasers of a spinning lidar point up to 4° to either side of its bearing (VLP-32C)
_TURN_TOLERANCE = 0.15
_NANOSECOND = 1e-9  # s


class _Turn(NamedTuple):
    """How a lidar turns: bearing (rad) at the first beam, and rate (rad/s), negative: clockwise.

    begin: time of the first beam after the stamp of the message (s).
    """

    bearing: float
    rate: float
    begin: float


def cloud_scan(message: Any, lidar: Pose3, lowest: float, highest: float) -> LaserScan:
    """Return a PointCloud2 as a scan with the mount of its lidar.

    lidar: its pose in the vehicle frame, whose origin is on the floor. lowest, highest: heights
    (m) above the floor between which points count. A bearing without such a point is no
    measurement (NaN), not free: the lidar may have looked over or under what is there. Where the
    points have times and the lidar turns, the beams are in the order of their times.
    """
    points = cloud_points(message)
    ahead = lidar.rotation
    mount = Pose2(lidar.position[0], lidar.position[1], math.atan2(ahead[1, 0], ahead[0, 0]))
    valid = np.isfinite(points).all(axis=1)
    valid[valid] = (points[valid] ** 2).sum(axis=1) > _NEAREST**2
    places = points[valid] @ ahead.T + np.asarray(lidar.position)
    off = places[:, :2] - (mount.x, mount.y)
    ranges, bearings = np.hypot(off[:, 0], off[:, 1]), np.arctan2(off[:, 1], off[:, 0])
    bearings -= mount.theta
    stamp = seconds(message.header.stamp)
    times = _times(message, stamp)
    turn, middle = None, 0.0
    if times is not None:
        times = times[valid]
        middle = float(times.mean()) if len(times) else 0.0
        turn = _turn_of(times, bearings)
    band = (places[:, 2] >= lowest) & (places[:, 2] <= highest)
    band &= (ranges >= _NEAREST) & (ranges <= _FARTHEST)
    step = 2.0 * math.pi / _BEAMS
    first, increment, timing = -math.pi, step, SweepTiming()
    time_increment = 0.0
    if turn is not None:
        first, increment = turn.bearing, math.copysign(step, turn.rate)
        time_increment = step / abs(turn.rate)
        timing = SweepTiming(time_increment * (_BEAMS - 1), 'forward', 'first')
    nearest = np.full(_BEAMS, np.inf)
    beams = np.round((bearings[band] - first) / increment).astype(np.int64) % _BEAMS
    np.minimum.at(nearest, beams, ranges[band])
    nearest[np.isinf(nearest)] = np.nan
    return LaserScan(
        max(stamp + (turn.begin if turn is not None else middle), 0.0),
        first,
        increment,
        nearest.astype(np.float32),
        0.5 * _NEAREST,
        _FARTHEST,
        mount,
        time_increment=time_increment,
        timing=timing,
    )


def _times(message: Any, stamp: float) -> Array | None:
    """Return the times of the points after the stamp (N,) s; None where there are none."""
    for name in _TIMES:
        values = cloud_field(message, name)
        if values is None or not len(values):
            continue
        times: NDArray[np.float64] = values.astype(np.float64)
        finite = np.isfinite(times)
        if not finite.any():
            continue
        # seconds or nanoseconds, after the stamp or of its clock: the first that can be
        scales = (_NANOSECOND,) if values.dtype.kind in 'iu' else (1.0, _NANOSECOND)
        for scale, origin in itertools.product(scales, (0.0, stamp)):
            after = times * scale - origin
            if np.abs(after[finite]).max() <= LONGEST_SWEEP:
                after[~finite] = 0.0
                return after
    return None


def _turn_of(times: Array, bearings: Array) -> _Turn | None:
    """Return how the lidar turns, None if it does not: all at one moment, or in a pattern."""
    if len(times) < 3 or np.ptp(times) <= 0.0:
        return None
    order = np.argsort(times, kind='stable')[:: max(len(times) // _TIMED_POINTS, 1)]
    at, unwrapped = times[order], np.unwrap(bearings[order])
    middle = at.mean()
    away = at - middle
    rate = float(away @ (unwrapped - unwrapped.mean())) / float(away @ away)
    residuals = unwrapped - unwrapped.mean() - rate * away
    duration = float(np.ptp(times))
    if abs(rate) * duration < _LEAST_TURN or np.median(np.abs(residuals)) > _TURN_TOLERANCE:
        return None
    begin = float(times.min())
    return _Turn(float(unwrapped.mean() + rate * (begin - middle)), rate, begin)
