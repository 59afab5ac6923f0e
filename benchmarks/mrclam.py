"""MR.CLAM recordings (Leung et al., IJRR 30(8), 2011) as events in time order, without bags."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import InterRobotObservation, LandmarkObservations
from explore_slam.geometry import Array, Pose2

ROBOTS = 5


@dataclass(frozen=True)
class Recording:
    """One robot: odometry (t v ω), measurements (t subject range bearing), truth (t x y θ)."""

    odometry: Array
    measurements: Array
    truth: Array


@dataclass(frozen=True)
class Team:
    """All robots, landmarks (15, 2) m by subject from 6 to 20, and the common interval."""

    robots: list[Recording]
    landmarks: Array
    begin: float
    end: float


@dataclass(frozen=True)
class Event:
    """One robot at one time: motion since its last event, and its measurements.

    steps (n, 3): odometry increments x y θ; measured (m, 3): subject (1 to 20), range, bearing.
    """

    stamp: float
    robot: int
    steps: Array
    measured: Array


def read(folder: Path) -> Team:
    """Read a folder; the common interval is that of all odometry and ground truth."""
    barcodes = np.loadtxt(folder / 'Barcodes.dat')
    subject_of = {int(code): int(subject) for subject, code in barcodes}
    robots = []
    for number in range(1, ROBOTS + 1):
        rows = np.loadtxt(folder / f'Robot{number}_Measurement.dat')
        known = np.array([int(code) in subject_of for code in rows[:, 1]])
        rows = rows[known]
        rows[:, 1] = [subject_of[int(code)] for code in rows[:, 1]]
        robots.append(
            Recording(
                np.loadtxt(folder / f'Robot{number}_Odometry.dat'),
                rows,
                np.loadtxt(folder / f'Robot{number}_Groundtruth.dat'),
            )
        )
    begin = max(max(r.odometry[0, 0], r.truth[0, 0]) for r in robots)
    end = min(min(r.odometry[-1, 0], r.truth[-1, 0]) for r in robots)
    marks = np.loadtxt(folder / 'Landmark_Groundtruth.dat')
    return Team(robots, marks[np.argsort(marks[:, 0]), 1:3], begin, end)


def true_poses(recording: Recording, stamps: Array) -> Array:
    """Interpolate ground truth at stamps (n,); return poses (n, 3)."""
    t = recording.truth[:, 0]
    heading = np.unwrap(recording.truth[:, 3])
    return np.stack(
        [
            np.interp(stamps, t, recording.truth[:, 1]),
            np.interp(stamps, t, recording.truth[:, 2]),
            np.interp(stamps, t, heading),
        ],
        axis=1,
    )


def _steps(odometry: Array, begin: float, end: float) -> Array:
    """Integrate constant velocities between begin and end, one step per odometry sample."""
    t = odometry[:, 0]
    inside = t[(t > begin) & (t < end)]
    edges = np.concatenate([[begin], inside, [end]])
    held = np.clip(np.searchsorted(t, edges[:-1], side='right') - 1, 0, None)
    span = np.diff(edges)
    distance, turn = odometry[held, 1] * span, odometry[held, 2] * span
    half = 0.5 * turn
    chord = distance * np.sinc(half / np.pi)
    steps = np.stack([chord * np.cos(half), chord * np.sin(half), turn], axis=1)
    return steps[(np.abs(steps) > 0.0).any(axis=1)]


def events(team: Team, period: float = 1.0) -> Iterator[Event]:
    """Yield measurements of all robots by time, and periodically events without measurements."""
    stamps: list[tuple[float, int, int]] = []
    groups: list[list[NDArray[np.float64]]] = []
    for robot, recording in enumerate(team.robots):
        rows = recording.measurements
        rows = rows[(rows[:, 0] > team.begin) & (rows[:, 0] < team.end)]
        times, first = np.unique(rows[:, 0], return_index=True)
        groups.append(np.split(rows[:, 1:], first[1:]) if len(rows) else [])
        stamps += [(float(t), robot, i) for i, t in enumerate(times)]
    ticks = np.arange(team.begin + period, team.end, period)
    stamps += [(float(t), robot, -1) for t in ticks for robot in range(ROBOTS)]
    last = [team.begin] * ROBOTS
    for stamp, robot, group in sorted(stamps):
        steps = _steps(team.robots[robot].odometry, last[robot], stamp)
        last[robot] = stamp
        measured = groups[robot][group] if group >= 0 else np.empty((0, 3))
        yield Event(stamp, robot, steps, measured)


def start_poses(team: Team) -> dict[str, Pose2]:
    """Return the true poses at the beginning."""
    return {
        f'robot{i + 1}': Pose2.from_array(true_poses(r, np.array([team.begin]))[0])
        for i, r in enumerate(team.robots)
    }


def covariances(ranges: Array, bearings: Array, sr: float, sr_part: float, sb: float) -> Array:
    """Return covariances (m, 2, 2) for range noise sr + sr_part · range and bearing noise sb."""
    c, s = np.cos(bearings), np.sin(bearings)
    J = np.array([[c, -ranges * s], [s, ranges * c]]).transpose(2, 0, 1)
    Q = np.zeros_like(J)
    Q[:, 0, 0] = (sr + sr_part * ranges) ** 2
    Q[:, 1, 1] = sb**2
    return J @ Q @ J.transpose(0, 2, 1)


def observations(
    stamp: float, measured: Array, noise: tuple[float, float, float]
) -> tuple[LandmarkObservations, list[InterRobotObservation]]:
    """Convert measurements to observations of landmarks (bar code as descriptor) and of robots."""
    subject, distance, bearing = measured.T
    xy = np.stack([distance * np.cos(bearing), distance * np.sin(bearing)], axis=1)
    R2 = covariances(distance, bearing, *noise)
    R = np.zeros((len(xy), 3, 3))
    R[:, :2, :2] = R2
    R[:, 2, 2] = 1e-4
    marks = subject > ROBOTS
    seen = LandmarkObservations(
        stamp,
        np.c_[xy[marks], np.zeros(marks.sum())],
        R[marks],
        np.eye(128, dtype=np.float32)[subject[marks].astype(int)],
    )
    inter_robot = [
        InterRobotObservation(stamp, f'robot{int(subject[i])}', xy[i], R2[i])
        for i in np.flatnonzero(~marks)
    ]
    return seen, inter_robot
