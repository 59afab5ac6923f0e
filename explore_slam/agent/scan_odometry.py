"""Laser odometry: refine a vehicle's odometry by scan matching."""

from collections.abc import Sequence
from dataclasses import replace

from explore_slam.agent.scan_sets import PlacedCloud
from explore_slam.agent.vehicle_track import VehicleTrack
from explore_slam.data import LaserScan
from explore_slam.geometry import Pose2
from explore_slam.registration import Refusal, ScanMatch, merged, scan_cloud
from explore_slam.slam import FastSlamConfig

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
    slam: noise and calibration of the wheel odometry.
    bodies: where other vehicles are, whose returns do not count.
    A scan that is refused leaves the odometry unchanged. While the vehicle stands still nothing is
    corrected, so that the noise of matching does not move it.
    """
    if not _is_due(track, scan.stamp):
        return
    cloud = scan_cloud(scan, laser, track.matcher.config.matching_range).masked(bodies)
    for clouds in track.sets.add(scan.sensor, scan.stamp, cloud):
        _refine_by_clouds(track, clouds, slam)


def _is_due(track: VehicleTrack, stamp: float) -> bool:
    """Return whether a scan of a stamp (s) is later than the last match, or the first of all.

    That one may have the stamp of the first odometry: the vehicle is then where it has started,
    and no motion after it is left to the wheels alone.
    """
    if stamp == track.odometry.first:
        return not track.matcher.started
    return stamp > max(track.matched_until, track.odometry.first)


def _refine_by_clouds(
    track: VehicleTrack, clouds: Sequence[PlacedCloud], slam: FastSlamConfig
) -> None:
    """Match clouds of several lasers at once and correct the odometry since the last match."""
    stamp, cloud = clouds[-1]
    if not _is_due(track, stamp):
        return
    since = max(track.matched_until, track.odometry.first)
    if len(clouds) > 1:
        now = track.odometry.at(stamp)
        cloud = merged([c.moved(now.between(track.odometry.at(s))) for s, c in clouds])
    prior = track.source.prior(track.odometry, since, stamp, slam)
    if track.matcher.started and prior.still:
        track.slip.add_still_scan(stamp, track.matcher, cloud, prior.pose)
        track.matched_until = stamp
        track.clouds.append((stamp, cloud))
        return
    restarts = track.matcher.restarts
    match = track.matcher.match_cloud(cloud, prior.pose, prior.covariance)
    restarted = track.matcher.restarts != restarts
    if isinstance(match, ScanMatch):
        track.count('matched_scans')
        track.clouds.append((stamp, cloud))
        before = track.odometry.at(since)
        if not restarted and not track.source.needs_scans:
            motions = before.between(prior.pose), before.between(match.pose)
            track.slip.add_match(since, stamp, *motions, slam.odometry_noise)
        # where the map began anew, only odometry connects it with the last match
        drift = track.source.take_match(track.odometry, since, stamp, prior, match, restarted)
        wheels = track.bridge.scaled(prior.pose.between(match.pose), prior.covariance)
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
