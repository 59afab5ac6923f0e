"""Errors of the wheel odometry in corrected CARMEN logs, as settings of the simulated odometry.

python benchmarks/noise_carmen.py LOG [LOG …]
Compares the odometry with the reference poses of each log over windows of the way, by default 5 m:
scale of turning and drift of the heading by least squares, and the variances that remain per metre
and per radian by maximum likelihood (iteratively reweighted, none below zero). Scale and variance
of the driven distance from windows of 1 m without turns. The reference has errors of its own, a
few centimetres, so that windows should not be shorter.
"""

import argparse
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from explore_slam.geometry import Array, between, wrap_angles
from explore_slam.recording.carmen_log import CarmenLog, read_carmen

STRAIGHT = 0.2  # rad; windows in which less is turned compare distances
STRAIGHT_WINDOW = 1.0  # m
ROUNDS = 20  # of reweighting, more than enough
LARGEST_ERROR = 1.0  # rad; beyond it the reference has lost the vehicle


class Windows(NamedTuple):
    """Motion in windows of the way: distance (W,) m and turn (W,) rad as driven back and forth.

    net (W,) rad: the turn with its sign; odometry and reference (W, 3): the motion.
    """

    distance: Array
    turn: Array
    net: Array
    odometry: Array
    reference: Array


def windows(log: CarmenLog, length: float) -> Windows:
    """Cut a log at scans into windows of a length (m)."""
    steps = np.hypot(*np.diff(log.odometry[:, :2], axis=0).T)
    turns = wrap_angles(np.diff(log.odometry[:, 2]))
    sums = (np.concatenate([[0.0], np.cumsum(s)])[log.rows] for s in (steps, np.abs(turns), turns))
    distance, turn, net = sums
    cuts = [0]
    for index, driven in enumerate(distance):
        if driven - distance[cuts[-1]] >= length:
            cuts.append(index)
    at: NDArray[np.int64] = np.array(cuts)
    odometry = log.odometry[log.rows][at]
    reference = np.array([scan.robot for scan in log.scans])[at]
    return Windows(
        np.diff(distance[at]),
        np.diff(turn[at]),
        np.diff(net[at]),
        between(odometry[:-1], odometry[1:]),
        between(reference[:-1], reference[1:]),
    )


def variances(squares: Array, factors: Array) -> Array:
    """Return the variances per unit of factors (W, K) that explain squared errors (W,)."""
    weights = np.ones(len(squares))
    found: Array = np.zeros(factors.shape[1])
    for _ in range(ROUNDS):
        found, _ = nnls(factors * weights[:, None], squares * weights)
        weights = 1.0 / np.maximum(factors @ found, 1e-9)
    return found


def print_noise(path: Path, length: float) -> None:
    """Print the errors of one log, named as the settings."""
    log = read_carmen(path)
    found = windows(log, length)
    error = wrap_angles(found.odometry[:, 2] - found.reference[:, 2])
    kept = np.abs(error) < LARGEST_ERROR
    causes = np.stack([found.net, found.distance], axis=1)[kept]
    (scale, drift), *_ = np.linalg.lstsq(causes, error[kept], rcond=None)
    rest = error[kept] - causes @ [scale, drift]
    per_metre, per_radian = variances(
        rest**2, np.stack([found.distance, found.turn], axis=1)[kept]
    )
    short = windows(log, STRAIGHT_WINDOW)
    straight = short.turn < STRAIGHT
    moved, truly = (
        np.hypot(*motion[straight, :2].T) for motion in (short.odometry, short.reference)
    )
    stretch = float(moved @ truly / (truly @ truly)) - 1.0
    spread = float(np.mean((moved - (1.0 + stretch) * truly) ** 2 / short.distance[straight]))
    print(
        f'{path.name}: {found.distance.sum():.0f} m, {kept.sum()} windows of {length:g} m, '
        f'{straight.sum()} straight ones\n'
        f'  simulated_heading_drift {drift:.4f} rad/m, simulated_turn_scale {scale:.4f}, '
        f'simulated_distance_scale {stretch:.4f}\n'
        f'  simulated_drift_variance {per_metre:.2e} rad²/m, simulated_turn_variance '
        f'{per_radian:.2e} rad²/rad, simulated_distance_variance {spread:.2e} m²/m'
    )


def main() -> None:
    """Print the errors of all logs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('logs', type=Path, nargs='+', metavar='LOG')
    parser.add_argument('--window', type=float, default=5.0, help='m (default 5)')
    arguments = parser.parse_args()
    for path in arguments.logs:
        print_noise(path, arguments.window)


if __name__ == '__main__':
    main()
