"""The central agent without ROS: filter, occupancy grid and planner for a team of vehicles."""

from explore_slam import exploration, mapping, registration, slam
from explore_slam.agent.agent import Agent
from explore_slam.agent.config import AgentConfig, explicit_mounts
from explore_slam.agent.loop_closing import Join
from explore_slam.agent.team import KeyframeEvent
from explore_slam.agent.team_planner import TeamPlanner
from explore_slam.slam import closures

__all__ = [
    'Agent',
    'AgentConfig',
    'Join',
    'KeyframeEvent',
    'TeamPlanner',
    'explicit_mounts',
    'warm_up',
]


def warm_up() -> None:
    """Compile all kernels that the agent runs, or load them from the cache."""
    for package in (registration, slam, closures, mapping, exploration):
        package.warm_up()
