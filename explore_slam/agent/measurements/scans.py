"""Laser scans: matched to refine odometry, thinned, drawn into the grid, used to close loops."""

from explore_slam.agent.measurements.kind import MeasurementHandler, enqueue
from explore_slam.agent.team import Team
from explore_slam.agent.vehicle_track import VehicleTrack
from explore_slam.data import LaserScan
from explore_slam.geometry import Pose2, moved_enough
from explore_slam.registration import scan_cloud


def enqueue_scan(team: Team, track: VehicleTrack, scan: LaserScan) -> None:
    """Queue a scan: as it is, or until its sweep is complete and its motion can be undone."""
    sweeps = track.sweeps.of(scan.sensor)
    dropped = sweeps.takes(scan, team.config.inputs.measurement_queue_length)
    if dropped is None:
        enqueue_scan_of_one_moment(team, track, scan)
    elif dropped:
        track.count('dropped_without_odometry')


def release_sweeps(team: Team, track: VehicleTrack) -> None:
    """Undo the motion within the sweeps that odometry covers by now."""
    laser = team.config.laser_mount.pose
    for sweeps in track.sweeps.all:
        while (scan := sweeps.pop(track.odometry, laser)) is not None:
            track.count('deskewed_scans', int(scan.bearings is not None))
            enqueue_scan_of_one_moment(team, track, scan)


def enqueue_scan_of_one_moment(team: Team, track: VehicleTrack, scan: LaserScan) -> None:
    """Queue a scan for the map and, if the vehicle's scans are matched, for matching."""
    if team.matches_scans(track):
        track.unmatched.push(scan, team.config.inputs.measurement_queue_length)
    if track.unmapped:
        track.count('ignored_while_paused')
    else:
        enqueue(team, track, scan)


def process(team: Team, track: VehicleTrack, scan: LaserScan) -> None:
    """Add a scan to the laser map if the vehicle has moved on since the last one."""
    team.loops.search_joins(team.belief)
    if track.keyframe is None:
        track.count('late_observations')
        return
    pose = track.odometry.at(scan.stamp)
    if not _enters_map(team, track, scan, pose):
        return
    track.last_scans[scan.sensor] = (scan.stamp, pose)
    _add_keyframe_without_vision(team, track, scan.stamp)
    moved = track.keyframe.odometry.between(pose)
    team.laser_map.add(
        track.keyframe.number,
        track.name,
        scan,
        moved.compose(team.laser_pose(scan)),
        team.bodies(track, scan),
    )
    _close_loops(team, track, scan, moved)


def _close_loops(team: Team, track: VehicleTrack, scan: LaserScan, moved: Pose2) -> None:
    """Attach a scan to the newest keyframe, unless matching refused it, and search for loops.

    moved: motion since the keyframe.
    """
    if team.matches_scans(track):
        cloud = track.cloud_of(scan.stamp)
    else:
        laser = team.laser_pose(scan)
        cloud = scan_cloud(scan, laser, team.config.scan_matching.matching_range)
        cloud = cloud.masked(team.discs(track, scan))
    if cloud is None or track.keyframe is None:
        return
    counts = team.loops.add_scan(team.belief, track.name, track.keyframe, moved, cloud, scan.stamp)
    track.count('closures', counts.closed)
    track.count('closures_retracted', counts.retracted)


def _enters_map(team: Team, track: VehicleTrack, scan: LaserScan, pose: Pose2) -> bool:
    """Return whether the vehicle moved far enough, or long enough passed, since the last scan.

    Scans are compared with those of the same laser.
    """
    last = track.last_scans.get(scan.sensor)
    if last is None:
        return True
    last_stamp, last_pose = last
    scans = team.config.scans
    return (
        moved_enough(last_pose.between(pose), scans.map_scan_distance, scans.map_scan_heading)
        or scan.stamp - last_stamp >= scans.map_scan_period
    )


def _add_keyframe_without_vision(team: Team, track: VehicleTrack, stamp: float) -> None:
    """Add a keyframe from odometry alone while there are no frames, so that scans have a pose."""
    keyframes = team.config.vision.keyframes
    if stamp - track.last_seen < keyframes.maximum_keyframe_gap or team.is_late(track, stamp):
        return
    if moved_enough(
        track.moved_since_keyframe(stamp),
        keyframes.minimum_travel_distance,
        keyframes.minimum_travel_heading,
    ):
        team.predict(track, stamp)
        team.add_keyframe(track, stamp)


SCANS = MeasurementHandler(LaserScan, process, enqueue=enqueue_scan, draws_map=True)
