"""Cost and accuracy of one RGB-D camera and of two on a vehicle, in a rendered world.

python benchmarks/two_cameras.py [--seconds S] [--seeds N ...]

The vehicle drives a circle. The cameras look 35° to its left and to its right; the runs with one
camera have the left one. Printed per seed: keyframes with landmarks, the agent's processor
time per keyframe and in all, and the error of the position.
"""

import argparse
import math
import time
from dataclasses import replace
from typing import Any

import numpy as np

from explore_slam.agent import Agent, AgentConfig, warm_up
from explore_slam.data import LaserScan, OdometryReading, RgbdFrame
from explore_slam.geometry import Pose2
from explore_slam.settings import with_values
from explore_slam.simulation import SimulationConfig, Simulator, load_world, world_path
from explore_slam.vision import CameraMount

VEHICLE, WORLD = 'robot1', 'office'
YAWS = {'left_camera': math.radians(35.0), 'right_camera': math.radians(-35.0)}
CIRCLE = (0.35, 0.4)  # m/s, rad/s
CAMERA_RATE = 5.0  # Hz


def record(seconds: float, yaw: float, seed: int) -> tuple[list[Any], list[tuple[float, Pose2]]]:
    """Return the records of a drive with the camera turned by a yaw (rad), and the true poses."""
    config = with_values(
        SimulationConfig(), {'camera_yaw': yaw, 'simulated_camera_rate': CAMERA_RATE}
    )
    mount = CameraMount.from_config(config.camera_mount).optical_pose
    world = load_world(world_path(WORLD))
    records: list[Any] = []
    truth = []
    with Simulator(world, {VEHICLE: world.starts[VEHICLE]}, config, seed) as simulator:
        simulator.set_velocity(VEHICLE, *CIRCLE)
        while simulator.time < seconds:
            for event in simulator.step():
                if isinstance(event.record, OdometryReading | LaserScan):
                    records.append(event.record)
                elif isinstance(event.record, RgbdFrame):
                    records.append(replace(event.record, mount=mount))
            truth.append((simulator.time, simulator.true_pose(VEHICLE)))
    return records, truth


def run(records: list[Any], truth: list[tuple[float, Pose2]], seed: int) -> str:
    """Feed an agent; return its figures."""
    agent = Agent(AgentConfig(), {VEHICLE: truth[0][1]}, seed)
    began = time.process_time()
    for item in sorted(records, key=lambda item: item.stamp):
        agent.add(VEHICLE, item)
    spent = time.process_time() - began
    keyframes = sum(event.update is not None for event in agent.take_events())
    stamps, poses = agent.trajectory(VEHICLE)
    at = np.array([stamp for stamp, _ in truth])
    true = np.array([pose[:2] for _, pose in truth])
    exact = np.stack([np.interp(stamps, at, true[:, k]) for k in (0, 1)], axis=1)
    error = math.sqrt(float(((poses[:, :2] - exact) ** 2).sum(axis=1).mean()))
    return (
        f'{keyframes} keyframes, {1e3 * spent / max(keyframes, 1):.0f} ms per keyframe, '
        f'{spent:.1f} s in all, {error:.3f} m RMS'
    )


def main() -> None:
    """Parse the command line and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--seconds', type=float, default=30.0)
    parser.add_argument('--seeds', type=int, nargs='+', default=[0, 1, 2, 3, 4])
    arguments = parser.parse_args()
    warm_up()
    for seed in arguments.seeds:
        drives = {name: record(arguments.seconds, yaw, seed) for name, yaw in YAWS.items()}
        left, truth = drives['left_camera']
        if seed == arguments.seeds[0]:
            run(left, truth, seed)  # what is slow at its first use
        print(f'seed {seed}, one camera: {run(left, truth, seed)}', flush=True)
        both = [item for item in left if not isinstance(item, RgbdFrame)]
        for name, (records, _) in drives.items():
            both += [replace(item, sensor=name) for item in records if isinstance(item, RgbdFrame)]
        print(f'seed {seed}, two cameras: {run(both, truth, seed)}', flush=True)


if __name__ == '__main__':
    main()
