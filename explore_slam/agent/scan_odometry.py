"""Laser odometry: refine a vehicle's odometry by scan matching."""

from dataclasses import replace

import numpy as np

from explore_slam.agent.vehicle_track import VehicleTrack, compound_steps
from explore_slam.data import LaserScan
from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.slam import OdometryNoise, rotated

# Trace (m² + rad²) of the covariance of a motion below which the vehicle stands still: with the
# default odometry noise, less than 0.01 mm.
_STATIONARY_TRACE = 1e-8


def refine_by_scan(
    track: VehicleTrack, scan: LaserScan, laser: Pose2, noise: OdometryNoise
) -> None:
    """Match a scan with earlier ones and correct the odometry since the last match.

    laser: its pose in the vehicle frame.
    noise: of the wheel odometry.
    A scan that matches nothing leaves the odometry unchanged. While the vehicle stands still
    nothing is corrected, so that the noise of matching does not move it.
    """
    since = max(track.matched_until, track.odometry.first)
    if scan.stamp <= since:
        return
    motion, covariance = compound_steps(
        IDENTITY, np.zeros((3, 3)), track.odometry.steps(since, scan.stamp), noise
    )
    if track.matcher.started and covariance.trace() < _STATIONARY_TRACE:
        track.matched_until = scan.stamp
        return
    prior = track.odometry.at(scan.stamp)
    match = track.matcher.match(scan, laser, prior, rotated(covariance, motion.theta))
    if match is not None:
        track.count('matched_scans')
        track.odometry.correct(since, scan.stamp, match.pose, match.covariance)
        if track.keyframe is not None:
            # the correction before the newest keyframe is already part of the filter's estimate
            corrected = track.odometry.at(track.keyframe.stamp)
            track.keyframe = replace(track.keyframe, odometry=corrected)
        track.matched_until = scan.stamp
    elif track.matcher.started:
        track.count('unmatched_scans')
