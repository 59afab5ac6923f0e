"""A vehicle on a plane for the follower's tests: acceleration limits, latency, no noise."""

import math
from collections import deque

import numpy as np
import pytest

from explore_slam.data import LaserScan, OdometryReading, Plan
from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.mounts import LaserMountConfig
from explore_slam.vehicle import PathFollower, VelocityCommand

TICK = 0.01


class Track:
    """Drives a PathFollower in closed loop: odometry at 10 Hz, scans at 5 Hz, poses at 0.5 Hz.

    Obstacles are discs (x, y, radius). Commands act after `latency` s; odometry and scans come
    `latency` s late.
    """

    def __init__(self, follower, start=IDENTITY, obstacles=(), latency=0.1):
        self.follower = follower
        self.pose = start
        self.origin = Pose2(3.0, -2.0, 0.7)  # odometry frame: any other than the map
        self.time = 0.0
        self.velocity = [0.0, 0.0]
        self.obstacles = [tuple(o) for o in obstacles]
        self.latency = latency
        self.commands = deque()
        self.deliveries = deque()
        self.history = []
        self.silent = set()
        self.last: VelocityCommand | None = None

    def scan(self):
        laser = self.pose.compose(LaserMountConfig().pose)
        angles = np.radians(np.arange(-90, 91))
        ranges = np.full(181, np.inf)
        for ox, oy, r in self.obstacles:
            dx, dy = ox - laser.x, oy - laser.y
            along = dx * np.cos(laser.theta + angles) + dy * np.sin(laser.theta + angles)
            off2 = dx * dx + dy * dy - along**2
            hit = (off2 < r * r) & (along > 0)
            ranges[hit] = np.minimum(
                ranges[hit], along[hit] - np.sqrt(np.maximum(r * r - off2[hit], 0))
            )
        return LaserScan(
            self.time, -math.pi / 2, math.pi / 180, ranges.astype(np.float32), 0.02, 8.0
        )

    def step(self):
        tick = round(self.time / TICK)
        if tick % 10 == 0 and 'odometry' not in self.silent:
            odometry = OdometryReading(self.time, self.origin.compose(self.pose))
            self.deliver(lambda r=odometry: self.follower.set_odometry(r, self.time))
        if tick % 20 == 5 and 'laser' not in self.silent:
            scan = self.scan()
            self.deliver(lambda s=scan: self.follower.set_scan(s, self.time))
        if tick % 100 == 0 and 'agent' not in self.silent:
            stamp, pose = self.time, self.pose
            self.deliver(lambda: self.follower.set_pose(stamp, pose, self.time))
        while self.deliveries and self.deliveries[0][0] <= self.time + 1e-9:
            self.deliveries.popleft()[1]()
        if tick % 5 == 0:
            self.last = self.follower.command(self.time)
            self.commands.append((self.time + self.latency, self.last.linear, self.last.angular))
        while self.commands and self.commands[0][0] <= self.time + 1e-9:
            _, *self.target = self.commands.popleft()
        for i, limit in enumerate((0.8, 3.0)):
            change = getattr(self, 'target', (0.0, 0.0))[i] - self.velocity[i]
            self.velocity[i] += max(-limit * TICK, min(limit * TICK, change))
        self.pose = self.pose.compose(Pose2(self.velocity[0] * TICK, 0.0, self.velocity[1] * TICK))
        self.history.append((self.time, *self.pose, *self.velocity))
        self.time += TICK

    def deliver(self, call):
        self.deliveries.append((self.time + self.latency, call))

    def run(self, seconds, until=lambda _: False):
        end = self.time + seconds
        while self.time < end and not until(self):
            self.step()
        return self

    def clearance(self, radius=0.25):
        """Return the least room (m) there ever was between the body and an obstacle."""
        path = np.array(self.history)[:, 1:3]
        return min(
            float(np.min(np.hypot(path[:, 0] - x, path[:, 1] - y))) - r - radius
            for x, y, r in self.obstacles
        )


@pytest.fixture
def make_track():
    """Return a function: waypoints, config -> a Track with a follower that has this plan."""

    def make(waypoints, config=None, **kwargs):
        follower = PathFollower(config)
        points = np.asarray(waypoints, dtype=float)
        follower.set_plan(Plan(0.0, 'robot1', Pose2(*points[-1], 0.0), points))
        return Track(follower, **kwargs)

    return make
