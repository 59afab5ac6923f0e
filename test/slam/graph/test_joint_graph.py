from dataclasses import replace

import numpy as np
import pytest

from explore_slam.errors import SlamError
from explore_slam.slam.graph import JointGraph
from explore_slam.slam.graph.checks import symmetric

OBSERVATION = np.array([0.05**2, 0.0004, 0.0003, 0.03**2, 0.0, 0.03**2])
NOISE = 1e-4 * np.eye(3)
R = np.array([[0.01, 0.0, 0.0, 0.01, 0.0, 0.01]])


def graph_of(steps=4):
    graph = JointGraph()
    graph.add_start(0, 0, [0.0, 0.0, 0.0])
    for k in range(1, steps):
        graph.add_keyframe(0, k, [1.0, 0.0, 0.0], NOISE)
    return graph


@pytest.mark.parametrize(
    ('call', 'match'),
    [
        (lambda g: g.add_start(0, 9, [0, 0, 0]), 'vehicle 0 has a start'),
        (lambda g: g.add_start(1, 3, [0, 0, 0]), 'keyframe 3 does not come after'),
        (lambda g: g.add_start(1, 9, [0, 0]), r'pose has shape \(2,\)'),
        (lambda g: g.add_start(1, 9, [0, 0, np.nan]), 'pose is .*nan'),
        (lambda g: g.add_keyframe(1, 9, [0, 0, 0], NOISE), 'vehicle 1 has no start'),
        (lambda g: g.add_keyframe(0, 2, [0, 0, 0], NOISE), 'keyframe 2 does not come after'),
        (lambda g: g.add_keyframe(0, 9, [0, 0, 0], -NOISE), 'covariance has the eigenvalue'),
        (lambda g: g.add_keyframe(0, 9, [0, 0, 0], NOISE, np.full((3, 3), np.inf)), 'white is'),
        (lambda g: g.add_observations(7, [1], [[1, 0, 0]], R), 'keyframe 7 is not'),
        (lambda g: g.add_observations(2, [1], [[1, 0]], R), 'z has shape'),
        (lambda g: g.add_observations(2, [1], [[1, 0, 0]], 0 * R), 'R: covariance 0'),
        (lambda g: g.add_observations(2, [-1], [[1, 0, 0]], R), 'landmarks is'),
        (lambda g: g.add_observations(2, [1.5], [[1, 0, 0]], R), 'landmarks is'),
        (lambda g: g.add_observations(2, [1], [[1, 0, 0]], R, [0.0]), 'weights lie in 0'),
        (lambda g: g.add_observations(2, [1], [[1, 0, 0]], R, [np.nan]), 'weights is'),
        (lambda g: g.add_relative_pose(1, 1, [0, 0, 0], NOISE), 'relative to itself'),
        (lambda g: g.add_relative_pose(1, 8, [0, 0, 0], NOISE), 'keyframe 8 is not'),
        (lambda g: g.add_relative_pose(1, 2, [0, 0, 0], np.triu(np.ones((3, 3)))), 'symmetric'),
        (lambda g: g.add_relative_pose(1, 2, [0, 0, 0], 1e13 * np.eye(3)), 'at most 1e.12'),
        (lambda g: g.add_relative_position(1, 2, [0, 0, 0], np.eye(2)), 'z has shape'),
        (lambda g: g.add_relative_position(1, 2, [0, 0], -np.eye(2)), 'R has the eigenvalue'),
        (lambda g: g.add_prior(5, [0, 0, 0]), 'keyframe 5 is not'),
        (lambda g: g.remove_factor(0), 'only prior of vehicle 0'),
        (lambda g: g.remove_factor(77), 'factor 77 is not'),
        (lambda g: g.make_robust(77), 'factor 77 is not'),
        (lambda g: g.vehicles_of([1, 12]), 'keyframe 12 is not'),
        (lambda g: g.merge_landmarks([1, 2], [3]), 'old has 2 ids'),
        (lambda g: g.merge_landmarks([1, 2], [2, 3]), 'landmark 2 is to be merged'),
        (lambda g: g.move_observations([1, 2], [3]), 'numbers has 2 elements'),
        (lambda g: g.move_observations([1], [-3]), 'into is'),
        (lambda g: g.observations_since(12), 'keyframe 12 is not'),
        (lambda g: g.optimize(3), 'vehicle 3 is not'),
        (lambda g: g.covariance(12), 'keyframe 12 is not'),
        (lambda g: g.relative_covariance(1, [12]), 'keyframe 12 is not'),
        (lambda g: g.estimate(-1), 'keyframe -1 is not'),
    ],
)
def test_bad_input_is_named_and_changes_nothing(call, match):
    graph, same = graph_of(), graph_of()
    with pytest.raises(SlamError, match=match):
        call(graph)
    for g in (graph, same):
        g.add_keyframe(0, 10, [0.5, 0.1, 0.2], NOISE)
        g.add_relative_pose(0, 10, [3.4, 0.0, 0.1], 1e4 * np.eye(3))
        assert g.optimize().factors == 6
    np.testing.assert_array_equal(graph.path(), same.path())
    np.testing.assert_array_equal(graph.covariance(10), same.covariance(10))


