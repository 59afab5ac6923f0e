"""Noise of the robots of MR.CLAM: odometry, camera, and how long errors of the camera last.

python benchmarks/noise_mrclam.py FOLDER [FOLDER …]
Compares odometry and measurements with the motion capture, for each robot and for all together.
`explore_slam.recording.importers.mrclam` has its figures from here.

Distance: the line that fits the true distances over logged range / cos(bearing), the depth along
the optical axis. All else is of distances and odometry as the importer corrects them.

Odometry, moved by the delay with which the robots follow it: scale of turning and of driving and
drift of the heading by least squares over windows of 2 s, then the variances that remain, per
metre and per radian. Camera: bias and standard deviation (robust: 1.4826 times the median
deviation) of bearing and distance. Correlation of the errors of one landmark seen twice, by the
time between; the time in which it falls to 1/e; the distance and the angle that are driven in
three times as much, since all three count together.
"""

import argparse
import itertools
from pathlib import Path
from typing import NamedTuple

import mrclam
import numpy as np

from explore_slam.geometry import Array, wrap_angles
from explore_slam.recording.importers.mrclam import integrate_velocities, odometry_delay

WINDOW = 2.0  # s, in which motion is compared
LARGEST_ERROR = (1.0, 0.2)  # m, rad: beyond it a measurement is an outlier
EDGES = (0.0, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 1000.0)  # s between two observations
GAPS = (1, 2, 4, 8, 16, 32)  # observations between two that are compared
TO_DEVIATION = 1.4826  # of the median absolute deviation of a normal distribution


class Motion(NamedTuple):
    """What windows of odometry and truth say: (W,) each, and positions (W, 2)."""

    turn: Array
    true_turn: Array
    moved: Array
    truly_moved: Array
    distance: Array
    angle: Array


class Errors(NamedTuple):
    """Measurements of landmarks against the truth: (N,) each.

    distance and angle: how far the robot has driven and turned until then.
    """

    stamp: Array
    subject: Array
    range: Array
    bearing: Array
    range_error: Array
    bearing_error: Array
    distance: Array
    angle: Array


def print_distances(team: mrclam.Team) -> None:
    """Print how the true distances follow from logged ranges and bearings."""
    depths, distances, shares = [], [], []
    for robot in team.robots:
        found = camera_errors(team, robot)
        depths.append((found.range + found.range_error) / np.cos(found.bearing))
        distances.append(found.range)
        shares.append(found.range_error / found.range)
    depth, distance = np.concatenate(depths), np.concatenate(distances)
    A = np.stack([depth, np.ones(len(depth))], axis=1)
    (scale, offset), *_ = np.linalg.lstsq(A, distance, rcond=None)
    rest = (distance - A @ [scale, offset]) / distance
    print(
        f'distance = {scale:.4f} · range / cos(bearing) {offset:+.3f} m; error '
        f'{_deviation(rest):.4f} of the distance, '
        f'of the logged range {_deviation(np.concatenate(shares)):.4f}'
    )


def motion(team: mrclam.Team, recording: mrclam.Recording) -> Motion:
    """Compare the odometry of a robot with its truth, window by window."""
    stamps, poses = integrate_velocities(recording.odometry, team.begin, team.end)
    edges = np.arange(team.begin, team.end, WINDOW)
    heading = np.unwrap(poses[:, 2])
    odometry = np.stack(
        [np.interp(edges, stamps, c) for c in (poses[:, 0], poses[:, 1], heading)], axis=1
    )
    truth = mrclam.true_poses(recording, edges)
    driven = np.interp(edges, stamps, _summed(np.hypot(*np.diff(poses[:, :2], axis=0).T)))
    turned = np.interp(edges, stamps, _summed(np.abs(np.diff(heading))))
    return Motion(
        np.diff(odometry[:, 2]),
        np.diff(truth[:, 2]),
        _in_first(odometry),
        _in_first(truth),
        np.diff(driven),
        np.diff(turned),
    )


def _summed(steps: Array) -> Array:
    return np.concatenate([[0.0], np.cumsum(steps)])


def _in_first(poses: Array) -> Array:
    """Return the moves (W, 2) between successive poses (W + 1, 3), in the frame of the first."""
    step, heading = np.diff(poses[:, :2], axis=0), poses[:-1, 2]
    c, s = np.cos(heading), np.sin(heading)
    return np.stack([c * step[:, 0] + s * step[:, 1], c * step[:, 1] - s * step[:, 0]], axis=1)


