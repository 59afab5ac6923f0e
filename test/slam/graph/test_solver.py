from dataclasses import replace

import numpy as np
import pytest

from explore_slam.errors import SlamError
from explore_slam.geometry import between
from explore_slam.slam.graph import JointGraph
from explore_slam.slam.graph.solver import Factorization, posterior_at

CLOSURE = np.diag([0.05, 0.04, 0.02]) ** 2
# of the largest variance: the information matrix is that of a small step before the optimum
LINEARIZED = 3e-3


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
        np.testing.assert_allclose(found, expected, rtol=1e-4, atol=LINEARIZED * scale)
    others = np.array([3, 10, 20, world.newest[1]])
    found = world.graph.relative_covariance(6, others)
    for b, covariance in zip(others.tolist(), found, strict=True):
        expected = oracle.relative_covariance(6, b)
        scale = np.abs(expected).max()
        np.testing.assert_allclose(covariance, expected, rtol=1e-4, atol=LINEARIZED * scale)


@pytest.mark.parametrize('deviation', [1e-4, 1e-3, 1e-2])
def test_near_optimum_is_reached_with_one_factorization(make_world, monkeypatch, deviation):
    """Beside the optimum, the same optimum is found with the factor of the first step."""
    world = make_world(3, landmarks=20)
    world.circle(10)
    world.graph.optimize()
    problem = world.graph.snapshot(0)
    noise = deviation * np.random.default_rng(0).uniform(-1.0, 1.0, problem.start.shape)
    factorized = []
    factorize = Factorization.factorize
    monkeypatch.setattr(
        Factorization,
        'factorize',
        lambda system, damping=0.0: factorized.append(damping) or factorize(system, damping),
    )
    found = world.graph.solve(problem._replace(start=problem.start + noise))
    assert factorized == [0.0]
    assert found.summary.converged
    np.testing.assert_allclose(found.nodes, problem.start, atol=1e-7)


@pytest.mark.parametrize('seed', range(5))
def test_no_start_makes_the_cost_rise(make_world, seed):
    """From a start far off, the steps are damped; the optimum is found or the cost has fallen."""
    world = make_world(seed, landmarks=20)
    world.circle(10)
    world.graph.optimize()
    best = world.graph.solve(world.graph.snapshot(0))
    random = np.random.default_rng(seed)
    problem = best.problem
    for deviation in (0.01, 0.1, 1.0):
        noise = deviation * random.standard_normal(problem.start.shape)
        found = world.graph.solve(problem._replace(start=problem.start + noise))
        assert found.summary.cost < found.summary.cost_before
        assert found.summary.cost >= best.summary.cost * (1.0 - 1e-9)
        if deviation < 1.0:
            np.testing.assert_allclose(found.nodes, best.nodes, atol=1e-5)


def test_few_iterations_say_that_they_were_too_few(make_world):
    world = make_world(0, landmarks=20)
    world.graph = JointGraph(replace(world.config, graph_iterations=1))
    world.circle(10)
    summary = world.graph.optimize()
    assert (summary.iterations, summary.converged) == (1, False)
    while not world.graph.optimize().converged:
        pass
    assert world.graph.optimize().cost < summary.cost


def test_node_without_measurements_is_reported(make_world):
    world = make_world(1, landmarks=20)
    world.circle(5)
    problem = world.graph.snapshot(0)
    lonely = problem._replace(start=np.vstack([problem.start, np.zeros(3)]))
    with pytest.raises(SlamError, match=r'vehicles \(0, 1\) has no definite information matrix'):
        posterior_at(lonely)
    with pytest.raises(SlamError, match='no definite information matrix'):
        world.graph.solve(lonely)


def test_measurements_as_exact_as_allowed_do_no_harm(make_world):
    """Motions that are exactly known and a closure of 1 µm, beside observations of centimetres."""
    world = make_world(1, landmarks=20)
    world.start(0, [0.0, 0.0, 0.0])
    for _ in range(12):
        keyframe = world.drive(0, np.array([0.4, 0.0, 0.5]), 1e-16 * np.eye(3))
        world.see(keyframe)
    z = between(world.true[1], world.true[12])
    world.graph.add_relative_pose(1, 12, z, 1e12 * np.eye(3), robust=False)
    assert world.graph.optimize().converged
    np.testing.assert_allclose(world.errors(), 0.0, atol=2e-5)
    deviations = np.sqrt(np.diag(world.graph.covariance(12)))
    assert (deviations > 1e-7).all()
    assert (deviations < 2e-5).all()
