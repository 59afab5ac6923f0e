"""Error of the motion between matched scans, beside what scan matching says of it.

    python benchmarks/scan_matching_noise.py BAG [--reference TUM] [--window-drift SHARE ...]

The bag holds scans, odometry and ground truth, as of a run in a simulated world. For other
recordings of one vehicle, --reference is a better path in TUM's format, such as the final one of
a replay that closes loops. For scans 1 to 200 matches apart: deviation of position (mm) and
heading (mrad) from the truth, the deviations that the white errors of both scans and the drift
between them add up to (without heading errors that become lateral ones), and the mean squared
Mahalanobis distance of the motion between them, expected 3.
Last, by how much the motions over 50 matches are too long, in parts per thousand of the way: a
systematic error, which no covariance covers.
--window-drift: values to try of scan_matcher.WINDOW_DRIFT.
"""

import argparse
import math
from pathlib import Path

import numpy as np

from explore_slam import registration
from explore_slam.agent.config import explicit_mounts
from explore_slam.agent.scan_odometry import refine_by_scan
from explore_slam.agent.team import Team
from explore_slam.data import LaserScan, OdometryReading
from explore_slam.geometry import Array, Pose2, between, planar_rotation
from explore_slam.messages.topics import TopicKind
from explore_slam.recording import BagReader, Replay
from explore_slam.registration import (
    PointCloud,
    RefusedScan,
    ScanMatch,
    ScanMatcher,
    scan_matcher,
)
from explore_slam.results.replay_run import configuration
from explore_slam.results.trajectory import Trajectory, load_tum

LAGS = (1, 2, 5, 10, 20, 50, 100, 200)
SCALE_LAG = 50  # matches; 5 s of driving at 10 Hz, far above the white error of a match


class RecordingMatcher(ScanMatcher):
    """A scan matcher that keeps its last result."""

    last: ScanMatch | RefusedScan | None = None

    def match_cloud(
        self, cloud: PointCloud, prior: Pose2, covariance: Array
    ) -> ScanMatch | RefusedScan:
        """See ScanMatcher."""
        self.last = super().match_cloud(cloud, prior, covariance)
        return self.last

    def take(self) -> ScanMatch | RefusedScan | None:
        """Return the last result, once."""
        last, self.last = self.last, None
        return last


def read(bag: Path) -> dict[str, tuple[list[tuple[float, ScanMatch]], Trajectory]]:
    """Return stamps (s) and matches, and the truth in the bag, of every vehicle in it."""
    config = configuration(bag)
    with BagReader(bag) as reader:
        replay = Replay(reader, team_mounts=explicit_mounts(config))
        team = Team(config, replay.start_poses(), 0)
        events = list(replay.events())
    matches: dict[str, list[tuple[float, ScanMatch]]] = {name: [] for name in team.tracks}
    truth: dict[str, list[tuple[float, ...]]] = {name: [] for name in team.tracks}
    waiting: dict[str, list[LaserScan]] = {name: [] for name in team.tracks}
    matchers = {name: RecordingMatcher(config.scan_matching) for name in team.tracks}
    for name, track in team.tracks.items():
        track.matcher = matchers[name]
    for event in events:
        name, record = event.vehicle, event.record
        if event.kind is TopicKind.GROUND_TRUTH and isinstance(record, OdometryReading):
            truth[name].append((record.stamp, *record.pose))
        elif isinstance(record, LaserScan):
            waiting[name].append(record)
        elif event.kind is TopicKind.ODOMETRY and isinstance(record, OdometryReading):
            track, matcher = team.tracks[name], matchers[name]
            track.odometry.add(record)
            while waiting[name] and waiting[name][0].stamp <= record.stamp:
                scan = waiting[name].pop(0)
                laser = scan.mount or config.laser_mount.pose
                refine_by_scan(track, scan, laser, config.slam)
                found = matcher.take()
                if isinstance(found, ScanMatch):
                    matches[name].append((scan.stamp, found))
    rows = {name: np.array(truth[name]).reshape(-1, 4) for name in team.tracks}
    return {
        name: (matches[name], Trajectory.of(rows[name][:, 0], rows[name][:, 1:]))
        for name in team.tracks
    }


