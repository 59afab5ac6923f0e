"""Poses between keyframes, propagated by odometry, so that errors count evenly over time.

A filter estimates poses at keyframes. Where landmarks are rare these are far apart, which is just
where errors grow: statistics over keyframes alone would understate them.
"""

import numpy as np
from numpy.typing import NDArray

from explore_slam.geometry import Array, between, compose, wrap_angles
from explore_slam.results.trajectory import Trajectory
from explore_slam.slam import OdometryCalibration

# Sampling period (s) between keyframes: at 0.5 m/s a sample every 10 cm.
PERIOD = 0.2


def extrapolate(keyframes: Trajectory, odometry: Trajectory, period: float = PERIOD) -> Trajectory:
    """Return the keyframes and, after each, its pose propagated by odometry until the next one.

    This is what was known of the vehicle online. Samples are at least `period` (s) apart.
    """
    if not len(keyframes) or len(odometry) < 2:
        return keyframes
    stamps = _sample_stamps(keyframes, odometry, period, float(odometry.stamps[-1]))
    poses, _ = _dead_reckoning(keyframes, odometry, stamps)
    return Trajectory(stamps, poses)


def interpolate(keyframes: Trajectory, odometry: Trajectory, period: float = PERIOD) -> Trajectory:
    """Return the keyframes with poses between them that follow odometry from each to the next.

    The error of odometry at the next keyframe is distributed linearly over the time between.
    """
    if len(keyframes) < 2 or len(odometry) < 2:
        return keyframes
    stamps = _sample_stamps(keyframes, odometry, period, float(keyframes.stamps[-1]))
    poses, last = _dead_reckoning(keyframes, odometry, stamps)
    ends, _ = _dead_reckoning(keyframes, odometry, keyframes.stamps[1:], side='left')
    closure = np.zeros((len(keyframes), 3))
    closure[:-1] = keyframes.poses[1:] - ends
    closure[:, 2] = wrap_angles(closure[:, 2])
    span = np.append(np.diff(keyframes.stamps), 1.0)[last]
    fraction = (stamps - keyframes.stamps[last]) / span
    poses = poses + fraction[:, None] * closure[last]
    poses[:, 2] = wrap_angles(poses[:, 2])
    return Trajectory(stamps, poses)


def calibrated_path(odometry: Trajectory, calibration: OdometryCalibration) -> Trajectory:
    """Return the path of wheel odometry with its systematic errors corrected."""
    if len(odometry) < 2:
        return odometry
    steps = between(odometry.poses[:-1], odometry.poses[1:])
    turns = calibration.turn_scale * steps[:, 2]
    turns += calibration.heading_drift_rad_per_m * steps[:, 0]
    headings = odometry.poses[0, 2] + np.concatenate([[0.0], np.cumsum(turns)])
    c, s = np.cos(headings[:-1]), np.sin(headings[:-1])
    dx, dy = calibration.distance_scale * steps[:, :2].T
    moves = np.column_stack([c * dx - s * dy, s * dx + c * dy])
    positions = odometry.poses[0, :2] + np.vstack([np.zeros(2), np.cumsum(moves, axis=0)])
    return Trajectory(odometry.stamps, np.column_stack([positions, wrap_angles(headings)]))


def _sample_stamps(
    keyframes: Trajectory, odometry: Trajectory, period: float, end: float
) -> Array:
    """Return the stamps of the keyframes and of odometry where keyframes are further apart."""
    chosen = keyframes.stamps
    inside = odometry.stamps[(odometry.stamps > chosen[0]) & (odometry.stamps <= end)]
    if inside.size:
        # One reading per period, and none within half a period of a keyframe.
        bins = np.floor((inside - chosen[0]) / period)
        firsts = inside[np.concatenate([[True], np.diff(bins) > 0.0])]
        right = np.searchsorted(chosen, firsts)
        after = np.abs(chosen[np.minimum(right, len(chosen) - 1)] - firsts)
        before = np.abs(firsts - chosen[np.maximum(right - 1, 0)])
        firsts = firsts[np.minimum(before, after) > 0.5 * period]
        chosen = np.sort(np.concatenate([chosen, firsts]))
    return chosen


def _dead_reckoning(
    keyframes: Trajectory, odometry: Trajectory, stamps: Array, side: str = 'right'
) -> tuple[Array, NDArray[np.intp]]:
    """Propagate keyframes by odometry; return poses (N, 3) and indices (N,) of the keyframes."""
    found = np.searchsorted(keyframes.stamps, stamps, 'right' if side == 'right' else 'left')
    last = np.clip(found - 1, 0, len(keyframes) - 1)
    # Outside the recorded odometry its first or last pose is held, as the agent does.
    begin, end = odometry.stamps[0], odometry.stamps[-1]
    now, _ = odometry.at(np.clip(stamps, begin, end), np.inf)
    then, _ = odometry.at(np.clip(keyframes.stamps[last], begin, end), np.inf)
    return compose(keyframes.poses[last], between(then, now)), last
