"""Inter-robot observations: both vehicles get a keyframe, and the filter is updated."""

import math

import numpy as np
import pytest

from explore_slam.agent import Agent, AgentConfig
from explore_slam.data import InterRobotObservation, OdometryReading
from explore_slam.errors import AgentError
from explore_slam.geometry import Pose2
from explore_slam.settings import with_values

STARTS = {'robot1': Pose2(0.0, 0.0, 0.0), 'robot2': Pose2(2.0, 0.0, math.pi)}


def make_agent(**values):
    config = with_values(AgentConfig(), {'particles': 200, 'scan_matching': False, **values})
    agent = Agent(config, STARTS, 1)
    for tick in range(11):
        for name in STARTS:
            agent.add(name, OdometryReading(0.1 * tick, Pose2(0.1 * tick, 0.0, 0.0)))
    agent.take_events()
    return agent


def observation(stamp, vehicle='robot2', distance=0.1):
    return InterRobotObservation(stamp, vehicle, np.array([distance, 0.0]), 1e-4 * np.eye(2))


def test_both_vehicles_get_a_keyframe_at_the_stamp():
    agent = make_agent()
    agent.add('robot1', observation(0.95))
    events = agent.take_events()
    assert [(event.vehicle, event.stamp) for event in events] == [
        ('robot1', 0.95),
        ('robot2', 0.95),
    ]
    np.testing.assert_allclose(events[0].pose, (0.95, 0.0, 0.0), atol=0.02)
    np.testing.assert_allclose(events[1].pose[:2], (1.05, 0.0), atol=0.02)


def test_the_distance_of_the_vehicles_becomes_that_of_the_observation():
    agent = make_agent()

    def distance():
        one, other = (agent.belief.estimate(name)[0] for name in STARTS)
        return math.dist(one[:2], other[:2])

    agent.add('robot1', observation(0.5, distance=0.95))
    assert distance() == pytest.approx(0.95, abs=0.02)


def test_an_observed_vehicle_whose_odometry_is_behind_is_not_matched():
    agent = make_agent()
    agent.add('robot1', OdometryReading(2.0, Pose2(1.2, 0.0, 0.0)))
    agent.add('robot1', observation(1.5))
    assert agent.summary()['robot1']['unmatched_inter_robot_observations'] == 1
    assert agent.take_events() == []


def test_an_observation_before_a_keyframe_is_late():
    agent = make_agent()
    agent.add('robot1', observation(0.9))
    agent.take_events()
    agent.add('robot1', observation(0.8))
    agent.add('robot2', observation(0.8, 'robot1'))
    assert agent.take_events() == []
    assert agent.summary()['robot1']['late_observations'] == 1


def test_an_observation_before_the_keyframe_of_the_other_is_not_matched():
    agent = make_agent()
    agent.belief.predict('robot2', Pose2(0.1, 0.0, 0.0), 1e-4 * np.eye(3))
    agent._team.add_keyframe(agent.track('robot2'), 0.9)
    agent.take_events()
    agent.add('robot1', observation(0.8))
    assert agent.take_events() == []
    assert agent.summary()['robot1']['unmatched_inter_robot_observations'] == 1
    assert agent.summary()['robot2']['late_observations'] == 1


@pytest.mark.parametrize('values', [{'maps': 'dedicated'}, {'inter_robot_observations': False}])
def test_observations_are_counted_as_unused_where_the_filter_does_not_use_them(values):
    agent = make_agent(**values)
    agent.add('robot1', observation(0.9))
    assert agent.summary()['robot1']['unused_inter_robot_observations'] == 1
    assert agent.take_events() == []


def test_unknown_vehicles_are_named_and_nothing_is_queued():
    agent = make_agent()
    with pytest.raises(AgentError, match="unknown vehicle 'robot9'"):
        agent.add('robot1', observation(5.0, 'robot9'))
    assert len(agent.track('robot1').waiting) == 0
