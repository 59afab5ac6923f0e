from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from explore_slam.errors import SlamError
from explore_slam.geometry import compose
from explore_slam.slam.graph import JointGraph

NOISE = np.diag([0.02, 0.01, 0.01]) ** 2


def test_vehicles_are_tied_by_what_both_observe(make_world):
    graph = make_world().graph
    R = [[0.1, 0.0, 0.0, 0.1, 0.0, 0.1]]
    for vehicle in range(4):
        graph.add_start(vehicle, vehicle, [vehicle, 0.0, 0.0])
    graph.add_observations(0, [5], [[1.0, 0.0, 1.0]], R)
    assert [graph.tied(v) for v in range(4)] == [{0}, {1}, {2}, {3}]
    graph.add_observations(2, [5], [[-1.0, 0.0, 1.0]], R)
    assert [graph.tied(v) for v in range(4)] == [{0, 2}, {1}, {0, 2}, {3}]
    measured = graph.add_relative_position(1, 3, [2.0, 0.0], 0.01 * np.eye(2))
    graph.add_observations(3, [8], [[1.0, 0.0, 1.0]], R)
    assert [graph.tied(v) for v in range(4)] == [{0, 2}, {1, 3}, {0, 2}, {1, 3}]
    graph.merge_landmarks([8], [5])
    assert graph.tied(1) == {0, 1, 2, 3}
    graph.remove_factor(measured)
    graph.remove_landmarks([5])
    assert [graph.tied(v) for v in range(4)] == [{0}, {1}, {2}, {3}]


def test_vehicles_without_a_tie_are_independent(make_world):
    """The second vehicle's part is the same, bit for bit, whatever the first one does."""
    found = []
    for pull in (0.0, 1.0):
        world = make_world(2)
        world.start(0, [0.0, 0.0, 0.0])
        world.start(1, [30.0, 0.0, 0.0])
        world.points = np.concatenate([world.points, world.points + [30.0, 0.0, 0.0]])
        for _ in range(10):
            for vehicle in (0, 1):
                world.see(world.drive(vehicle, np.array([0.4, 0.0, 0.3])))
        assert world.graph.tied(1) == {1}
        world.graph.add_prior(2, [pull, 0.0, 0.0], np.eye(3))
        world.graph.optimize()
        draws = world.graph.draw(4, np.random.default_rng(0), 1)
        assert draws.keyframes.tolist() == list(range(1, 22, 2))
        found.append((draws.poses, world.graph.path()))
    np.testing.assert_array_equal(found[0][0], found[1][0])
    np.testing.assert_array_equal(found[0][1][1::2], found[1][1][1::2])
    assert np.abs(found[0][1][2] - found[1][1][2]).max() > 1e-4
    everything = world.graph.draw(4, np.random.default_rng(0))
    assert everything.keyframes.tolist() == list(range(22))


def test_observed_vehicle_inherits_the_pose(make_world):
    graph = make_world().graph
    graph.add_start(0, 0, [1.0, 2.0, 0.5 * np.pi])
    graph.add_start(1, 1, [0.0, 0.0, 0.0], 100.0 * np.eye(3))
    graph.add_relative_position(0, 1, [2.0, 1.0], 0.01 * np.eye(2))
    graph.optimize()
    assert graph.estimate(1)[:2] == pytest.approx([0.0, 4.0], abs=1e-3)
    expected = 1.0 / (100.0 + 1 / 100.0)
    assert graph.covariance(1)[0, 0] == pytest.approx(expected, rel=1e-3)


def test_snapshot_is_solved_in_another_thread_while_the_graph_grows(make_world):
    worlds = [make_world(9), make_world(9)]
    for world in worlds:
        world.circle(10)
    aside, direct = (world.graph for world in worlds)
    problem = aside.snapshot(0)
    untouched = [np.copy(column) for column in (problem.start, *problem.factors)]
    with ThreadPoolExecutor(1) as pool:
        future = pool.submit(aside.solve, problem)
        before = aside.path()
        aside.add_keyframe(0, 22, [0.4, 0.0, 0.1], NOISE)
        aside.remove_landmarks(aside.landmarks()[0][:2])
        solution = future.result()
    for column, copy in zip((problem.start, *problem.factors), untouched, strict=True):
        np.testing.assert_array_equal(column, copy)
    aside.adopt(solution)
    direct.optimize()
    np.testing.assert_array_equal(aside.path()[:22], direct.path())
    assert np.abs(before - direct.path()).max() > 1e-3
    # the keyframe that came meanwhile moves with the one before
    moved = compose(direct.path()[20], [0.4, 0.0, 0.1])
    np.testing.assert_allclose(aside.path()[22], moved, atol=1e-12)
    draws = solution.draw(6, np.random.default_rng(0))
    np.testing.assert_array_equal(draws.poses, direct.draw(6, np.random.default_rng(0)).poses)
    assert aside.optimize().keyframes == 23


def test_starts_that_were_exact_move_together_into_the_frame_of_a_survey():
    """Two vehicles that have nothing in common but their starts; only the first is surveyed."""
    graph = JointGraph()
    graph.add_start(0, 0, [0.0, 0.0, 0.0])
    graph.add_start(1, 1, [4.0, 0.0, 0.5])
    for keyframe, vehicle in ((2, 0), (3, 1)):
        graph.add_keyframe(vehicle, keyframe, [1.0, 0.0, 0.0], 1e-4 * np.eye(3))
    frame = np.array([10.0, 5.0, 1.2])
    before = graph.path()
    graph.move([0, 1], frame, None)
    np.testing.assert_allclose(graph.path(), compose(frame, before), atol=1e-9)
    graph.optimize()  # the starts moved along
    np.testing.assert_allclose(graph.path(), compose(frame, before), atol=1e-6)
    graph.release_starts([0, 1], [30.0, 30.0, 3.0])
    assert graph.tied(0) == {0, 1}
    surveyed = np.array([10.3, 5.1, 1.3])
    graph.add_prior(0, surveyed, 1e-6 * np.eye(3))
    graph.optimize()
    np.testing.assert_allclose(graph.path(), compose(surveyed, before), atol=0.01)
    with pytest.raises(SlamError, match='expected positive numbers'):
        graph.release_starts([0], [1.0, 0.0, 1.0])
