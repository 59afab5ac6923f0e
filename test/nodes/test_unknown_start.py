"""A vehicle of unknown start in the agent node: it has no pose until it has joined the map."""

import math

import rclpy
from nodes.test_agent_node import STARTS, Team, log_of, start_agent
from ros_domain import own_domain

from explore_slam import messages

DOMAIN = own_domain(98)


def test_a_vehicle_of_unknown_start_is_published_when_it_has_joined(tmp_path):
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=DOMAIN)
    team = Team(context)
    known = [float(value) for value in STARTS['robot1']]
    settings = {'start_poses': [*known, math.nan, math.nan, math.nan], 'relocalization_matches': 8}
    state = 'agent: vehicle robot2'
    with start_agent(tmp_path, settings, DOMAIN):
        team.wait_for(lambda: 'explore/status' in team.heard, 90.0)
        team.wait_for(lambda: all(out.get_subscription_count() for out in team.out.values()))
        team.drive(8)
        team.wait_for(lambda: team.is_heard_to_the_end('robot1'))
        team.wait_for(lambda: team.parts.get(state, {}).get('state') == 'unlocalized', 60.0)
        assert 'robot2/pose' not in team.heard
        assert 'x' not in team.parts[state]
        team.drive_until(lambda: 'robot2/pose' in team.heard, 90.0)
        team.wait_for(lambda: team.is_heard_to_the_end('robot2'), 60.0)
        pose = messages.planar_pose(team.heard['robot2/pose'].pose.pose)
        assert team.vehicles['robot2'].error_of(pose) < 0.2
        assert 'robot2 joined the map' in log_of(tmp_path)
    team.node.destroy_node()
    rclpy.shutdown(context=context)
