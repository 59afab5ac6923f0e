"""Odometry by scans alone: rooms, corridors, gaps, clocks, pauses."""

import math

import numpy as np
import pytest

from explore_slam.agent import Agent, AgentConfig
from explore_slam.data import ImuReading, LaserScan, OdometryReading, SweepTiming
from explore_slam.errors import AgentError
from explore_slam.geometry import Pose2
from explore_slam.settings import with_values
from explore_slam.simulation.worlds.walls import box, distances_along

FEW = with_values(AgentConfig(), {'particles': 20})
ROOM = np.concatenate([box(-4.0, -3.0, 8.0, 6.0), box(1.5, 1.0, 1.0, 1.0)])
BEAMS, RATE, REACH = 360, 5.5, 8.0
STEP = 2.0 * math.pi / BEAMS


class Drive:
    """A vehicle without wheels, whose laser measures all beams at one moment."""

    def __init__(self, walls, start, seed=0):
        self.walls, self.pose, self.stamp = walls, start, 0.0
        self.random = np.random.default_rng(seed)
        self.agent = Agent(FEW, {'a': start}, sources={'a': 'scan'})

    def scan(self):
        angles = -math.pi + STEP * np.arange(BEAMS)
        origins = np.tile([self.pose[:2]], (BEAMS, 1))
        ranges = distances_along(self.walls, origins, self.pose.theta + angles)
        ranges = ranges + 0.01 * self.random.standard_normal(BEAMS)
        ranges[ranges > REACH] = np.inf
        mount = Pose2(0.0, 0.0, 0.0)
        return LaserScan(
            self.stamp, -math.pi, STEP, ranges.astype(np.float32), 0.1, REACH, mount,
            timing=SweepTiming(0.0),
        )  # fmt: skip

    def go(self, duration, speed=0.0, turn_rate=0.0):
        for _ in range(round(duration * RATE)):
            self.agent.add('a', self.scan())
            self.stamp += 1.0 / RATE
            self.pose = self.pose.compose(Pose2(speed / RATE, 0.0, turn_rate / RATE))
        return self

    def error(self):
        """Distance (m) of the estimate from the pose at the newest scan, and the turn (rad)."""
        self.agent.add('a', self.scan())
        off = self.pose.between(self.agent.estimate('a')[0])
        return math.hypot(off.x, off.y), abs(off.theta)


def test_a_vehicle_without_wheels_is_localized_by_its_scans():
    drive = Drive(ROOM, Pose2(-2.0, -1.0, 0.0)).go(1.0).go(6.0, 0.3, 0.2).go(3.0, 0.0, -0.8)
    off, turned = drive.error()
    assert off < 0.03
    assert turned < 0.02
    assert drive.agent.summary()['a'].get('unmatched_scans', 0) == 0
    assert drive.agent.odometry_sources()['a']['source'] == 'scan'


def test_wheels_do_not_count():
    drive = Drive(ROOM, Pose2(-2.0, -1.0, 0.0)).go(1.0)
    for _ in range(30):
        drive.agent.add('a', OdometryReading(drive.stamp, Pose2(9.0 * drive.stamp, 0.0, 2.0)))
        drive.agent.add('a', ImuReading(drive.stamp, (0.0, 0.0, 3.0)))
        drive.go(0.2, 0.3)
    assert drive.error()[0] < 0.03
    counts = drive.agent.summary()['a']
    assert (counts['unused_odometry'], counts['unused_imu']) == (30, 30)
    track = drive.agent.track('a')
    # but the transforms of the base follow from them
    assert track.source.base_pose(track.odometry).theta == 2.0


@pytest.mark.parametrize('seed', range(3))
def test_the_way_along_a_corridor_without_features_is_unknown(seed):
    """30 m of a corridor whose ends are out of sight: the covariance covers the error."""
    drive = Drive(box(0.0, 0.0, 60.0, 2.0), Pose2(10.0, 1.0, 0.0), seed)
    drive.go(1.0)
    for _ in range(12):
        drive.go(6.25, 0.4)
        off = drive.pose.between(drive.agent.estimate('a')[0])
        covariance = drive.agent.estimate('a')[1]
        assert abs(off.x) < 2.0 * math.sqrt(covariance[0, 0]) + 0.1
    along, across = np.sqrt(np.diag(covariance)[:2])
    assert drive.pose.x == pytest.approx(40.0, abs=0.5)
    assert along > 10.0
    assert across < 0.2
    assert abs(off.y) < 0.1


def test_a_gap_without_scans_is_named_once(caplog):
    drive = Drive(ROOM, Pose2(-2.0, -1.0, 0.0)).go(2.0, 0.1)
    for _ in range(2):
        drive.stamp += 3.0
        drive.go(1.0)
    assert caplog.text.count('no scan for 3') == 1
    assert drive.agent.odometry_sources()['a']['gaps'] == 2.0
    assert drive.error()[0] < 0.05  # it had stood still


def test_a_clock_that_jumps_back_begins_anew():
    drive = Drive(ROOM, Pose2(-2.0, -1.0, 0.0)).go(4.0, 0.2)
    drive.stamp = 1.0
    drive.go(4.0, 0.2)
    assert drive.agent.track('a').odometry.last < 6.0
    # what was driven between the last scan of the old clock and the first one kept of the new
    assert drive.error()[0] < 0.15


def test_while_measurements_are_paused_the_motion_is_still_followed():
    drive = Drive(ROOM, Pose2(-2.0, -1.0, 0.0)).go(1.0)
    drive.agent.paused = True
    mapped = len(drive.agent.laser_map.scans)
    drive.go(4.0, 0.3)
    assert len(drive.agent.laser_map.scans) == mapped
    drive.agent.paused = False
    assert drive.error()[0] < 0.03


def test_a_reset_begins_at_the_start_pose():
    drive = Drive(ROOM, Pose2(-2.0, -1.0, 0.0)).go(4.0, 0.3)
    drive.agent.reset()
    drive.go(2.0)
    estimate = drive.agent.estimate('a')[0]
    assert math.dist(estimate[:2], (-2.0, -1.0)) < 0.02


def test_an_unknown_source_is_named():
    with pytest.raises(AgentError, match="odometry of a is 'sonar', expected one of"):
        Agent(FEW, {'a': Pose2(0.0, 0.0, 0.0)}, sources={'a': 'sonar'})


def test_scans_that_are_not_matched_are_no_odometry():
    off = with_values(FEW, {'scan_matching': False})
    with pytest.raises(AgentError, match='odometry of a is scan and scan_matching is false'):
        Agent(off, {'a': Pose2(0.0, 0.0, 0.0)}, sources={'a': 'scan'})
    agent = Agent(FEW, {'a': Pose2(0.0, 0.0, 0.0)}, sources={'a': 'scan'})
    with pytest.raises(AgentError, match='scan_matching is false'):
        agent.configure(off)
    assert agent.config == FEW
