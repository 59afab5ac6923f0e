"""A small world without simulator: a square room, unique landmarks, vehicles on given paths."""

import math

import numpy as np

from explore_slam.data import LandmarkObservations, LaserScan, OdometryReading
from explore_slam.geometry import Pose2, to_world
from explore_slam.mounts import LaserMountConfig

ROOM = 4.0  # half the side of the room (m)


class SyntheticWorld:
    """Landmarks on the walls of a square room, descriptors unique, all drawn from one seed."""

    def __init__(self, landmarks=60, seed=3):
        rng = np.random.default_rng(seed)
        side = rng.integers(0, 4, landmarks)
        along = rng.uniform(-ROOM, ROOM, landmarks)
        x = np.choose(side, [along, along, np.full(landmarks, ROOM), np.full(landmarks, -ROOM)])
        y = np.choose(side, [np.full(landmarks, ROOM), np.full(landmarks, -ROOM), along, along])
        self.landmarks = np.column_stack([x, y, rng.uniform(0.2, 1.5, landmarks)])
        raw = rng.normal(size=(landmarks, 128)).astype(np.float32)
        self.descriptors = raw / np.linalg.norm(raw, axis=1, keepdims=True)
        self.rng = rng

    def landmarks_from(self, stamp, pose, noise=0.01):
        """What a camera of 120 degrees and 5 m sees from a true pose."""
        local = to_world(pose.inverse(), self.landmarks)
        bearing = np.arctan2(local[:, 1], local[:, 0])
        seen = (np.hypot(local[:, 0], local[:, 1]) < 5.0) & (np.abs(bearing) < math.radians(60))
        count = int(seen.sum())
        positions = local[seen] + noise * self.rng.normal(size=(count, 3))
        covariances = np.tile(noise**2 * np.eye(3), (count, 1, 1))
        return LandmarkObservations(stamp, positions, covariances, self.descriptors[seen])

    def scan_from(self, stamp, pose, beams=181):
        """A 180 degree scan of the walls from a true pose of the laser."""
        angles = np.linspace(-math.pi / 2, math.pi / 2, beams)
        c, s = np.cos(angles + pose.theta), np.sin(angles + pose.theta)
        with np.errstate(divide='ignore'):
            to_x = np.where(c > 0, (ROOM - pose.x) / c, (-ROOM - pose.x) / c)
            to_y = np.where(s > 0, (ROOM - pose.y) / s, (-ROOM - pose.y) / s)
        ranges = np.minimum(to_x, to_y).astype(np.float32)
        return LaserScan(stamp, -math.pi / 2, math.pi / (beams - 1), ranges, 0.05, 8.0)


class SyntheticVehicle:
    """A vehicle on a circle; its odometry drifts."""

    def __init__(self, world, start, speed=0.4, turn=0.25, seed=0):
        self.world = world
        self.start = self.pose = start
        self.odometry = Pose2(0.0, 0.0, 0.0)
        self.step = Pose2(speed * 0.1, 0.0, turn * 0.1)
        self.rng = np.random.default_rng(seed)
        self.stamp = 0.0
        self.moving = False

    def advance(self):
        """Drive for a tenth of a second; return the odometry reading, the first at the start."""
        if not self.moving:
            self.moving = True
            return OdometryReading(self.stamp, self.odometry)
        self.stamp = round(self.stamp + 0.1, 6)
        self.pose = self.pose.compose(self.step)
        noise = self.rng.normal(size=3) * (0.002, 0.0005, 0.006)
        self.odometry = self.odometry.compose(Pose2(*(np.asarray(self.step) + noise)))
        return OdometryReading(self.stamp, self.odometry)

    def landmarks(self):
        """Landmarks seen now."""
        return self.world.landmarks_from(self.stamp, self.pose)

    def scan(self, mount=None):
        """The scan taken now, from the laser's mount on the vehicle."""
        laser = self.pose.compose(mount or LaserMountConfig().pose)
        return self.world.scan_from(self.stamp, laser)

    def error_of(self, pose):
        """Distance (m) of an estimated pose from the true one."""
        return math.hypot(pose.x - self.pose.x, pose.y - self.pose.y)