def covariance_between(known: list[ScanMatch], first: int, last: int) -> Array:
    """Return the covariance (3, 3) of the measured motion between two matches, in the last's axes.

    The drift between them, and the white error of both.
    """
    end = known[last].pose
    total = np.array(known[last].white)
    for number in range(first, last + 1):
        match = known[number]
        u = match.pose.between(end)
        # an error at a pose, carried to the end of the motion u: Jacobian of (δ ⊞ u)
        F = planar_rotation(-u.theta)
        F[:2, 2] = F[:2, :2] @ (-u.y, u.x)
        total += F @ (match.white if number == first else match.drift) @ F.T
    return total


def mean_square(known: list[ScanMatch], true: Array, poses: Array, lag: int) -> float:
    """Return the mean squared Mahalanobis distance of the motion over a lag, from the truth."""
    squares = []
    for first in range(0, len(known) - lag, max(1, lag // 5)):
        last = first + lag
        off = between(between(true[first], true[last]), between(poses[first], poses[last]))
        squares.append(off @ np.linalg.solve(covariance_between(known, first, last), off))
    return float(np.mean(squares))


def scale_error(true: Array, poses: Array) -> tuple[float, float]:
    """Return by which fraction the distances driven are too long, and its standard deviation.

    true, poses (T, 3): at the matches. Least squares over motions that do not overlap; not a
    number for a vehicle at rest.
    """
    stops = np.arange(0, len(true), SCALE_LAG)
    way = between(true[stops[:-1]], true[stops[1:]])[:, :2]
    off = between(poses[stops[:-1]], poses[stops[1:]])[:, :2] - way
    total = float((way**2).sum())
    if total == 0.0:
        return math.nan, math.nan
    scale = float((off * way).sum()) / total
    rest = ((off - scale * way) * way).sum(axis=1)
    # of motions of unlike length and noise (White, Econometrica 48, 1980)
    return scale, math.sqrt(float((rest**2).sum())) / total


def table(rows: list[tuple[float, ScanMatch]], truth: Trajectory) -> list[str]:
    """Return a line for each lag, and one for the systematic error of the way."""
    true, valid = truth.at(np.array([stamp for stamp, _ in rows]))
    known = [match for (_, match), good in zip(rows, valid, strict=True) if good]
    true = true[valid]
    poses = np.array([match.pose for match in known])
    white = np.array([np.diag(match.white) for match in known])
    grown = np.cumsum([np.diag(match.drift) for match in known], axis=0)
    lines = []
    for lag in LAGS:
        if lag >= len(known):
            break
        off = between(between(true[:-lag], true[lag:]), between(poses[:-lag], poses[lag:]))
        predicted = white[:-lag] + white[lag:] + grown[lag:] - grown[:-lag]
        lines.append(
            f'  {lag:4d} apart: '
            f'{1e3 * math.sqrt((off[:, :2] ** 2).sum(axis=1).mean()):6.2f} mm '
            f'{1e3 * math.sqrt((off[:, 2] ** 2).mean()):6.2f} mrad; predicted '
            f'{1e3 * math.sqrt(predicted[:, :2].sum(axis=1).mean()):6.2f} mm '
            f'{1e3 * math.sqrt(predicted[:, 2].mean()):6.2f} mrad; squared Mahalanobis distance '
            f'{mean_square(known, true, poses, lag):.1f}'
        )
    if len(known) > 2 * SCALE_LAG:
        scale, deviation = scale_error(true, poses)
        lines.append(f'  driven too far: {1e3 * scale:.2f} ± {1e3 * deviation:.2f} per thousand')
    return lines


def main() -> None:
    """Print the table of every vehicle, for each share."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('bag', type=Path)
    parser.add_argument('--reference', type=Path)
    parser.add_argument(
        '--window-drift', type=float, nargs='+', default=[scan_matcher.WINDOW_DRIFT]
    )
    arguments = parser.parse_args()
    path = arguments.reference
    reference = None if path is None else load_tum(path)
    registration.warm_up()
    for share in arguments.window_drift:
        scan_matcher.WINDOW_DRIFT = share
        for name, (rows, known) in read(arguments.bag).items():
            truth = known if reference is None else reference
            print(f'{name}: {len(rows)} matches, window drift {share}')
            for line in table(rows, truth):
                print(line, flush=True)


if __name__ == '__main__':
    main()
