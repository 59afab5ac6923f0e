"""Tags that were found elsewhere: on the vehicle, or by another detector."""

from explore_slam.agent.measurements.kind import MeasurementHandler
from explore_slam.agent.team import Team
from explore_slam.agent.vehicle_track import VehicleTrack
from explore_slam.data import TagObservations


def process(team: Team, track: VehicleTrack, observations: TagObservations) -> None:
    """Use tags as landmarks with an identity."""
    if team.is_late(track, observations.stamp) or not len(observations):
        return
    team.add_tags(track, observations)


TAGS = MeasurementHandler(TagObservations, process)