def test_motion_without_measurements_is_dead_reckoning():
    graph = graph_of()
    graph.optimize()
    np.testing.assert_allclose(graph.path(), [[k, 0, 0] for k in range(4)], atol=1e-12)
    # heading errors act on the ways after them: 1e-4 (3 + 1² + 2²) across
    expected = np.diag([3e-4, 8e-4, 3e-4])
    expected[1, 2] = expected[2, 1] = 3e-4
    np.testing.assert_allclose(graph.covariance(3), expected, rtol=1e-6, atol=1e-10)


def test_prior_moves_the_path_and_can_be_removed():
    graph = graph_of()
    graph.optimize()
    before = graph.path()
    factor = graph.add_prior(3, [3.0, 0.5, 0.0], 1e-6 * np.eye(3))
    graph.optimize()
    assert graph.estimate(3)[1] == pytest.approx(0.5, abs=0.01)
    graph.remove_factor(factor)
    graph.optimize()
    np.testing.assert_allclose(graph.path(), before, atol=1e-9)


def test_wrong_closure_stands_out_and_is_removed(make_world):
    world = make_world(3)
    world.circle(12, vehicles=1)
    right = world.close(1, 11, 1e-4 * np.eye(3))
    wrong = world.graph.add_relative_pose(2, 10, [5.0, 5.0, 1.0], 1e4 * np.eye(3))
    world.graph.optimize()
    held_off = world.graph.path()
    factors, distances = world.graph.closure_residuals()
    assert factors.tolist() == [right, wrong]
    assert distances[0] < 20
    assert distances[1] > 1e4
    world.graph.remove_factor(wrong)
    world.graph.optimize()
    assert np.abs(held_off - world.graph.path())[:, :2].max() < 0.01
    assert world.graph.closure_residuals()[0].tolist() == [right]


def test_outliers_are_downweighted(make_world):
    world = make_world(5, landmarks=20)
    world.circle(15, vehicles=1)
    world.graph.optimize()
    ids = world.graph.landmarks()[0]
    often = ids[[np.argmax(np.diff(world.graph.observations_of(ids).first))]]
    before = world.graph.path()
    world.graph.add_observations(7, often, [[-9.0, 0.0, 0.0]], [[1e-3, 0, 0, 1e-3, 0, 1e-3]])
    world.graph.optimize()
    assert np.abs(world.graph.path() - before)[:, :2].max() < 0.1
    information = world.graph.observations_of(often).W[:, 0]
    assert information[-1] < 0.1 * 1e3
    assert information[:-1].min() > 100.0


def test_merged_landmarks_are_one_landmark(make_world):
    """A landmark with another number in every other frame, merged, is as if it had had one."""
    plain, split = make_world(6), make_world(6)
    plain.circle(10)
    plain.graph.optimize()
    graph = split.graph
    record = graph.add_observations
    odd = {}

    def renumbered(keyframe, ids, z, R):
        numbers = ids + 1000 * (keyframe % 2)
        odd.update({int(n): int(i) for n, i in zip(numbers, ids, strict=True) if n != i})
        record(keyframe, numbers, z, R)

    graph.add_observations = renumbered
    split.circle(10)
    graph.optimize()
    assert np.abs(graph.path() - plain.graph.path()).max() > 1e-4
    graph.merge_landmarks(list(odd), list(odd.values()))
    graph.optimize()
    np.testing.assert_allclose(graph.path(), plain.graph.path(), atol=1e-6)
    assert not len(graph.observations_of(list(odd)).z)


