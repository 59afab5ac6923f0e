"""CARMEN logs of a robot in a square room, raw or corrected, for tests."""

import math

import numpy as np
from synthetic import SyntheticWorld

from explore_slam.geometry import Pose2

SPEED, TURN = 0.02, math.radians(0.6)  # m, rad: mean motion between two odometry lines
SLIP = 1.02  # wheel odometry turns this much more than the robot
PERIOD = 0.1  # s between two odometry lines
SCAN_EVERY = 5  # odometry lines
FRONT = Pose2(0.1, 0.0, 0.0)


def words(*values):
    return ' '.join(f'{value:.6g}' if isinstance(value, float) else str(value) for value in values)


def odometry_line(pose, stamp, logged=None):
    return words('ODOM', *pose, 0.2, 0.0, 0.0, stamp, 'host', stamp if logged is None else logged)


def laser_line(ranges, laser, robot, stamp, kind='FLASER'):
    readings = [round(float(value), 3) for value in ranges]
    return words(kind, len(readings), *readings, *laser, *robot, stamp, 'host', stamp)


def robot_laser_line(ranges, laser, robot, stamp, start=-1.5707963, step=0.0174533, top=30.0):
    readings = [round(float(value), 3) for value in ranges]
    return words(
        'ROBOTLASER1', 0, start, math.pi, step, top, 0.01, 0, len(readings), *readings,
        2, 0.1, 0.2, *laser, *robot, 0.2, 0.0, 0.0, 0.0, 0.0, stamp, 'host', stamp,
    )  # fmt: skip


class Drive:
    """A drive around a room: true poses, wheel odometry and scans at each step."""

    def __init__(self, steps=100, mount=FRONT, beams=180):
        world = SyntheticWorld()
        start = Pose2(0.0, -1.6, 0.0)
        self.mount = mount
        self.stamps = [round(10.0 + PERIOD * index, 6) for index in range(steps)]
        self.truth, self.odometry = [start], [start]
        for index in range(steps - 1):
            # an uneven drive: it tells at which time the robot was where
            x = SPEED * (1.0 + 0.6 * math.sin(index / 17.0))
            theta = TURN * (1.0 + 0.6 * math.sin(index / 7.0))
            self.truth.append(self.truth[-1].compose(Pose2(x, 0.0, theta)))
            slipped = Pose2(x, 0.0, SLIP * theta)
            self.odometry.append(self.odometry[-1].compose(slipped))
        # 180 beams one degree apart: the first of 181
        self.scans = {
            index: world.scan_from(stamp, self.truth[index].compose(mount)).ranges[:beams]
            for index, stamp in enumerate(self.stamps)
            if index % SCAN_EVERY == 0 and index
        }

    def raw(self, kind='FLASER'):
        """Lines of a raw log: laser and robot poses by wheel odometry."""
        lines = ['# a comment', f'PARAM robot_frontlaser_offset {self.mount.x} nohost 0']
        for index, stamp in enumerate(self.stamps):
            robot = self.odometry[index]
            lines.append(odometry_line(robot, stamp))
            if index in self.scans:
                laser = robot.compose(self.mount)
                make = robot_laser_line if kind == 'ROBOTLASER1' else laser_line
                line = make(self.scans[index], laser, robot, stamp)
                lines.append(line.replace('FLASER', kind) if kind == 'RLASER' else line)
        return lines

    def corrected(self, marked=True):
        """Lines as GMapping writes them: odometry restarts at the corrected pose of each scan.

        marked: with the NEFF lines that it leaves.
        """
        lines = []
        pose = self.odometry[0]
        for index, stamp in enumerate(self.stamps):
            if index:
                pose = pose.compose(self.odometry[index - 1].between(self.odometry[index]))
            lines.append(odometry_line(pose, stamp))
            if index in self.scans:
                pose = self.truth[index].compose(self.mount)
                lines.append(laser_line(self.scans[index], pose, pose, stamp))
                lines.append(odometry_line(pose, 0.0))
                if marked:
                    lines.append('NEFF 28.5')
        return lines


def write_log(path, lines):
    path.write_text('\n'.join(lines) + '\n')
    return path


def errors(poses, expected):
    """Largest difference in position (m) and heading (rad) of poses (N, 3)."""
    difference = np.asarray(poses) - np.asarray(expected)
    heading = (difference[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
    return float(np.hypot(difference[:, 0], difference[:, 1]).max()), float(np.abs(heading).max())
