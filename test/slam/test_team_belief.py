import numpy as np
import pytest

from explore_slam.data import InterRobotObservation
from explore_slam.errors import SlamError
from explore_slam.geometry import Pose2
from explore_slam.settings import with_values
from explore_slam.slam import FastSlamConfig, TeamBelief

STARTS = {'a': Pose2(1.0, 1.0, 0.0), 'b': Pose2(1.5, 1.5, 0.0)}


def make(maps, **values):
    settings = {'particles': 100, 'maximum_descriptor_distance': 0.0, 'maps': maps} | values
    return with_values(FastSlamConfig(), settings)


def test_common_map_is_one_filter(make_world, drive_circles):
    results = []
    for maps in ('common', 'dedicated'):
        world = make_world()
        belief = TeamBelief(world.start(**STARTS), make(maps), seed=1)
        drive_circles(belief, world, 10)
        results.append(belief)
    common, dedicated = results
    assert len(common.filters) == 1
    assert len(dedicated.filters) == 2
    # the same places, mapped once or twice
    assert len(dedicated.landmarks()) > 1.3 * len(common.landmarks())
    assert len(np.unique(dedicated.landmarks().ids)) == len(dedicated.landmarks())
    assert set(dedicated.landmarks().owners) == {0, 1}


@pytest.mark.parametrize('maps', ['common', 'dedicated'])
def test_keyframes_are_numbered_over_all_vehicles(make_world, maps):
    belief = TeamBelief(make_world().start(**STARTS), make(maps))
    assert [belief.add_keyframe(name, 0.0) for name in 'abba'] == [0, 1, 2, 3]
    np.testing.assert_allclose(
        belief.best_path(), [STARTS['a'], STARTS['b'], STARTS['b'], STARTS['a']]
    )
    assert belief.trajectory('b')[1].shape == (2, 3)
    assert belief.particle_poses('a').shape == (100, 3)
    assert belief.effective_particles() == pytest.approx(100)


def test_the_dedicated_filter_of_a_vehicle_equals_a_filter_of_its_own(make_world, drive_circles):
    paths = []
    for names in (('a', 'b'), ('a',)):
        world = make_world()
        world.start(**STARTS)
        belief = TeamBelief({name: STARTS[name] for name in names}, make('dedicated'), seed=4)
        for step in range(8):
            world.random = np.random.default_rng(step)
            drive_circles(belief.filter_of('a'), world, 1, step)
        paths.append(belief.filter_of('a').best_path())
    np.testing.assert_array_equal(*paths)


def test_an_inter_robot_observation_ties_two_vehicles_together():
    errors = {}
    for used in (False, True):
        belief = TeamBelief(
            STARTS, make('common', particles=400, inter_robot_observations=used), seed=2
        )
        belief.predict('b', Pose2(1.0, 0.0, 0.0), np.diag([0.3, 0.3, 0.2]) ** 2)
        z = np.array([1.7, 0.3])
        belief.update_inter_robot('a', [InterRobotObservation(1.0, 'b', z, 0.02**2 * np.eye(2))])
        pose, covariance = belief.estimate('b')
        errors[used] = np.hypot(pose.x - 2.7, pose.y - 1.3), np.sqrt(covariance[0, 0])
    assert errors[True][0] < 0.02 < errors[False][0]
    assert errors[True][1] == pytest.approx(0.02, rel=0.3)
    assert errors[False][1] == pytest.approx(0.3, rel=0.1)


def test_an_inter_robot_observation_moves_the_observer_too():
    belief = TeamBelief(STARTS, make('common', particles=2000), seed=2)
    P = np.diag([0.2, 0.2, 0.1]) ** 2
    belief.predict('a', Pose2(0.0, 0.0, 0.0), P)
    z = np.array([0.5 + 0.1, 0.5])
    belief.update_inter_robot('a', [InterRobotObservation(1.0, 'b', z, 0.05**2 * np.eye(2))])
    pose, covariance = belief.estimate('a')
    H = np.array([[-1.0, 0.0, 0.5], [0.0, -1.0, -0.5]])
    S = H @ P @ H.T + 0.05**2 * np.eye(2)
    gain = P @ H.T @ np.linalg.inv(S)
    np.testing.assert_allclose(np.asarray(pose), STARTS['a'] + gain @ [0.1, 0.0], atol=0.01)
    np.testing.assert_allclose(covariance, P - gain @ H @ P, atol=0.002)


def test_an_inter_robot_observation_beyond_the_gate_is_ignored():
    belief = TeamBelief(STARTS, make('common'), seed=2)
    belief.predict('b', Pose2(1.0, 0.0, 0.0), np.diag([0.01, 0.01, 0.01]) ** 2)
    before = belief.estimate('b')[0]
    observation = InterRobotObservation(1.0, 'b', np.array([-3.0, 2.0]), 0.02**2 * np.eye(2))
    belief.update_inter_robot('a', [observation])
    assert belief.estimate('b')[0] == pytest.approx(before, abs=1e-9)


def test_inter_robot_observations_are_checked():
    belief = TeamBelief(STARTS, make('common'))
    z = np.array([0.5, 0.5])
    with pytest.raises(SlamError, match="no vehicle 'x'"):
        belief.update_inter_robot('a', [InterRobotObservation(0.0, 'x', z, np.eye(2))])
    with pytest.raises(SlamError, match='cannot observe itself'):
        belief.update_inter_robot('a', [InterRobotObservation(0.0, 'a', z, np.eye(2))])
    with pytest.raises(SlamError, match='positive definite'):
        belief.update_inter_robot('a', [InterRobotObservation(0.0, 'b', z, np.zeros((2, 2)))])
    with pytest.raises(SlamError, match='maps: common'):
        TeamBelief(STARTS, make('dedicated')).update_inter_robot('a', [])
    with pytest.raises(SlamError, match="no vehicle 'z'"):
        belief.predict('z', Pose2(0.0, 0.0, 0.0))
