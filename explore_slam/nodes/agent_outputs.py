"""Publishers of the agent: poses, maps, landmarks, frontiers, status, transforms."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from geometry_msgs.msg import Point
from numpy.typing import NDArray
from rclpy.node import Node
from std_msgs.msg import ColorRGBA, String
from visualization_msgs.msg import Marker, MarkerArray

from explore_slam.data import ObstacleView, OdometryReading
from explore_slam.exploration import Frontier
from explore_slam.geometry import Array, Pose2
from explore_slam.mapping import OccupancyGrid
from explore_slam.messages import (
    cloud_message,
    estimate_message,
    odometry_message,
    path_message,
    planar_transform_message,
    pose_array_message,
    time_message,
)
from explore_slam.messages.obstacles import obstacles_message
from explore_slam.messages.sweep_status import sweeps_message
from explore_slam.messages.topics import TeamTopic, TopicKind, VehicleTopic
from explore_slam.nodes.agent_parameters import AgentNodeConfig
from explore_slam.nodes.endpoints import TransformBroadcaster, publisher
from explore_slam.nodes.map_outputs import MapOutputs
from explore_slam.nodes.ros_types import MESSAGES
from explore_slam.slam import Landmarks
from explore_slam.sweeps import Sweep

_RESULTS = (
    VehicleTopic.POSE, VehicleTopic.TRAJECTORY, VehicleTopic.PARTICLES, VehicleTopic.SWEEPS,
    VehicleTopic.SCAN_ODOMETRY,
)  # fmt: skip
# what RViz shows: side of a cube (m), colours (red, green, blue) and opacity
_MARKER_SIZE = 0.15
_FRONTIER_COLOR = (0.2, 0.5, 1.0)
_TARGET_COLOR = (1.0, 0.5, 0.1)
_MARKER_OPACITY = 0.9


class AgentOutputs:
    """All publishers of the agent."""

    def __init__(self, node: Node, config: AgentNodeConfig) -> None:
        self._node = node
        self._config = config
        self._vehicle = {
            (vehicle, topic): publisher(node, topic, vehicle)
            for vehicle in config.vehicles
            for topic in _RESULTS
        }
        self._obstacles: dict[str, Any] = {}  # of vehicles whose images the agent has
        self.maps = MapOutputs(node)
        self._landmarks = publisher(node, TeamTopic.MAP_LANDMARKS)
        self._frontiers = publisher(node, TeamTopic.FRONTIERS)
        self._status = publisher(node, TeamTopic.STATUS)
        self._last_status = ''
        self._transforms = TransformBroadcaster(node)

    def pose(self, vehicle: str, stamp: float, pose: Pose2, covariance: Array) -> None:
        """Publish the pose estimate of a vehicle."""
        message = estimate_message(MESSAGES, stamp, self._config.map_frame, pose, covariance)
        self._vehicle[vehicle, VehicleTopic.POSE].publish(message)

    def sweeps(self, vehicle: str, found: Mapping[str, Sweep]) -> None:
        """Publish what the scans of a vehicle's lasers have shown of their sweeps."""
        message = sweeps_message(MESSAGES, vehicle, found)
        self._vehicle[vehicle, VehicleTopic.SWEEPS].publish(message)

    def transform(
        self, vehicle: str, stamp: float, pose: Pose2, odometry: Pose2, odom_frame: str
    ) -> None:
        """Publish the transform map -> odom (REP-105), which completes the vehicle's tree.

        odometry: pose that the base has reported at the stamp (s), which is that of odom -> base.
        It is dated transform_tolerance into the future, so that others need not wait for the next.
        """
        offset = pose.compose(odometry.inverse())
        valid = stamp + self._config.transform_tolerance
        self._transforms.send(
            planar_transform_message(MESSAGES, valid, self._config.map_frame, odom_frame, offset),
            vehicle,
        )

    def scan_odometry(
        self, vehicle: str, reading: OdometryReading, frames: tuple[str, str], transform: bool
    ) -> None:
        """Publish the odometry of a vehicle by its scans.

        frames: of odometry and base. transform: publish odometry -> base, too: no base does.
        """
        message = odometry_message(MESSAGES, reading, *frames)
        self._vehicle[vehicle, VehicleTopic.SCAN_ODOMETRY].publish(message)
        if transform:
            self._transforms.send(
                planar_transform_message(MESSAGES, reading.stamp, *frames, reading.pose), vehicle
            )

    def obstacles(self, vehicle: str, view: ObstacleView, base: str) -> None:
        """Publish what the cameras of a vehicle see, for its path follower; base: its frame."""
        if vehicle not in self._obstacles:
            self._obstacles[vehicle] = publisher(self._node, TopicKind.OBSTACLES, vehicle)
        self._obstacles[vehicle].publish(obstacles_message(MESSAGES, view, base))

    def particles(self, vehicle: str, stamp: float, poses: Array) -> None:
        """Publish the poses (M, 3) of the particles, thinned to published_particles."""
        output = self._vehicle[vehicle, VehicleTopic.PARTICLES]
        most = self._config.published_particles
        if most == 0 or output.get_subscription_count() == 0:
            return
        step = max(1, -(-len(poses) // most))
        output.publish(pose_array_message(MESSAGES, stamp, self._config.map_frame, poses[::step]))

    def configure(self, config: AgentNodeConfig) -> None:
        """Replace the settings."""
        self._config = config

    def trajectory(self, vehicle: str, stamp: float, stamps: Array, poses: Array) -> None:
        """Publish the trajectory of a vehicle so far: stamps (K,) s and poses (K, 3)."""
        message = path_message(MESSAGES, stamp, self._config.map_frame, poses, stamps)
        self._vehicle[vehicle, VehicleTopic.TRAJECTORY].publish(message)

    def grid(self, stamp: float, grid: OccupancyGrid) -> None:
        """Publish the occupancy grid."""
        self.maps.publish(stamp, self._config.map_frame, grid)

    def grid_update(self, stamp: float, grid: OccupancyGrid) -> None:
        """Publish what has changed in the occupancy grid since it was published last."""
        self.maps.publish_update(stamp, self._config.map_frame, grid)

    def landmarks(self, stamp: float, landmarks: Landmarks) -> None:
        """Publish the landmarks: x, y, z, standard deviation (m), number of observations."""
        traces = np.trace(landmarks.covariances, axis1=1, axis2=2)
        columns: list[tuple[str, NDArray[Any]]] = [
            (axis, landmarks.means[:, i]) for i, axis in enumerate('xyz')
        ]
        columns += [('sigma', np.sqrt(np.maximum(traces, 0.0))), ('count', landmarks.counts)]
        named = [(name, np.asarray(values, np.float32)) for name, values in columns]
        self._landmarks.publish(cloud_message(MESSAGES, stamp, self._config.map_frame, named))

    def frontiers(self, stamp: float, frontiers: tuple[Frontier, ...]) -> None:
        """Publish the centroids of the frontiers, and the viewpoints to observe them from."""
        centroids = [frontier.centroid for frontier in frontiers]
        targets = [frontier.target for frontier in frontiers]
        self._frontiers.publish(
            MarkerArray(
                markers=[
                    self._marker(stamp, 'frontiers', centroids, _FRONTIER_COLOR),
                    self._marker(stamp, 'targets', targets, _TARGET_COLOR),
                ]
            )
        )

    def _marker(
        self,
        stamp: float,
        name: str,
        points: list[tuple[float, float]],
        color: tuple[float, float, float],
    ) -> Marker:
        marker = Marker(ns=name, type=Marker.CUBE_LIST)
        marker.header.stamp = time_message(MESSAGES, stamp)
        marker.header.frame_id = self._config.map_frame
        marker.action = Marker.ADD if points else Marker.DELETE
        marker.pose.orientation.w = 1.0
        marker.scale.x = marker.scale.y = marker.scale.z = _MARKER_SIZE
        red, green, blue = color
        marker.color = ColorRGBA(r=red, g=green, b=blue, a=_MARKER_OPACITY)
        marker.points = [Point(x=float(x), y=float(y)) for x, y in points]
        return marker

    def status(self, status: str) -> bool:
        """Publish the state of the exploration if it has changed; return whether it has."""
        if status == self._last_status:
            return False
        self._last_status = status
        self._status.publish(String(data=status))
        self._node.get_logger().info(status.replace('_', ' '))
        return True
