"""Publishers of the agent: poses, plans, maps, landmarks, frontiers, status, transforms."""

import importlib.util
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, PoseArray, PoseWithCovarianceStamped, TransformStamped
from nav_msgs.msg import OccupancyGrid, Path
from rclpy.node import Node
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import ColorRGBA, String
from visualization_msgs.msg import Marker, MarkerArray

from explore_slam.data import Plan
from explore_slam.exploration import Frontier
from explore_slam.geometry import Array, Pose2
from explore_slam.messages import (
    cloud_message,
    estimate_message,
    grid_message,
    path_message,
    pose_array_message,
    time_message,
)
from explore_slam.nodes.agent_parameters import AgentNodeConfig
from explore_slam.nodes.messages import MESSAGES
from explore_slam.nodes.vehicle_support import LATCHED

RELIABLE = QoSProfile(depth=10)
BEST_EFFORT = QoSProfile(depth=1, reliability=QoSReliabilityPolicy.BEST_EFFORT)


class AgentOutputs:
    """All that the agent says."""

    def __init__(self, node: Node, config: AgentNodeConfig) -> None:
        self._node = node
        self._config = config
        self._publishers: dict[str, dict[str, Any]] = {
            vehicle: {
                'pose': node.create_publisher(
                    PoseWithCovarianceStamped, f'{vehicle}/pose', RELIABLE
                ),
                'plan': node.create_publisher(Path, f'{vehicle}/plan', LATCHED),
                'trajectory': node.create_publisher(Path, f'{vehicle}/trajectory', RELIABLE),
                'particles': node.create_publisher(PoseArray, f'{vehicle}/particles', BEST_EFFORT),
            }
            for vehicle in config.vehicles
        }
        self._map = node.create_publisher(OccupancyGrid, 'map', LATCHED)
        self._landmarks = node.create_publisher(PointCloud2, 'map_landmarks', LATCHED)
        self._frontiers = node.create_publisher(MarkerArray, 'explore/frontiers', RELIABLE)
        self._status = node.create_publisher(String, 'explore/status', LATCHED)
        self._last_status = ''
        self._last_plans: dict[str, Plan | None] = {}
        self._transforms: Any = None
        if importlib.util.find_spec('tf2_msgs') is not None:
            from tf2_msgs.msg import TFMessage

            self._tf_type = TFMessage
            self._transforms = node.create_publisher(TFMessage, '/tf', QoSProfile(depth=100))

    def pose(self, vehicle: str, stamp: float, pose: Pose2, covariance: Array) -> None:
        """Publish where a vehicle is."""
        message = estimate_message(MESSAGES, stamp, self._config.map_frame, pose, covariance)
        self._publishers[vehicle]['pose'].publish(message)

    def transform(self, vehicle: str, stamp: float, pose: Pose2, odometry: Pose2) -> None:
        """Publish map -> odom (REP-105), where tf2_msgs is installed."""
        if self._transforms is None:
            return
        offset = pose.compose(odometry.inverse())
        message = TransformStamped()
        message.header.stamp = time_message(MESSAGES, stamp)
        message.header.frame_id = self._config.map_frame
        message.child_frame_id = f'{vehicle}/{self._config.odom_frame}'
        message.transform.translation.x, message.transform.translation.y = offset.x, offset.y
        message.transform.rotation.z = float(np.sin(offset.theta / 2))
        message.transform.rotation.w = float(np.cos(offset.theta / 2))
        self._transforms.publish(self._tf_type(transforms=[message]))

    def particles(self, vehicle: str, stamp: float, poses: Array) -> None:
        """Publish particles (M, 3), thinned to the number wanted."""
        publisher, most = self._publishers[vehicle]['particles'], self._config.published_particles
        if most == 0 or publisher.get_subscription_count() == 0:
            return
        step = max(1, -(-len(poses) // most))
        publisher.publish(
            pose_array_message(MESSAGES, stamp, self._config.map_frame, poses[::step])
        )

    def plans(self, stamp: float, plans: dict[str, Plan]) -> None:
        """Publish the plans that changed; a vehicle without one gets an empty path, once."""
        for vehicle, publishers in self._publishers.items():
            plan = plans.get(vehicle)
            if vehicle in self._last_plans and plan is self._last_plans[vehicle]:
                continue
            self._last_plans[vehicle] = plan
            points = np.empty((0, 2)) if plan is None else plan.waypoints
            publishers['plan'].publish(
                path_message(MESSAGES, stamp, self._config.map_frame, points)
            )

    def configure(self, config: AgentNodeConfig) -> None:
        """Go on with other settings."""
        self._config = config

    def trajectory(self, vehicle: str, stamp: float, stamps: Array, poses: Array) -> None:
        """Publish the path of a vehicle so far: stamps (K,) s and poses (K, 3)."""
        message = path_message(MESSAGES, stamp, self._config.map_frame, poses, stamps)
        self._publishers[vehicle]['trajectory'].publish(message)

    def grid(self, stamp: float, grid: Any) -> None:
        """Publish an occupancy grid."""
        self._map.publish(self.grid_message(stamp, grid))

    def grid_message(self, stamp: float, grid: Any) -> Any:
        """Return an occupancy grid as a message."""
        return grid_message(
            MESSAGES,
            stamp,
            self._config.map_frame,
            grid.to_occupancy(),
            grid.resolution,
            grid.origin,
        )

    def landmarks(self, stamp: float, landmarks: Any) -> None:
        """Publish the landmarks: x, y, z, standard deviation (m), number of observations."""
        traces = np.trace(landmarks.covariances, axis1=1, axis2=2)
        columns = [(axis, landmarks.means[:, i]) for i, axis in enumerate('xyz')]
        columns += [('sigma', np.sqrt(np.maximum(traces, 0.0))), ('count', landmarks.counts)]
        named = [(name, np.asarray(values, np.float32)) for name, values in columns]
        self._landmarks.publish(cloud_message(MESSAGES, stamp, self._config.map_frame, named))

    def frontiers(self, stamp: float, frontiers: tuple[Frontier, ...]) -> None:
        """Publish where frontiers are (centroids) and the places to look into them from."""
        centroids = [frontier.centroid for frontier in frontiers]
        targets = [frontier.target for frontier in frontiers]
        self._frontiers.publish(
            MarkerArray(
                markers=[
                    self._marker(stamp, 'frontiers', centroids, (0.2, 0.5, 1.0)),
                    self._marker(stamp, 'targets', targets, (1.0, 0.5, 0.1)),
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
        marker.scale.x = marker.scale.y = marker.scale.z = 0.15
        marker.color = ColorRGBA(r=color[0], g=color[1], b=color[2], a=0.9)
        marker.points = [Point(x=float(x), y=float(y)) for x, y in points]
        return marker

    def status(self, status: str) -> bool:
        """Publish the state of the exploration when it changes; tell whether it did."""
        if status == self._last_status:
            return False
        self._last_status = status
        self._status.publish(String(data=status))
        self._node.get_logger().info(status.replace('_', ' '))
        return True
