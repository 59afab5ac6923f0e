"""Laser odometry: a match corrects the motion since the last one; standing still is left alone."""

import math

import numpy as np
import pytest
from synthetic import SyntheticWorld

from explore_slam.agent.odometry import OdometryBuffer
from explore_slam.agent.placement import Placement
from explore_slam.agent.scan_odometry import refine_by_scan
from explore_slam.agent.vehicle_track import Keyframe, VehicleTrack
from explore_slam.data import LaserScan, OdometryReading
from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.registration import ScanMatcher, ScanMatchingConfig
from explore_slam.slam import FastSlamConfig
from explore_slam.vision import KeyframeSelector

LASER = Pose2(0.1, 0.0, 0.0)
SLAM = FastSlamConfig()
SLIP = 1.2  # wheel odometry reports this many times the true motion


class Drive:
    """A vehicle that drives straight through a square room, with slipping wheels.

    readings: of the odometry before and with the first scan.
    """

    def __init__(self, readings=2):
        self.world = SyntheticWorld()
        self.track = VehicleTrack(
            'robot1',
            IDENTITY,
            OdometryBuffer('robot1', 30.0, 2.0, 1.0),
            KeyframeSelector(),
            ScanMatcher(ScanMatchingConfig()),
            Placement('robot1', start_known=True),
        )
        self.stamp = 0.0
        self.true = self.start = Pose2(-1.0, 0.3, 0.0)
        self.raw = IDENTITY
        for _ in range(readings):
            self.advance(0.0)
        self.refine()
        self.track.counts.clear()

    def advance(self, distance, heading=0.0):
        moved = Pose2(distance, 0.0, heading)
        self.true = self.true.compose(moved)
        self.stamp = round(self.stamp + 0.1, 6)
        self.raw = self.raw.compose(Pose2(SLIP * distance, 0.0, heading))
        self.track.odometry.add(OdometryReading(self.stamp, self.raw))

    def refine(self):
        scan = self.world.scan_from(self.stamp, self.true.compose(LASER), beams=361)
        refine_by_scan(self.track, scan, LASER, SLAM)

    def error(self):
        moved = self.start.between(self.true)
        off = moved.between(self.track.odometry.pose)
        return math.hypot(off.x, off.y)


def test_slipping_wheels_are_corrected():
    drive = Drive()
    for _ in range(15):
        drive.advance(0.05)
        drive.refine()
    assert drive.track.counts == {'matched_scans': 15}
    assert drive.error() < 0.03
    assert abs(drive.raw.x - 0.75) > 0.14
    assert drive.track.matched_until == drive.stamp


def test_the_first_scan_counts_if_it_is_as_old_as_the_first_odometry():
    """Wheels that slip from the start: no motion is left to them."""
    drive = Drive(readings=1)
    for _ in range(6):
        drive.advance(0.05)
        drive.refine()
    assert drive.track.counts == {'matched_scans': 6}
    assert drive.error() < 0.005


def test_a_keyframe_keeps_its_place_on_the_corrected_odometry():
    drive = Drive()
    drive.advance(0.1)
    odometry = drive.track.odometry
    drive.track.keyframe = Keyframe(4, drive.stamp, odometry.at(drive.stamp))
    drive.advance(0.1)
    drive.refine()
    keyframe = drive.track.keyframe
    assert (keyframe.number, keyframe.stamp) == (4, 0.3)
    assert keyframe.odometry == odometry.at(0.3)
    assert keyframe.odometry.x == pytest.approx(0.1, abs=0.02)


def test_a_vehicle_that_stands_still_is_not_moved_by_the_noise_of_scans():
    drive = Drive()
    drive.advance(0.1)
    drive.refine()
    before = drive.track.odometry.pose
    drive.advance(0.0)
    drive.true = drive.true.compose(Pose2(0.01, 0.01, 0.0))
    drive.refine()
    assert drive.track.odometry.pose == before
    assert drive.track.matched_until == drive.stamp
    assert drive.track.counts == {'matched_scans': 1}


def test_a_scan_that_matches_nothing_is_counted_and_changes_nothing():
    drive = Drive()
    drive.advance(0.1)
    until = drive.track.matched_until
    before = drive.track.odometry.pose
    ranges = np.full(361, 0.3, np.float32)
    odd = LaserScan(drive.stamp, -math.pi / 2, math.pi / 360, ranges, 0.05, 8.0)
    refine_by_scan(drive.track, odd, LASER, SLAM)
    assert drive.track.counts == {'unmatched_scans': 1}
    assert drive.track.odometry.pose == before
    assert drive.track.matched_until == until


def test_a_scan_older_than_the_last_match_is_ignored():
    drive = Drive()
    drive.advance(0.1)
    drive.refine()
    counts = dict(drive.track.counts)
    before = drive.track.odometry.pose
    drive.stamp -= 0.05
    drive.refine()
    assert (drive.track.counts, drive.track.odometry.pose) == (counts, before)
