"""Views of depth cameras: what they show of obstacles enters the layer of the map."""

from explore_slam.agent.measurements.kind import MeasurementHandler
from explore_slam.agent.team import Team
from explore_slam.agent.vehicle_track import VehicleTrack
from explore_slam.data import ObstacleView
from explore_slam.geometry import moved_enough


def process(team: Team, track: VehicleTrack, view: ObstacleView) -> None:
    """Add a view to the layer if the vehicle has moved on since the last one of this camera."""
    track.new_views[view.sensor], track.has_camera = view, True
    if track.keyframe is None or track.placement.displaced:
        track.count('unused_obstacle_views')
        return
    pose = track.odometry.at(view.stamp)
    if view.sensor in track.last_views:
        stamp, before = track.last_views[view.sensor]
        scans = team.config.scans
        moved = moved_enough(before.between(pose), scans.map_scan_distance, scans.map_scan_heading)
        if not moved and view.stamp - stamp < scans.map_scan_period:
            return
    track.last_views[view.sensor] = (view.stamp, pose)
    track.count('obstacle_views')
    team.obstacle_map.add(
        track.keyframe.number,
        track.name,
        view,
        track.keyframe.odometry.between(pose),
        team.bodies(track, view),
    )


OBSTACLES = MeasurementHandler(ObstacleView, process, draws_map=True)