def test_moved_observations_belong_to_other_landmarks(make_world):
    """What was merged by mistake is taken apart again: the graph is as it was."""
    world = make_world(6)
    world.circle(10)
    graph = world.graph
    graph.optimize()
    path, ids = graph.path(), graph.landmarks()[0]
    old, into = ids[:3], ids[3:6]
    numbers = [graph.observation_numbers([n]) for n in old.tolist()]
    positions = dict(zip(ids.tolist(), graph.landmarks()[1], strict=True))
    graph.merge_landmarks(old, into)
    graph.optimize()
    assert np.abs(graph.path() - path).max() > 1e-3
    for number, some in zip(old.tolist(), numbers, strict=True):
        graph.move_observations(some, np.full(len(some), number + 1000))
    graph.move_observations([10_000], [5])  # is not stored
    for _ in range(5):  # the robust kernel takes its time to trust all of them again
        graph.optimize()
    np.testing.assert_allclose(graph.path(), path, atol=1e-6)
    found = dict(zip(*graph.landmarks(), strict=True))
    for number in old.tolist():
        np.testing.assert_allclose(found[number + 1000], positions[number], atol=1e-5)
    everything = np.concatenate(numbers)
    graph.move_observations(everything, np.full(len(everything), 7777))
    assert not len(graph.observations_of(old + 1000).z)
    assert graph.observed_landmarks(everything)[0].tolist() == [7777] * len(everything)


def test_observations_since_a_keyframe_are_those_of_its_vehicle(make_world):
    world = make_world(6)
    world.circle(6, vehicles=2)
    graph = world.graph
    keyframe = int(graph.live_keyframes()[5])
    vehicle = graph.vehicles_of([keyframe])[0]
    landmarks, numbers = graph.observations_since(keyframe)
    assert len(numbers) > 0
    np.testing.assert_array_equal(graph.observed_landmarks(numbers)[0], landmarks)
    stored = graph.observations_of(np.unique(landmarks))
    later = stored.keyframes[graph.vehicles_of(stored.keyframes) == vehicle]
    assert np.count_nonzero(later >= keyframe) == len(numbers)


def test_removed_landmarks_leave_nothing_behind(make_world):
    world = make_world(7)
    world.circle(10)
    world.graph.optimize()
    world.graph.remove_landmarks(np.arange(0, world.landmarks, 2))
    world.graph.remove_landmarks([12_345])
    again = JointGraph(world.config)
    for kind, *data in world.recorded:
        if kind == 'start':
            again.add_start(len(again.path()), data[0], data[1])
        elif kind == 'motion':
            again.add_keyframe(data[0] % 2, *data[1:])
        elif data[1] % 2:
            again.add_observations(data[0], [data[1]], [data[2]], [OBSERVATION])
    for graph in (world.graph, again):
        graph.optimize()
    np.testing.assert_allclose(world.graph.path(), again.path(), atol=1e-6)
    assert not len(world.graph.observations_of([0, 2, 4]).z)
    assert (world.graph.landmarks()[0] % 2 == 1).all()


def test_frame_counts_as_few_independent_observations(make_world):
    worlds = [make_world(8), make_world(8)]
    worlds[1].graph = JointGraph(replace(worlds[1].config, graph_independent_observations=2.0))
    for world in worlds:
        world.circle(8, vehicles=1)
        world.graph.optimize()
    free, capped = (w.graph.covariance(w.newest[0]) for w in worlds)
    assert np.trace(capped) > 1.2 * np.trace(free)
    factors = worlds[1].graph.snapshot(0).factors
    per_frame = np.bincount(factors.a[factors.kind == 3], factors.W[factors.kind == 3, 0, 0])
    single = np.linalg.inv([[0.0025, 0.0004, 0.0003], [0.0004, 0.0009, 0], [0.0003, 0, 0.0009]])
    assert per_frame.max() == pytest.approx(2.0 * single[0, 0])


