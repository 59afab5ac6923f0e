"""Robots of other people: sensors, frames, clocks and transforms as their drivers publish them."""

import math
import time
from dataclasses import dataclass, field

import numpy as np
import rclpy
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import LaserScan

from explore_slam import messages
from explore_slam.data import OdometryReading
from explore_slam.geometry import Pose2, quaternion_from_rotation, rotation_matrix
from explore_slam.messages.transforms import TransformTree
from explore_slam.nodes.ros_types import MESSAGES

LATCHED = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
HALF_WIDTH, HALF_HEIGHT = 4.0, 2.5  # m; the room is 8 m x 5 m
BEAMS = 360
RANGE_NOISE = 0.01  # m
PERIOD = 0.1  # s between scans


@dataclass
class Robot:
    """How one robot is built and configured.

    mount: x, y, z (m), roll, pitch, yaw (rad) of the lidar in the base frame.
    transforms: topic of its static transforms; '' for a robot without.
    increment: sign of the direction in which the lidar turns.
    """

    name: str
    start: Pose2
    mount: tuple[float, float, float, float, float, float]
    odom_frame: str
    base_frame: str
    laser_frame: str
    transforms: str = '/tf_static'
    increment: float = 1.0
    scan_ahead: float = 0.0
    odom_ahead: float = 0.0
    stamped: bool = True
    speed: float = 0.4
    turn: float = 0.25
    pose: Pose2 = field(default_factory=lambda: Pose2(0.0, 0.0, 0.0))
    odometry: Pose2 = field(default_factory=lambda: Pose2(5.0, -3.0, 2.0))
    moving: bool = False

    def __post_init__(self):
        self.pose = self.start

    def advance(self, rng):
        """Drive for a tenth of a second; the first time, stand at the start."""
        if not self.moving:
            self.moving = True
            return
        step = Pose2(self.speed * PERIOD, 0.0, self.turn * PERIOD)
        self.pose = self.pose.compose(step)
        noise = rng.normal(size=3) * (0.002, 0.0, 0.003)
        self.odometry = self.odometry.compose(Pose2(*(np.array(step) * (1.01, 1, 1.01) + noise)))

    def ranges(self, rng):
        """What the lidar sees of the room: with beams that do not return, NaN and zeros."""
        x, y, _, roll, pitch, yaw = self.mount
        angles = self.angle_min + self.increment * math.tau / BEAMS * np.arange(BEAMS)
        beams = np.stack([np.cos(angles), np.sin(angles), np.zeros(BEAMS)])
        directions = rotation_matrix(roll, pitch, yaw) @ beams
        laser = self.pose.compose(Pose2(x, y, 0.0))
        c, s = math.cos(self.pose.theta), math.sin(self.pose.theta)
        u, v = c * directions[0] - s * directions[1], s * directions[0] + c * directions[1]
        with np.errstate(divide='ignore'):
            to_x = np.where(u > 0, (HALF_WIDTH - laser.x) / u, (-HALF_WIDTH - laser.x) / u)
            to_y = np.where(v > 0, (HALF_HEIGHT - laser.y) / v, (-HALF_HEIGHT - laser.y) / v)
        ranges = np.minimum(to_x, to_y) + RANGE_NOISE * rng.normal(size=BEAMS)
        odd = rng.random(BEAMS)
        ranges[odd < 0.05] = np.inf
        ranges[(odd >= 0.05) & (odd < 0.08)] = np.nan
        ranges[(odd >= 0.08) & (odd < 0.1)] = 0.0
        return ranges.astype(np.float32)

    @property
    def angle_min(self):
        return -math.pi if self.increment > 0 else math.pi


