"""Landmark observations that were extracted elsewhere: on the vehicle, or in a data set."""

from explore_slam.agent.measurements.kind import MeasurementHandler
from explore_slam.agent.team import Team
from explore_slam.agent.vehicle_track import VehicleTrack
from explore_slam.data import LandmarkObservations


def process(team: Team, track: VehicleTrack, observations: LandmarkObservations) -> None:
    """Update the filter with landmark observations."""
    if team.is_late(track, observations.stamp):
        return
    track.last_seen = observations.stamp
    team.update(track, observations)


LANDMARKS = MeasurementHandler(LandmarkObservations, process)
