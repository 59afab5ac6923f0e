"""The central agent without ROS: belief, grid and planner for a team of vehicles."""

from explore_slam.agent.agent import Agent, KeyframeEvent
from explore_slam.agent.config import AgentConfig
from explore_slam.agent.team_planner import TeamPlanner

__all__ = ['Agent', 'AgentConfig', 'KeyframeEvent', 'TeamPlanner', 'warm_up']


def warm_up() -> None:
    """Compile all kernels that the agent runs on, or read them from the cache."""
    from explore_slam import exploration, mapping, slam

    for room in (slam, mapping, exploration):
        room.warm_up()
