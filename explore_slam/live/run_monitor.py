"""Monitors a live run over its topics, for the run folder and the terminal."""

import contextlib
import math
from collections import deque
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PolygonStamped, PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid, Odometry, Path
from numpy.typing import NDArray
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String
from std_srvs.srv import Trigger

from explore_slam.agent import OperatorAreas
from explore_slam.errors import ExploreSlamError
from explore_slam.geometry import Array, Pose2
from explore_slam.messages import (
    cloud_columns,
    grid_arrays,
    odometry_record,
    planar_covariance,
    planar_pose,
    seconds,
)
from explore_slam.messages.topics import (
    GlobalTopic,
    Qos,
    TeamTopic,
    TopicKind,
    VehicleTopic,
    vehicle_topic,
)
from explore_slam.nodes.agent_inputs import operator_polygon
from explore_slam.nodes.endpoints import LatchedOrNotSubscription, relative_name, subscribe
from explore_slam.results.reachable_area import ReachableArea
from explore_slam.results.run_data import RunRecorder

Values = dict[str, str]
TRUTHS = 200  # newest true poses kept, for the error of the newest pose
RECORDER_NODE = 'recorder'  # name of the node
COMPLETE = Qos(200)  # the run folder needs every message, also those of a burst


@dataclass
class ReceivedLandmarks:
    """Landmarks of the topic: means (N, 3) m, covariances (N, 3, 3) m², observations (N,)."""

    means: Array
    covariances: Array
    counts: NDArray[np.int64]


@dataclass
class RunState:
    """The current state of the run."""

    stamp: float = 0.0
    status: str = ''
    coverage: float = 0.0
    diagnostics: dict[str, tuple[str, Values]] = field(default_factory=dict)
    grid: Any = None
    landmarks: ReceivedLandmarks | None = None
    trajectories: dict[str, tuple[Array, Array]] = field(default_factory=dict)
    truth: dict[str, deque[tuple[float, Pose2]]] = field(default_factory=dict)
    poses: dict[str, tuple[float, Pose2]] = field(default_factory=dict)
    messages: dict[str, int] = field(default_factory=dict)

    def position_error(self, vehicle: str) -> float:
        """Return the error (m) of the newest pose at its stamp; NaN if unknown."""
        if vehicle not in self.poses or not self.truth.get(vehicle):
            return math.nan
        stamp, pose = self.poses[vehicle]
        _, true = min(self.truth[vehicle], key=lambda known: abs(known[0] - stamp))
        return math.hypot(true.x - pose.x, true.y - pose.y)


