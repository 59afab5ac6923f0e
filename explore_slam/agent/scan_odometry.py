"""Laser odometry: refine a vehicle's odometry by scan matching."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from explore_slam.agent.scan_sets import PlacedCloud
from explore_slam.agent.vehicle_track import VehicleTrack, compound_steps
from explore_slam.data import LaserScan
from explore_slam.geometry import IDENTITY, Pose2, rotated
from explore_slam.registration import Refusal, ScanMatch, merged, scan_cloud
from explore_slam.slam import FastSlamConfig, calibrated

# Trace (m² + rad²) of the covariance of a motion below which the vehicle stands still: with the
# default odometry noise, less than 0.01 mm.
_STATIONARY_TRACE = 1e-8

# rad; of the direction of the motion from the heading: the laser's yaw on the vehicle, and the
# chord of a turn between two readings (`benchmarks/wheel_course.py`: 0.07 to 0.1 on Intel, ACES
# and Belgioioso).
_COURSE_DEVIATION = 0.1

# Disc (x m, y m, radius m) in the vehicle frame that hides another vehicle.
Disc = tuple[float, float, float]


def refine_by_scan(
    track: VehicleTrack,
    scan: LaserScan,
    laser: Pose2,
    slam: FastSlamConfig,
    bodies: Sequence[Disc] = (),
) -> None:
    """Match a scan with earlier ones and correct the odometry since the last match.

    The scan of one of several lasers waits for those of the others.

    laser: its pose in the vehicle frame.
    slam: noise and calibration of the wheel odometry. Between scans far apart its systematic
    errors are larger than the noise: they are part of the prior as if they were unknown.
    bodies: where other vehicles are, whose returns do not count.
    A scan that is refused leaves the odometry unchanged. While the vehicle stands still nothing is
    corrected, so that the noise of matching does not move it.
    """
    if scan.stamp <= max(track.matched_until, track.odometry.first):
        return
    cloud = scan_cloud(scan, laser, track.matcher.config.matching_range).masked(bodies)
    for clouds in track.sets.add(scan.sensor, scan.stamp, cloud):
        _refine_by_clouds(track, clouds, slam)


def _refine_by_clouds(
    track: VehicleTrack, clouds: Sequence[PlacedCloud], slam: FastSlamConfig
) -> None:
    """Match clouds of several lasers at once and correct the odometry since the last match."""
    since = max(track.matched_until, track.odometry.first)
    stamp, cloud = clouds[-1]
    if stamp <= since:
        return
    if len(clouds) > 1:
        now = track.odometry.at(stamp)
        cloud = merged([c.moved(now.between(track.odometry.at(s))) for s, c in clouds])
    motion, covariance = compound_steps(
        IDENTITY, np.zeros((3, 3)), track.odometry.steps(since, stamp), slam.odometry_noise
    )
    if track.matcher.started and covariance.trace() < _STATIONARY_TRACE:
        track.matched_until = stamp
        track.clouds.append((stamp, cloud))
        return
    prior = track.odometry.at(stamp)
    systematic = calibrated(motion, np.zeros(3)).sensitivity * slam.calibration.deviations()
    covariance = covariance + systematic @ systematic.T
    sideways = _COURSE_DEVIATION * np.array([-motion.y, motion.x])
    covariance[:2, :2] += np.outer(sideways, sideways)
    wheels = rotated(covariance, motion.theta)
    restarts = track.matcher.restarts
    match = track.matcher.match_cloud(cloud, prior, wheels)
    restarted = track.matcher.restarts != restarts
    if isinstance(match, ScanMatch):
        track.count('matched_scans')
        track.clouds.append((stamp, cloud))
        # where the map began anew, only wheel odometry connects it with the last match
        drift = match.drift + wheels if restarted else match.drift
        track.odometry.correct(since, stamp, match.pose, drift, match.white, wheels)
        if track.keyframe is not None:
            # the correction before the newest keyframe is already part of the filter's estimate
            corrected = track.odometry.at(track.keyframe.stamp)
            track.keyframe = replace(track.keyframe, odometry=corrected)
        track.matched_until = stamp
    elif match.reason is Refusal.FIRST:
        track.clouds.append((stamp, cloud))
    else:
        track.count('unmatched_scans')
        if restarted:
            track.matched_until = stamp
