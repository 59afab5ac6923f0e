"""RGB-D frames: keyframes are chosen by travel and time, their features become observations."""

from explore_slam.agent.measurements.kind import MeasurementHandler
from explore_slam.agent.team import Team
from explore_slam.agent.vehicle_track import VehicleTrack
from explore_slam.data import RgbdFrame


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


FRAMES = MeasurementHandler(RgbdFrame, process)
