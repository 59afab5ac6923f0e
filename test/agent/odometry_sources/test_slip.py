"""Wheels that slip, or do not move while the scans do, are named once."""

import numpy as np
import pytest
from synthetic import SyntheticWorld

from explore_slam.agent.odometry_sources import SlipMonitor
from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.registration import ScanMatcher, ScanMatchingConfig, scan_cloud
from explore_slam.slam import OdometryNoise

LASER = Pose2(0.1, 0.0, 0.0)


def compare(monitor, wheels, scans, scans_taken=40):
    for number in range(scans_taken):
        monitor.add_match(0.1 * number, 0.1 * number + 0.1, wheels, scans, OdometryNoise())


@pytest.mark.parametrize('factor', [0.85, 1.0, 1.15])
def test_wheels_that_are_a_little_off_are_not_named(factor, caplog):
    monitor = SlipMonitor('robot1', 'wheels')
    compare(monitor, Pose2(0.04 * factor, 0.0, 0.09 * factor), Pose2(0.04, 0.0, 0.09))
    assert monitor.problem == ''
    assert caplog.text == ''


def test_drift_of_the_heading_while_driving_is_not_slip(caplog):
    """Over 1.2 m, odometry with the default noise drifts by 3 degrees (one sigma)."""
    monitor = SlipMonitor('robot1', 'wheels')
    step = 0.04, np.radians(0.75), np.radians(1.05)  # in 3 s 1.2 m, 22 and 31 degrees
    compare(monitor, Pose2(step[0], 0.0, step[1]), Pose2(step[0], 0.0, step[2]))
    assert monitor.problem == ''
    compare(monitor, Pose2(step[0], 0.0, step[1]), Pose2(step[0], 0.0, 2.0 * step[2]))
    assert 'wheels slip' in caplog.text


def test_wheels_that_turn_too_far_are_named_with_the_amount_and_what_to_set(caplog):
    monitor = SlipMonitor('robot1', 'wheels')
    compare(monitor, Pose2(0.0, 0.0, 0.09 * 1.4), Pose2(0.0, 0.0, 0.09))
    assert len(caplog.records) == 1
    assert 'robot1: wheels slip, or are of another size' in caplog.text
    assert 'in 0.4 s, odometry has 0.00 m and 29°, the scans 0.00 m and 21°' in caplog.text
    assert 'set robot1.odometry: scan (or wheels+gyro' in caplog.text
    assert monitor.report() == {'problem': monitor.problem}


def test_wheels_that_spin_are_named(caplog):
    monitor = SlipMonitor('robot1', 'wheels+gyro')
    compare(monitor, Pose2(0.05, 0.0, 0.0), IDENTITY)
    assert 'odometry has 0.55 m and 0°, the scans 0.00 m and 0°' in caplog.text
    assert 'wheels+gyro' not in caplog.text


def test_odometry_that_does_not_move_while_matched_scans_do_is_named(caplog):
    monitor = SlipMonitor('robot1', 'wheels')
    compare(monitor, IDENTITY, Pose2(0.05, 0.0, 0.0))
    assert 'odometry does not move while the scans do' in caplog.text


def drive(monitor, step, count=60):
    """A vehicle whose odometry stands while it moves, scans at 10 Hz."""
    world, matcher = SyntheticWorld(), ScanMatcher(ScanMatchingConfig())
    pose = Pose2(-1.0, 0.3, 0.2)
    for number in range(count):
        scan = world.scan_from(0.1 * number, pose.compose(LASER), beams=361)
        cloud = scan_cloud(scan, LASER, 40.0)
        if number == 0:
            matcher.match_cloud(cloud, IDENTITY, np.zeros((3, 3)))
        else:
            monitor.add_still_scan(0.1 * number, matcher, cloud, IDENTITY)
        pose = pose.compose(step)
    return matcher


def test_odometry_that_never_moves_is_named_by_the_scans(caplog):
    monitor = SlipMonitor('robot1', 'wheels')
    drive(monitor, Pose2(0.01, 0.0, 0.01))
    assert len(caplog.records) == 1
    assert 'robot1: odometry does not move while the scans do' in caplog.text
    assert 'odometry has 0.00 m and 0°' in caplog.text


def test_a_standing_vehicle_is_not_named(caplog):
    monitor = SlipMonitor('robot1', 'wheels')
    matcher = drive(monitor, IDENTITY)
    assert caplog.text == ''
    assert matcher.started