class Robots:
    """Publishes what the robots measure, and listens to the agent."""

    def __init__(self, robots, domain, subscriptions):
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = rclpy.create_node('foreign_robots', context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.robots = {robot.name: robot for robot in robots}
        self.rng = np.random.default_rng(11)
        self.heard, self.transforms, self.tree = {}, {}, TransformTree()
        self.stamps = {}  # topic -> stamps (s) of all messages heard there
        for topic, (kind, qos) in subscriptions.items():
            self.node.create_subscription(
                kind, topic, lambda m, topic=topic: self.hear(topic, m), qos
            )
        sensors = qos_profile_sensor_data
        self.out = {
            (name, topic): self.node.create_publisher(kind, f'{name}/{topic}', sensors)
            for name in self.robots
            for topic, kind in (('odom', Odometry), ('scan', LaserScan))
        }
        self.static = []

    def hear(self, topic, message):
        self.heard[topic] = message
        self.stamps.setdefault(topic, []).append(messages.seconds(message.header.stamp))

    def publish_transforms(self):
        """Publish the mounts: one broadcaster and one latched message per robot."""
        from tf2_msgs.msg import TFMessage

        for robot in self.robots.values():
            if not robot.transforms:
                continue
            x, y, z, roll, pitch, yaw = robot.mount
            plate = robot.base_frame.replace('base_footprint', 'base_link') + '_plate'
            turn = quaternion_from_rotation(rotation_matrix(roll, pitch, yaw))
            links = [
                (robot.base_frame, plate, (0.0, 0.0, 0.05), (0.0, 0.0, 0.0, 1.0)),
                (plate, robot.laser_frame, (x, y, z), turn),
            ]
            out = self.node.create_publisher(TFMessage, robot.transforms, LATCHED)
            out.publish(
                TFMessage(
                    transforms=[
                        messages.transform_message(MESSAGES, 0.0, parent, child, place, rotation)
                        for parent, child, place, rotation in links
                    ]
                )
            )
            self.static.append(out)

    def listen_to_tf(self, topics):
        from tf2_msgs.msg import TFMessage

        def on_tf(topic, message):
            for stamped in message.transforms:
                found: TransformStamped = stamped
                self.transforms[topic, found.header.frame_id, found.child_frame_id] = found

        for topic in topics:
            self.node.create_subscription(
                TFMessage, topic, lambda m, topic=topic: on_tf(topic, m), 100
            )

    def spin(self, seconds):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.01)

    def wait_for(self, condition, seconds=60.0):
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, f'nothing after {seconds} s'
            self.executor.spin_once(timeout_sec=0.02)

    def drive(self, ticks):
        """Drive all robots; every tick takes a tenth of a second."""
        for _ in range(ticks):
            end = time.monotonic() + PERIOD
            for robot in self.robots.values():
                robot.advance(self.rng)
                self.publish(robot, time.time())
            self.spin(max(end - time.monotonic(), 0.001))

    def settle(self):
        """Let all robots stand until the agent has taken what they have measured before."""
        begun = time.time()

        def is_newer(name):
            pose = self.heard.get(f'{name}/pose')
            return pose is not None and messages.seconds(pose.header.stamp) > begun

        end = time.monotonic() + 60.0
        while not all(map(is_newer, self.robots)):
            assert time.monotonic() < end, 'the agent has not caught up after 60 s'
            for robot in self.robots.values():
                self.publish(robot, time.time())
            self.spin(PERIOD)

    def publish(self, robot, now):
        reading = OdometryReading(now + robot.odom_ahead, robot.odometry)
        frames = robot.odom_frame, robot.base_frame
        odometry = messages.odometry_message(MESSAGES, reading, *frames)
        scan = LaserScan()
        scan.header.frame_id = robot.laser_frame
        scan.header.stamp = messages.time_message(MESSAGES, now + robot.scan_ahead)
        scan.angle_min = robot.angle_min
        scan.angle_increment = robot.increment * math.tau / BEAMS
        scan.angle_max = scan.angle_min + (BEAMS - 1) * scan.angle_increment
        scan.range_min, scan.range_max = 0.12, 12.0
        scan.ranges = MESSAGES.sequence(robot.ranges(self.rng))
        if not robot.stamped:
            scan.header.stamp.sec = scan.header.stamp.nanosec = 0
            odometry.header.stamp.sec = odometry.header.stamp.nanosec = 0
        self.out[robot.name, 'scan'].publish(scan)
        self.out[robot.name, 'odom'].publish(odometry)

    def close(self):
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)
