import numpy as np
import pytest

from explore_slam.errors import SlamError
from explore_slam.geometry import between


@pytest.fixture
def world(make_world):
    made = make_world(4, landmarks=15)
    made.circle(10)
    made.graph.optimize()
    return made


def steps_of(draws, path):
    """Return samples as steps (M, 3 N) from the optimum."""
    steps = between(path[:, :, None].transpose(2, 0, 1), draws.poses.transpose(2, 0, 1))
    return steps.reshape(len(steps), -1)


def test_samples_have_the_joint_covariance_of_the_posterior(world):
    path = world.graph.path()
    draws = world.graph.draw(40_000, np.random.default_rng(0))
    steps = steps_of(draws, path)
    found = steps.T @ steps / len(steps)
    solution = world.graph.posterior(0)
    expected = np.zeros_like(found)
    for node in range(len(path)):
        column = solution.factorization.cross_covariances(np.arange(len(path)), node)
        expected[:, 3 * node : 3 * node + 3] = column.reshape(-1, 3)
    deviation = np.sqrt(np.outer(expected.diagonal(), expected.diagonal()))
    np.testing.assert_allclose(found / deviation, expected / deviation, atol=0.05)


def test_what_is_not_wanted_does_not_change_the_distribution(make_world):
    """Poses of some keyframes, and the ends of motions at others, are drawn jointly."""
    world = make_world(4, landmarks=15)
    world.circle(10)
    white = np.diag([0.02, 0.01, 0.01]) ** 2
    last = world.newest[0]
    world.graph.add_keyframe(0, last + 2, [0.3, 0.0, 0.1], white, white)
    world.graph.optimize()
    solution = world.graph.posterior(0)
    wanted, ends = np.array([2, 5, last + 2]), np.array([last, last + 2])
    draws = solution.draw(40_000, np.random.default_rng(0), wanted, ends)
    everything = solution.draw(40_000, np.random.default_rng(1))
    rows = np.searchsorted(everything.keyframes, wanted)
    end_rows = np.searchsorted(everything.keyframes, ends)
    found = np.concatenate([draws.poses, draws.chains]).reshape(15, -1)
    expected = np.concatenate([everything.poses[rows], everything.chains[end_rows]])
    found, expected = np.cov(found), np.cov(expected.reshape(15, -1))
    deviations = np.sqrt(expected.diagonal())
    np.testing.assert_allclose(
        found / np.outer(deviations, deviations),
        expected / np.outer(deviations, deviations),
        atol=0.05,
    )
    np.testing.assert_array_equal(draws.keyframes, wanted)
    np.testing.assert_array_equal(draws.ends, ends)
    with pytest.raises(SlamError, match='keyframe 999 is not in the graph'):
        solution.draw(2, np.random.default_rng(0), np.array([999]))


def test_samples_come_in_pairs_around_the_optimum(world):
    path = world.graph.path()
    steps = steps_of(world.graph.draw(7, np.random.default_rng(0)), path)
    np.testing.assert_allclose(steps[0:6:2], -steps[1:6:2], atol=1e-12)
    np.testing.assert_allclose(steps[6], 0.0, atol=1e-15)
    assert np.abs(steps[0]).max() > 1e-3


def test_same_seed_gives_the_same_bits(make_world):
    found = []
    for _ in range(2):
        world = make_world(4, landmarks=15)
        world.circle(10)
        world.graph.optimize()
        found.append(world.graph.draw(33, np.random.default_rng(5)).poses)
    np.testing.assert_array_equal(found[0], found[1])


def test_no_samples_are_refused(world):
    with pytest.raises(SlamError, match='samples are 0'):
        world.graph.draw(0, np.random.default_rng(0))
