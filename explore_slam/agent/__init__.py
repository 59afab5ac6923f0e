"""The central agent without ROS: belief, grid and planner for a team of vehicles."""

from explore_slam.agent.agent import Agent, KeyframeEvent
from explore_slam.agent.config import AgentConfig
from explore_slam.agent.team_planner import TeamPlanner

__all__ = ['Agent', 'AgentConfig', 'KeyframeEvent', 'TeamPlanner']
