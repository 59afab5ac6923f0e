"""Poses between keyframes, from odometry, so that errors count evenly over time.

A filter moves at keyframes; where landmarks are rare these lie far apart, just where errors grow.
"""

import numpy as np
from numpy.typing import NDArray

from explore_slam.results.trajectory import Trajectory
from explore_slam.geometry import Array, between, compose, wrap_angles

PERIOD = 0.2


def carried_on(keyframes: Trajectory, odometry: Trajectory, period: float = PERIOD) -> Trajectory:
    """Return the keyframes and, after each, the poses that odometry makes of it until the next.

    That is what a vehicle knew at each time. Samples lie at least `period` (s) apart.
    """
    if not len(keyframes) or len(odometry) < 2:
        return keyframes
    stamps = _samples(keyframes, odometry, period, float(odometry.stamps[-1]))
    poses, _ = _dead_reckoned(keyframes, odometry, stamps)
    return Trajectory(stamps, poses)


def filled(keyframes: Trajectory, odometry: Trajectory, period: float = PERIOD) -> Trajectory:
    """Return the keyframes with poses between them that follow odometry from each to the next.

    What odometry is off by at the next keyframe is shared out evenly over the time between.
    """
    if len(keyframes) < 2 or len(odometry) < 2:
        return keyframes
    stamps = _samples(keyframes, odometry, period, float(keyframes.stamps[-1]))
    poses, last = _dead_reckoned(keyframes, odometry, stamps)
    ends, _ = _dead_reckoned(keyframes, odometry, keyframes.stamps[1:], side='left')
    rest = np.zeros((len(keyframes), 3))
    rest[:-1] = keyframes.poses[1:] - ends
    rest[:, 2] = wrap_angles(rest[:, 2])
    span = np.append(np.diff(keyframes.stamps), 1.0)[last]
    share = (stamps - keyframes.stamps[last]) / span
    poses = poses + share[:, None] * rest[last]
    poses[:, 2] = wrap_angles(poses[:, 2])
    return Trajectory(stamps, poses)


def _samples(keyframes: Trajectory, odometry: Trajectory, period: float, end: float) -> Array:
    """Return the stamps of the keyframes and of odometry where these are further apart."""
    chosen = keyframes.stamps
    inside = odometry.stamps[(odometry.stamps > chosen[0]) & (odometry.stamps <= end)]
    if inside.size:
        # one reading per period, and none that a keyframe lies close to
        bins = np.floor((inside - chosen[0]) / period)
        firsts = inside[np.concatenate([[True], np.diff(bins) > 0.0])]
        right = np.searchsorted(chosen, firsts)
        after = np.abs(chosen[np.minimum(right, len(chosen) - 1)] - firsts)
        before = np.abs(firsts - chosen[np.maximum(right - 1, 0)])
        firsts = firsts[np.minimum(before, after) > 0.5 * period]
        chosen = np.sort(np.concatenate([chosen, firsts]))
    return chosen


def _dead_reckoned(
    keyframes: Trajectory, odometry: Trajectory, stamps: Array, side: str = 'right'
) -> tuple[Array, NDArray[np.intp]]:
    """Return poses (N, 3) at the stamps and the index (N,) of the keyframe each came from."""
    found = np.searchsorted(keyframes.stamps, stamps, 'right' if side == 'right' else 'left')
    last = np.clip(found - 1, 0, len(keyframes) - 1)
    # outside of the odometry its ends hold, as in the agent
    begin, end = odometry.stamps[0], odometry.stamps[-1]
    now, _ = odometry.at(np.clip(stamps, begin, end), np.inf)
    then, _ = odometry.at(np.clip(keyframes.stamps[last], begin, end), np.inf)
    return compose(keyframes.poses[last], between(then, now)), last
