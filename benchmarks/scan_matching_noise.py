"""Error of the motion between matched scans, beside what scan matching says of it.

    python benchmarks/scan_matching_noise.py BAG

The bag holds scans, odometry and ground truth, as of a run in a simulated world. For scans 1 to
200 matches apart: deviation of position (mm) and heading (mrad) from the truth, and the deviations
that the white errors of both scans and the drift between them add up to. Heading errors that
become lateral errors are left out of the second, so that the first grows faster at long distances.
"""

import argparse
import math
from pathlib import Path

import numpy as np

from explore_slam import registration
from explore_slam.agent.scan_odometry import refine_by_scan
from explore_slam.agent.team import Team
from explore_slam.data import LaserScan, OdometryReading
from explore_slam.geometry import Array, Pose2, between
from explore_slam.messages.topics import TopicKind
from explore_slam.recording import BagReader, Replay
from explore_slam.registration import PointCloud, RefusedScan, ScanMatch, ScanMatcher
from explore_slam.results.replay_run import configuration
from explore_slam.results.trajectory import Trajectory

LAGS = (1, 2, 5, 10, 20, 50, 100, 200)


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
    """Return stamps (s) and matches, and the truth, of every vehicle in a bag."""
    config = configuration(bag)
    with BagReader(bag) as reader:
        replay = Replay(reader)
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
                refine_by_scan(track, scan, config.laser_mount.pose, config.slam)
                found = matcher.take()
                if isinstance(found, ScanMatch):
                    matches[name].append((scan.stamp, found))
    return {
        name: (matches[name], Trajectory.of(rows[:, 0], rows[:, 1:]))
        for name in team.tracks
        if len(rows := np.array(truth[name]))
    }


def table(rows: list[tuple[float, ScanMatch]], truth: Trajectory) -> list[str]:
    """Return a line for each lag."""
    true, valid = truth.at(np.array([stamp for stamp, _ in rows]))
    known = [match for (_, match), good in zip(rows, valid, strict=True) if good]
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
            f'{1e3 * math.sqrt(predicted[:, 2].mean()):6.2f} mrad'
        )
    return lines


def main() -> None:
    """Print the table of every vehicle."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('bag', type=Path)
    bag = parser.parse_args().bag
    registration.warm_up()
    for name, (rows, truth) in read(bag).items():
        print(f'{name}: {len(rows)} matches')
        for line in table(rows, truth):
            print(line)


if __name__ == '__main__':
    main()
