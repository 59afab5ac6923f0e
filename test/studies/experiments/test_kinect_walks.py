"""Recorded paths of the simulated Kinect, and scenarios with odometry noise."""

import numpy as np
import pytest

from explore_slam.data import LandmarkObservations
from explore_slam.errors import EvaluationError
from explore_slam.geometry import Pose2
from explore_slam.simulation import world_path
from explore_slam.studies.experiments.kinect_walks import (
    RecordedStop,
    Walk,
    record_walk,
    scenario_of,
)
from explore_slam.studies.experiments.scenarios import dead_reckoning

START = Pose2(1.0, 2.0, 0.5)


def test_walk_of_the_simulated_kinect(small_walks):
    walk = small_walks[0]
    assert [round(stop.pose.x, 1) for stop in walk.stops] == [0.8, 1.3, 1.8]
    for stop in walk.stops:
        assert len(stop.observations) > 20
        assert np.isfinite(stop.observations.positions).all()
    # the same wall is seen from all stops: true points agree
    first, second = walk.stops[0], walk.stops[1]
    distance = 2.0 - 2.0 * first.observations.descriptors @ second.observations.descriptors.T
    rows, columns = np.nonzero(distance < 0.05)
    shift = first.observations.positions[rows, 0] - second.observations.positions[columns, 0]
    assert np.median(shift) == pytest.approx(0.5, abs=0.05)


def test_walk_that_runs_into_a_wall_is_refused():
    with pytest.raises(EvaluationError, match='robot1'):
        record_walk(world_path('small'), 'robot1', [(0.8, 2.0), (0.8, -0.5)], 0.5)


def test_walks_become_a_scenario_with_drawn_odometry(small_walks):
    scenario = scenario_of(small_walks, seed=1)
    assert [step.vehicle for step in scenario.steps] == ['robot1', 'robot2'] * 3
    np.testing.assert_array_equal(
        scenario.true_path('robot1')[1:], np.array([s.pose for s in small_walks[0].stops])
    )
    drift = dead_reckoning(scenario, 'robot1')[1:] - scenario.true_path('robot1')[1:]
    assert np.abs(drift[0]).max() < 1e-12
    assert 1e-4 < np.abs(drift[-1]).max() < 0.3
    again, other = scenario_of(small_walks, seed=1), scenario_of(small_walks, seed=2)
    assert again.steps[-1].increment == scenario.steps[-1].increment
    assert other.steps[-1].increment != scenario.steps[-1].increment


def test_walks_of_unequal_length_end_one_after_the_other():
    stop = RecordedStop(START, LandmarkObservations.empty(0.0), 0.0)
    walks = [Walk('a', [stop] * 2), Walk('b', [stop] * 4)]
    assert [s.vehicle for s in scenario_of(walks, 0).steps] == ['a', 'b', 'a', 'b', 'b', 'b']