def print_odometry(name: str, found: Motion) -> None:
    """Print scales and variances of one robot."""
    A = np.stack([found.turn, found.moved[:, 0]], axis=1)
    (scale, drift), *_ = np.linalg.lstsq(A, found.true_turn, rcond=None)
    forward = found.moved[:, 0] @ found.truly_moved[:, 0] / (found.moved[:, 0] ** 2).sum()
    rest = found.true_turn - A @ [scale, drift]
    V = np.stack([found.distance, found.angle], axis=1)
    per_metre, per_radian = _positive_least_squares(V, rest**2)
    along = found.truly_moved[:, 0] - forward * found.moved[:, 0]
    across = found.truly_moved[:, 1] - found.moved[:, 1]
    total = found.distance.sum()
    print(
        f'{name}: turning × {scale:.3f}, driving × {forward:.3f}, drift {drift:+.3f} rad/m; '
        f'then heading {per_metre:.4f} rad²/m + {per_radian:.4f} rad²/rad, '
        f'forward {(along**2).sum() / total:.4f} m²/m, '
        f'lateral {(across**2).sum() / total:.4f} m²/m'
    )


def _positive_least_squares(A: Array, b: Array) -> Array:
    """Return the non-negative x (2,) that is best in A x = b."""
    x, *_ = np.linalg.lstsq(A, b, rcond=None)
    if (x >= 0.0).all():
        return np.asarray(x)
    alone = np.array([max(float(a @ b), 0.0) / float(a @ a) for a in A.T])
    costs = [float(np.sum((A[:, n] * alone[n] - b) ** 2)) for n in range(2)]
    best = int(np.argmin(costs))
    return np.where(np.arange(2) == best, alone, 0.0)


def camera_errors(team: mrclam.Team, recording: mrclam.Recording) -> Errors:
    """Compare what a robot measured of landmarks with the truth; outliers are left out."""
    rows = recording.measurements
    inside = (rows[:, 0] > team.begin) & (rows[:, 0] < team.end) & (rows[:, 1] > mrclam.ROBOTS)
    rows = rows[inside]
    poses = mrclam.true_poses(recording, rows[:, 0])
    marks = team.landmarks[rows[:, 1].astype(int) - mrclam.ROBOTS - 1]
    dx, dy = (marks - poses[:, :2]).T
    distance = np.hypot(dx, dy)
    range_error = rows[:, 2] - distance
    bearing_error = wrap_angles(rows[:, 3] - np.arctan2(dy, dx) + poses[:, 2])
    grid = np.arange(team.begin, team.end, 0.2)  # coarse: jitter of the truth is no motion
    true = mrclam.true_poses(recording, grid)
    driven = np.interp(rows[:, 0], grid, _summed(np.hypot(*np.diff(true[:, :2], axis=0).T)))
    turned = np.interp(rows[:, 0], grid, _summed(np.abs(np.diff(true[:, 2]))))
    good = np.abs(range_error) < LARGEST_ERROR[0]
    good &= np.abs(bearing_error) < LARGEST_ERROR[1]
    columns = (
        rows[:, 0], rows[:, 1], distance, rows[:, 3], range_error, bearing_error, driven, turned,
    )  # fmt: skip
    return Errors(*(column[good] for column in columns))


def _deviation(values: Array) -> float:
    return float(TO_DEVIATION * np.median(np.abs(values - np.median(values))))


def print_camera(name: str, found: Errors) -> None:
    """Print bias and standard deviation of range and bearing, of all ranges and by distance."""
    parts = []
    for low, high in ((0.0, 1.5), (1.5, 3.0), (3.0, 5.0), (5.0, 9.0)):
        some = (found.range >= low) & (found.range < high)
        if some.any():
            error = found.range_error[some]
            parts.append(f'{low:g}–{high:g} m {np.median(error):+.3f} ± {_deviation(error):.3f}')
    bearing = found.bearing_error
    print(
        f'{name}: bearing {np.median(bearing):+.4f} ± {_deviation(bearing):.4f} rad '
        f'(rms {np.sqrt(np.mean(bearing**2)):.4f}); range {", ".join(parts)}'
    )


