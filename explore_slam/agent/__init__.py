"""The central agent without ROS: filter, occupancy grid and planner for a team of vehicles."""

from explore_slam import exploration, mapping, slam
from explore_slam.agent.agent import Agent
from explore_slam.agent.config import AgentConfig
from explore_slam.agent.team import KeyframeEvent
from explore_slam.agent.team_planner import TeamPlanner

__all__ = ['Agent', 'AgentConfig', 'KeyframeEvent', 'TeamPlanner', 'warm_up']


def warm_up() -> None:
    """Compile all kernels that the agent runs, or load them from the cache."""
    for package in (slam, mapping, exploration):
        package.warm_up()
