"""A vehicle's odometry refined by its laser: what scans say of the motion bends the chain."""

from dataclasses import replace

import numpy as np

from explore_slam.agent.vehicle_track import VehicleTrack
from explore_slam.data import LaserScan
from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.slam import OdometryNoise, compound, rotated

_STANDING = 1e-8  # trace of the covariance of a motion that is none


def refine_by_scan(
    track: VehicleTrack, scan: LaserScan, laser: Pose2, noise: OdometryNoise
) -> None:
    """Match a scan with earlier ones and put the odometry since the last match on the result.

    laser: its pose on the vehicle; noise: of the wheels. A scan that fits nowhere changes
    nothing; a vehicle that stands still is left where it is.
    """
    since = max(track.refined_until, track.odometry.first)
    if scan.stamp <= since:
        return
    motion, covariance = IDENTITY, np.zeros((3, 3))
    for step in track.odometry.steps(since, scan.stamp):
        motion, covariance = compound(
            motion, covariance, step.increment, step.covariance_or(noise)
        )
    if track.matcher.started and covariance.trace() < _STANDING:
        track.refined_until = scan.stamp
        return
    prior = track.odometry.at(scan.stamp)
    match = track.matcher.match(scan, laser, prior, rotated(covariance, motion.theta))
    if match is not None:
        track.count('matched_scans')
        track.odometry.correct(since, scan.stamp, match.pose, match.covariance)
        if track.keyframe is not None:  # what was off until then, the belief has settled
            moved = track.odometry.at(track.keyframe.stamp)
            track.keyframe = replace(track.keyframe, odometry=moved)
        track.refined_until = scan.stamp
    elif track.matcher.started:
        track.count('unmatched_scans')