def fit_range(found: Errors) -> tuple[float, float]:
    """Return a and b of the standard deviation a + b · range, by least squares of |error|."""
    A = np.stack([np.ones(len(found.range)), found.range], axis=1)
    fit, *_ = np.linalg.lstsq(A, np.abs(found.range_error), rcond=None)
    a, b = fit * np.sqrt(np.pi / 2.0)  # mean |x| of a normal distribution is σ √(2/π)
    return float(a), float(b)


def pairs(found: Errors, sigma: tuple[float, float]) -> Array:
    """Return (P, 5): pairs of observations of one landmark.

    Metres, radians and seconds between them; products of their errors of range, in units of its
    deviation, and of bearing (rad²).
    """
    scaled = found.range_error / (sigma[0] + sigma[1] * found.range)
    parts = []
    for subject in np.unique(found.subject):
        chosen = np.flatnonzero(found.subject == subject)
        for gap in GAPS:
            i, j = chosen[:-gap], chosen[gap:]
            parts.append(
                np.stack(
                    [
                        found.distance[j] - found.distance[i],
                        found.angle[j] - found.angle[i],
                        found.stamp[j] - found.stamp[i],
                        scaled[i] * scaled[j],
                        found.bearing_error[i] * found.bearing_error[j],
                    ],
                    axis=1,
                )
            )
    return np.concatenate(parts)


def print_correlation(table: Array, variances: tuple[float, float]) -> None:
    """Print correlations by the time between, and the lengths that fit their mean."""
    times, rhos, counts = [], [], []
    for low, high in itertools.pairwise(EDGES):
        some = table[(table[:, 2] >= low) & (table[:, 2] < high)]
        if not len(some):
            continue
        mean = some.mean(axis=0)
        both = mean[3:] / variances
        print(
            f'  {low:g} to {high:g} s apart ({len(some)} pairs, {mean[0]:.2f} m, '
            f'{mean[1]:.2f} rad): range {both[0]:.2f}, bearing {both[1]:.2f}'
        )
        if high <= EDGES[-2]:
            rho = both.mean()
            times.append(mean[2])
            rhos.append(rho)
            counts.append(len(some))
    candidates = np.geomspace(0.1, 100.0, 301)
    costs = [
        np.sum(np.array(counts) * (np.exp(-np.array(times) / c) - rhos) ** 2) for c in candidates
    ]
    time = float(candidates[int(np.argmin(costs))])
    some = table[table[:, 2] < EDGES[-2]]
    speed, rate = some[:, 0].sum() / some[:, 2].sum(), some[:, 1].sum() / some[:, 2].sum()
    print(
        f'  errors last {time:.1f} s at {speed:.3f} m/s and {rate:.3f} rad/s: correlation '
        f'lengths {3 * time * speed:.2f} m, {3 * time * rate:.2f} rad, {3 * time:.0f} s'
    )


def main() -> None:
    """Print the figures of each data set."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n')[0])
    parser.add_argument('folders', type=Path, nargs='+')
    for folder in parser.parse_args().folders:
        logged = mrclam.read(folder)
        print_distances(logged)
        team = mrclam.corrected(logged)
        logs = [(robot.odometry, robot.measurements) for robot in logged.robots]
        delay = odometry_delay(logs)
        each = [f'{odometry_delay([log]):.2f}' for log in logs]
        print(f'{folder.name}: the robots follow their odometry after {delay:.2f} s ({each})')
        motions = [motion(team, robot) for robot in team.robots]
        seen = [camera_errors(team, robot) for robot in team.robots]
        for number, found in enumerate(motions):
            print_odometry(f'robot{number + 1}', found)
        print_odometry('all', Motion(*(np.concatenate(p) for p in zip(*motions, strict=True))))
        for number, errors in enumerate(seen):
            print_camera(f'robot{number + 1}', errors)
        both = Errors(*(np.concatenate(p) for p in zip(*seen, strict=True)))
        print_camera('all', both)
        sigma = fit_range(both)
        print(f'range: {sigma[0]:.3f} m + {sigma[1]:.3f} · range')
        table = np.concatenate([pairs(errors, sigma) for errors in seen])
        scaled = both.range_error / (sigma[0] + sigma[1] * both.range)
        print_correlation(
            table, (float(np.mean(scaled**2)), float(np.mean(both.bearing_error**2)))
        )


if __name__ == '__main__':
    main()
