"""Inter-robot observations: the position of one vehicle measured by another."""

from explore_slam.agent.measurements.kind import MeasurementHandler
from explore_slam.agent.team import Team
from explore_slam.agent.vehicle_track import VehicleTrack
from explore_slam.data import InterRobotObservation


def check(team: Team, observation: InterRobotObservation) -> None:
    """Raise AgentError if the observed vehicle is unknown."""
    team.track(observation.vehicle)


def process(team: Team, track: VehicleTrack, observation: InterRobotObservation) -> None:
    """Bring both vehicles to the stamp of the observation and update the filter with it."""
    if team.is_late(track, observation.stamp):
        return
    slam = team.config.slam
    if slam.maps == 'dedicated' or not slam.inter_robot_observations:
        track.count('unused_inter_robot_observations')
        return
    other = team.tracks[observation.vehicle]
    if (
        not team.belief.are_in_one_frame(track.name, other.name)
        or other.odometry.last < observation.stamp
        or team.is_late(other, observation.stamp)
    ):
        track.count('unmatched_inter_robot_observations')
        return
    for observed in (track, other):
        team.predict(observed, observation.stamp)
        team.add_keyframe(observed, observation.stamp)
    team.belief.update_inter_robot(track.name, [observation])


INTER_ROBOT = MeasurementHandler(InterRobotObservation, process, check)
