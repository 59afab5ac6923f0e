"""Run a recorded bag through the agent, offline: the same code as on the robots.

python examples/replay_bag.py BAG [--seed N]
e.g. after `explore_slam demo --record`: python examples/replay_bag.py runs/latest/bag

`explore_slam replay BAG` does the same and also writes a run folder with map and report.
"""

import argparse
import math
from pathlib import Path

from explore_slam.agent import Agent, AgentConfig
from explore_slam.recording import BagReader, Replay


def main() -> None:
    """Replay and print where each vehicle ended."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('bag', type=Path, help='rosbag2 folder, or its .mcap or .db3 file')
    parser.add_argument('--seed', type=int, default=0)
    arguments = parser.parse_args()

    with BagReader(arguments.bag) as bag:
        replay = Replay(bag)
        agent = Agent(AgentConfig(), replay.start_poses(), arguments.seed)
        tally = replay.feed(agent)

    for topic, count in sorted(tally.fed.items()):
        print(f'{count:6d} messages of {topic}')
    for vehicle in agent.vehicles:
        pose, covariance = agent.estimate(vehicle)
        deviation = math.sqrt(covariance[0, 0] + covariance[1, 1])
        stamps, _ = agent.trajectory(vehicle)
        print(
            f'{vehicle}: {len(stamps)} keyframes, ended at ({pose.x:.2f}, {pose.y:.2f}, '
            f'{math.degrees(pose.theta):.0f} deg), standard deviation {deviation:.3f} m'
        )
    print(f'map of {agent.grid.known().sum() * agent.grid.resolution**2:.1f} m²')


if __name__ == '__main__':
    main()
