"""Drive a simulated vehicle along a path with the path follower, in simulated time.

python examples/drive_path.py

The follower steers by wheel odometry and stops for obstacles that the laser sees. On a robot,
`Lms200` and `PioneerRobot` of explore_slam.vehicle take the place of the simulator.
"""

import math
from pathlib import Path

import numpy as np

from explore_slam.data import LaserScan, OdometryReading, Plan
from explore_slam.geometry import Pose2
from explore_slam.settings import with_values
from explore_slam.simulation import SimulationConfig, Simulator
from explore_slam.vehicle import FollowerState, PathFollower

WORLD = Path(__file__).resolve().parents[1] / 'config' / 'worlds' / 'small.yaml'
START = Pose2(0.8, 2.0, 0.0)
WAYPOINTS = np.array([[0.8, 2.0], [2.2, 2.5], [4.2, 2.5], [4.8, 3.5]])  # m, through the door
TIME_LIMIT = 60.0  # s


def main() -> None:
    """Drive to the end of the path and print how it went."""
    config = with_values(SimulationConfig(), {'simulated_camera_rate': 0.0})  # nothing to render
    follower = PathFollower()
    follower.set_plan(Plan(0.0, 'robot1', Pose2(*WAYPOINTS[-1].tolist(), 0.0), WAYPOINTS))
    with Simulator(WORLD, {'robot1': START}, config) as simulator:
        state, next_report = FollowerState.WAITING, 0.0
        while state is not FollowerState.ARRIVED and simulator.time < TIME_LIMIT:
            for event in simulator.step():
                if isinstance(event.record, LaserScan):
                    follower.set_scan(event.record)
                elif isinstance(event.record, OdometryReading):
                    follower.set_odometry(event.record)
                    # no SLAM here: the pose is that of wheel odometry from the start pose on
                    follower.set_pose(event.stamp, START.compose(event.record.pose))
            command = follower.command(simulator.time)
            simulator.set_velocity('robot1', command.linear, command.angular)
            state = command.state
            if simulator.time >= next_report:
                next_report += 2.0
                pose = simulator.true_pose('robot1')
                print(
                    f'{simulator.time:5.1f} s at ({pose.x:.2f}, {pose.y:.2f}) '
                    f'{command.linear:.2f} m/s {state.value}'
                )
        distance = math.dist(simulator.true_pose('robot1')[:2], WAYPOINTS[-1])
        print(
            f'{state.value} after {simulator.time:.1f} s, {distance:.2f} m from the goal, '
            f'{simulator.collisions["robot1"]} collisions'
        )


if __name__ == '__main__':
    main()