class RunMonitor(Node):
    """Subscribes to agent and simulator; keeps the current state and records the whole run."""

    def __init__(
        self,
        starts: dict[str, Pose2],
        recorder: RunRecorder,
        area: ReachableArea,
        map_frame: str = 'map',
    ) -> None:
        super().__init__('run_monitor')
        self.state = RunState()
        self.recorder = recorder
        self._reachable = area
        self._area = area  # without what the operator has left out
        self._operator = OperatorAreas()
        self._map_frame = map_frame
        self._vehicles = list(starts)
        subscribe(self, GlobalTopic.CLOCK, self._on_clock)
        subscribe(self, TeamTopic.MAP_PROBABILITY, self._on_map)
        subscribe(self, TeamTopic.MAP_LANDMARKS, self._on_landmarks)
        subscribe(self, TeamTopic.STATUS, self._on_status)
        subscribe(self, GlobalTopic.DIAGNOSTICS, self._on_diagnostics, qos=COMPLETE)
        for topic in (TeamTopic.AREA, TeamTopic.KEEP_OUT):
            LatchedOrNotSubscription(self, topic, partial(self._on_polygon, topic))
        for vehicle in starts:
            self._follow(vehicle)
        self._save_map = self.create_client(Trigger, 'save_map')

    def _follow(self, vehicle: str) -> None:
        def on_pose(message: PoseWithCovarianceStamped) -> None:
            stamp, pose = seconds(message.header.stamp), planar_pose(message.pose.pose)
            self.state.poses[vehicle] = (stamp, pose)
            self.recorder.add_pose(vehicle, stamp, pose)
            covariance = planar_covariance(message.pose.covariance)
            self.recorder.add_estimate(vehicle, stamp, pose, covariance)

        def on_truth(message: Odometry) -> None:
            reading = odometry_record(message)
            newest = self.state.truth.setdefault(vehicle, deque(maxlen=TRUTHS))
            newest.append((reading.stamp, reading.pose))
            self.recorder.add_truth(vehicle, reading.stamp, reading.pose)

        def on_odometry(message: Odometry) -> None:
            self.state.messages[vehicle] = self.state.messages.get(vehicle, 0) + 1
            self.recorder.add_odometry(vehicle, odometry_record(message))

        def on_trajectory(message: Path) -> None:
            poses = [planar_pose(stamped.pose) for stamped in message.poses]
            stamps = [seconds(stamped.header.stamp) for stamped in message.poses]
            self.state.trajectories[vehicle] = (
                np.array(stamps),
                np.array(poses, dtype=np.float64).reshape(-1, 3),
            )

        subscribe(self, VehicleTopic.POSE, on_pose, vehicle, COMPLETE)
        subscribe(self, TopicKind.GROUND_TRUTH, on_truth, vehicle, COMPLETE)
        subscribe(self, TopicKind.ODOMETRY, on_odometry, vehicle, COMPLETE)
        subscribe(self, VehicleTopic.TRAJECTORY, on_trajectory, vehicle, COMPLETE)

    def _on_clock(self, message: Clock) -> None:
        self.state.stamp = seconds(message.clock)

    def _on_map(self, message: OccupancyGrid) -> None:
        cells, resolution, origin = grid_arrays(message)
        self.state.grid = (cells.copy(), resolution, origin)
        self.state.coverage = self._area.explored_fraction(cells >= 0, resolution, origin)
        self.recorder.add_coverage(seconds(message.header.stamp), self.state.coverage)

    def _on_polygon(self, topic: TeamTopic, message: PolygonStamped) -> None:
        """Take an area as the agent does, which logs those that are refused."""
        change = self._operator.set_area
        if topic is TeamTopic.KEEP_OUT:
            change = self._operator.add_keep_out
        with contextlib.suppress(ExploreSlamError):
            change(operator_polygon(message, self._map_frame))
        self._area = self._reachable.without(self._operator)

    @property
    def area_left_out(self) -> float:
        """Reachable area (m²) that the operator has left out."""
        return self._reachable.area - self._area.area

    def _on_landmarks(self, message: PointCloud2) -> None:
        columns = cloud_columns(message)
        means = np.concatenate([columns[axis] for axis in 'xyz'], axis=1).astype(np.float64)
        variances = columns['sigma'][:, 0].astype(np.float64) ** 2 / 3.0
        covariances = variances[:, None, None] * np.eye(3)
        counts = columns['count'][:, 0].astype(np.int64)
        self.state.landmarks = ReceivedLandmarks(means, covariances, counts)

    def _on_status(self, message: String) -> None:
        self.state.status = message.data

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            self.state.diagnostics[status.name] = (status.message, values)
            if 'effective_particles' in values:
                count = float(values['effective_particles'])
                self.recorder.add_effective_particles(seconds(message.header.stamp), count)

    def values(self, name: str) -> tuple[str, Values]:
        """Return message and values of the diagnostics whose name ends so, or empty ones."""
        for full, found in self.state.diagnostics.items():
            if full.endswith(name):
                return found
        return '', {}

    def is_recorded(self) -> bool:
        """Return whether the recorder has subscribed to all topics of the vehicles."""
        names = [name for name, _ in self.get_topic_names_and_types()]
        sensors = [
            name
            for name in names
            if vehicle_topic(name) is not None and self.get_publishers_info_by_topic(name)
        ]
        odometry = {
            self.resolve_topic_name(relative_name(TopicKind.ODOMETRY, vehicle))
            for vehicle in self._vehicles
        }
        return odometry <= set(sensors) and all(
            any(
                subscription.node_name == RECORDER_NODE
                for subscription in self.get_subscriptions_info_by_topic(name)
            )
            for name in sensors
        )

    def ask_for_map(self) -> Any:
        """Call save_map of the agent; return the future of the answer."""
        return self._save_map.call_async(Trigger.Request())
