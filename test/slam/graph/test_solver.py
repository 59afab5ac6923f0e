import numpy as np
import pytest

from explore_slam.geometry import between

CLOSURE = np.diag([0.05, 0.04, 0.02]) ** 2


@pytest.mark.parametrize('seed', [0, 1, 2])
def test_optimum_and_marginals_are_those_of_gtsam(make_world, oracle_of, seed):
    world = make_world(seed, landmarks=12)
    world.start(0, [0.0, 0.0, 0.3], np.diag([0.1, 0.2, 0.05]) ** 2)
    world.start(1, [1.0, -1.0, 2.0])
    for step in range(15):
        a = world.drive(0, np.array([0.4, 0.05, 0.3]))
        world.see(a, 0.5)
        b = world.drive(1, np.array([0.5, 0.0, -0.2]))
        world.see(b, 0.5)
        if step % 4 == 1:
            world.meet(a, b, np.array([[0.02, 0.005], [0.005, 0.01]]))
    world.close(2, world.newest[0], CLOSURE)
    world.close(3, world.newest[1], CLOSURE)
    oracle = oracle_of(world)
    summary = world.graph.optimize()
    assert summary.converged
    assert summary.cost == pytest.approx(oracle.cost, rel=1e-6)
    np.testing.assert_allclose(between(oracle.path(), world.graph.path()), 0.0, atol=1e-6)
    for number, position in zip(*world.graph.landmarks(), strict=True):
        np.testing.assert_allclose(position, oracle.landmark(int(number)), atol=1e-6)
    for keyframe in (0, 5, world.newest[0], world.newest[1]):
        expected = oracle.covariance(keyframe)
        scale = np.abs(expected).max()
        found = world.graph.covariance(keyframe)
        np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-6 * scale)
    others = np.array([3, 10, 20, world.newest[1]])
    found = world.graph.relative_covariance(6, others)
    for b, covariance in zip(others.tolist(), found, strict=True):
        expected = oracle.relative_covariance(6, b)
        np.testing.assert_allclose(covariance, expected, rtol=1e-4, atol=1e-8)