def test_planar_observations_are_those_without_height(make_world):
    """Without heights, the answer is that of observations whose height is independent."""
    worlds = [make_world(11), make_world(11)]
    worlds[0].graph = JointGraph(replace(worlds[0].config, graph_landmark_heights=False))
    record = worlds[1].graph.add_observations
    worlds[1].graph.add_observations = lambda k, ids, z, R: record(
        k, ids, z, R * [1.0, 1.0, 0.0, 1.0, 0.0, 1.0]
    )
    for world in worlds:
        world.circle(10)
        world.graph.optimize()
    np.testing.assert_allclose(worlds[0].graph.path(), worlds[1].graph.path(), atol=1e-9)
    newest = worlds[0].newest[0]
    planar, same = (world.graph.covariance(newest) for world in worlds)
    np.testing.assert_allclose(planar, same, rtol=1e-3)


def test_a_closure_made_robust_is_the_same_as_one_added_so():
    graphs = graph_of(6), graph_of(6)
    wrong, information = [3.0, 1.0, 0.5], 1e4 * np.eye(3)
    graphs[0].add_relative_pose(0, 5, wrong, information)
    factor = graphs[1].add_relative_pose(0, 5, wrong, information, robust=False)
    graphs[1].optimize()
    pulled = graphs[1].path()[5, 1]
    graphs[1].make_robust(factor)
    for graph in graphs:
        graph.optimize()
    assert abs(graphs[0].path()[5, 1]) < 0.1 * abs(pulled)
    # the robust cost has two minima far from each other; from the same start both are the same
    again = graph_of(6)
    again.make_robust(again.add_relative_pose(0, 5, wrong, information, robust=False))
    again.optimize()
    np.testing.assert_array_equal(again.path(), graphs[0].path())


def test_a_new_closure_is_robust_from_its_optimum_on():
    """In one call, and without a change of the graph until the solution is adopted."""
    graphs = graph_of(6), graph_of(6)
    measured, information = [3.5, 0.2, 0.1], 1e4 * np.eye(3)
    factors = [g.add_relative_pose(0, 5, measured, information, robust=False) for g in graphs]
    graphs[0].optimize()
    graphs[0].make_robust(factors[0])
    graphs[0].optimize()
    before = graphs[1].state_dict()
    solution = graphs[1].solve(graphs[1].snapshot(0), [factors[1]])
    for name, value in graphs[1].state_dict().items():
        np.testing.assert_array_equal(value, before[name])
    graphs[1].adopt(solution)
    np.testing.assert_allclose(graphs[1].path(), graphs[0].path(), atol=1e-6)
    expected = graphs[0].snapshot(0).factors.robust
    np.testing.assert_array_equal(graphs[1].snapshot(0).factors.robust, expected)
    # what was adopted is the posterior of the graph as it is now
    assert graphs[1].posterior(0).factorization is solution.factorization


def test_motion_between_keyframes_is_as_uncertain_as_the_posterior_of_a_chain():
    graph = JointGraph()
    graph.add_start(0, 0, [1.0, 2.0, 0.4])
    graph.add_start(1, 1, [5.0, 2.0, 0.4])
    for k in range(2, 9):
        graph.add_keyframe(k % 2, k, [0.7, 0.1, 0.3], np.diag([2e-4, 1e-4, 3e-4]))
    graph.optimize()
    expected = graph.relative_covariance(2, [8])[0]
    np.testing.assert_allclose(graph.motion_covariance(2, 8), expected, rtol=1e-3, atol=1e-9)
    assert not graph.motion_covariance(8, 8).any()
    np.testing.assert_array_equal(graph.vehicles_of([8, 1, 3, 0]), [0, 1, 1, 0])
    assert (graph.newest_keyframe(0), graph.newest_keyframe(1)) == (8, 7)


def test_what_rounding_leaves_below_zero_is_no_error():
    white = np.diag([1e-7, 1e-7, -1.92e-15])
    assert np.array_equal(symmetric('white', white, 3), white)
    with pytest.raises(SlamError, match='white has the eigenvalue -2e-12'):
        symmetric('white', np.diag([1e-7, 1e-7, -2e-12]), 3)
