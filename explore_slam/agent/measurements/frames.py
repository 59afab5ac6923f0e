"""RGB-D frames: keyframes are chosen by travel and time, their features become observations.

Every frame shows obstacles that a laser does not see.
"""

from explore_slam.agent.measurements.kind import MeasurementHandler, enqueue
from explore_slam.agent.measurements.obstacles import process as process_obstacles
from explore_slam.agent.measurements.scans import enqueue_scan_of_one_moment
from explore_slam.agent.team import Team
from explore_slam.agent.vehicle_track import VehicleTrack
from explore_slam.data import RgbdFrame


def enqueue_frame(team: Team, track: VehicleTrack, frame: RgbdFrame) -> None:
    """Queue a frame, and of a vehicle without a laser the scan that it shows before it."""
    if track.name in team.camera_scans:
        enqueue_scan_of_one_moment(team, track, team.detectors[track.name].scan(frame))
    enqueue(team, track, frame)


def process(team: Team, track: VehicleTrack, frame: RgbdFrame) -> None:
    """Extract landmark observations from a keyframe and update the filter with them."""
    if team.is_late(track, frame.stamp):
        return
    track.last_seen = frame.stamp
    track.count('frames')
    selector = track.selector_of(frame.sensor)
    if selector.select(frame.stamp, track.odometry.at(frame.stamp)):
        team.update(track, team.extractor.extract(frame))
        tags = team.extractor.observe_tags(frame)
        if tags is not None:
            team.add_tags(track, tags)
    if team.config.vision.obstacles.depth_obstacles:
        process_obstacles(team, track, team.detectors[track.name].detect(frame))


FRAMES = MeasurementHandler(RgbdFrame, process, enqueue=enqueue_frame)
