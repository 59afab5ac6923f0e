"""Path following in the rendered simulator: cross-track error, distance kept to obstacles.

    python benchmarks/vehicle_following.py --seeds 5

Poses arrive as from the agent: at 2 Hz, 0.15 s late, with noise of 1 cm and 0.5°. Odometry and
scans have the noise of the simulator. Errors are those of the true pose.
"""

import argparse
import itertools
import math
import sys
import tempfile
from pathlib import Path

import numpy as np

from explore_slam.data import LaserScan, OdometryReading, Plan
from explore_slam.geometry import Pose2
from explore_slam.settings import with_values
from explore_slam.simulation import SimulationConfig, Simulator, TruePose
from explore_slam.vehicle import FollowerState, PathFollower, PathFollowerConfig

HALL = """
name: hall
size: [16.0, 8.0]
starts: {robot1: [2.0, 4.0, 0.0]}
"""
BOX = 'furniture: [{kind: crate, at: [8.0, 4.1], size: [0.6, 0.6, 0.6]}]\n'
POSE_LATENCY = 0.15  # s
ODOMETRY_LATENCY = 0.06  # s, of a line with 9600 Bd
SCAN_LATENCY = 0.2  # s, of a line with 38400 Bd


class Run:
    """One vehicle in the simulator; its follower receives everything with latency."""

    def __init__(self, path: np.ndarray, seed: int, world: str) -> None:
        rates = {
            'simulated_camera_rate': 0.0,
            'simulated_scan_rate': 5.0,
            'simulated_odometry_rate': 10.0,
        }
        config = with_values(SimulationConfig(), rates)
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / 'hall.yaml'
            file.write_text(world)
            self.simulator = Simulator(file, None, config, seed)
        self.follower = PathFollower(PathFollowerConfig())
        self.follower.set_plan(Plan(0.0, 'robot1', Pose2(*path[-1], 0.0), path))
        self.truth: list[tuple[float, ...]] = []
        self.speeds: list[float] = []
        self._generator = np.random.default_rng(seed)
        self._late: list[tuple[float, str, object]] = []
        self._due = {'pose': 0.0, 'command': 0.0}

    def _sense(self) -> None:
        for event in self.simulator.step():
            record, now = event.record, self.simulator.time
            if isinstance(record, OdometryReading):
                self._late.append((now + ODOMETRY_LATENCY, 'odometry', record))
            elif isinstance(record, LaserScan):
                self._late.append((now + SCAN_LATENCY, 'scan', record))
            elif isinstance(record, TruePose):
                self.truth.append((now, *record.pose))
        if self._is_due('pose', 0.5):
            noise = self._generator.normal(0.0, [0.01, 0.01, math.radians(0.5)])
            pose = self.simulator.true_pose('robot1').compose(Pose2(*noise))
            now = self.simulator.time
            self._late.append((now + POSE_LATENCY, 'pose', (now, pose)))

    def _is_due(self, what: str, period: float) -> bool:
        if self.simulator.time < self._due[what]:
            return False
        self._due[what] = self.simulator.time + period
        return True

    def _deliver(self) -> None:
        now = self.simulator.time
        ready = sorted((item for item in self._late if item[0] <= now), key=lambda item: item[0])
        for item in ready:
            self._late.remove(item)
            _, kind, record = item
            if kind == 'odometry':
                self.follower.set_odometry(record, now)
            elif kind == 'scan':
                self.follower.set_scan(record, now)
            else:
                self.follower.set_pose(*record, now)

    def drive(self, limit: float) -> tuple[np.ndarray, str, float]:
        """Return true poses (T, 4: t x y heading), last state and median speed of the follower."""
        command = None
        with self.simulator:
            while self.simulator.time < limit:
                self._sense()
                self._deliver()
                if not self._is_due('command', 0.05):
                    continue
                command = self.follower.command(self.simulator.time)
                self.simulator.set_velocity('robot1', command.linear, command.angular)
                if command.state is FollowerState.DRIVING:
                    self.speeds.append(self.simulator.velocity('robot1')[0])
                if command.state in (FollowerState.ARRIVED, FollowerState.BLOCKED):
                    break
            for _ in range(50):  # until standstill
                self._sense()
        state = f'{command.state.value}: {command.reason}'
        return np.array(self.truth), state, float(np.median(self.speeds))


def cross_track(truth: np.ndarray, path: np.ndarray) -> np.ndarray:
    """Return the cross-track errors (T,) m of true poses."""
    dense = np.concatenate(
        [np.linspace(a, b, 20, endpoint=False) for a, b in itertools.pairwise(path)]
    )
    return np.min(np.linalg.norm(truth[:, None, 1:3] - dense[None], axis=2), axis=1)


def main() -> int:
    """Run the measurement and print it."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n', maxsplit=1)[0])
    parser.add_argument('--seeds', type=int, default=5)
    arguments = parser.parse_args()
    x = np.arange(2.0, 14.01, 0.1)
    slalom = np.column_stack([x, 4.0 + 0.5 * np.sin(2.0 * np.pi * (x - 2.0) / 4.0)])
    line = np.array([[2.0, 4.0], [14.0, 4.0]])
    errors, distances = [], []
    for seed in range(arguments.seeds):
        truth, state, speed = Run(slalom, seed, HALL).drive(80.0)
        rms = float(np.sqrt(np.mean(cross_track(truth, slalom) ** 2)))
        worst = float(cross_track(truth, slalom).max())
        errors.append(rms)
        print(
            f'seed {seed}: slalom RMS {rms:.3f} m, largest {worst:.3f} m, {speed:.2f} m/s, {state}'
        )
        truth, state, _ = Run(line, seed, HALL + BOX).drive(60.0)
        distance = 8.0 - 0.3 - truth[:, 1].max() - 0.25
        distances.append(distance)
        print(f'seed {seed}: stopped {distance:.3f} m before the box; {state}')
    print(f'cross-track RMS: largest {max(errors):.3f} m (required 0.05 m)')
    print(f'distance to an obstacle: smallest {min(distances):.3f} m (required 0.15 m)')
    return 0


if __name__ == '__main__':
    sys.exit(main())
