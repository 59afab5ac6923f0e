import math
from dataclasses import replace

import numpy as np
import pytest

from explore_slam.errors import SlamError
from explore_slam.geometry import Pose2, between, compose
from explore_slam.slam.graph import GraphConfig, JointGraph
from explore_slam.slam.graph.se2 import compound
from explore_slam.slam.particles.motion import calibrated

NOISE = np.diag([0.02, 0.01, 0.01]) ** 2
STEP = np.array([0.4, 0.0, 0.25])  # 25 of them are a circle
LAP = 25
LANDMARK_NOISE = [[1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4]]


@pytest.fixture
def bounded_world(make_world):
    def make(seed=0, **values):
        world = make_world(seed)
        world.config = replace(world.config, graph_bounded=True, **values)
        world.graph = JointGraph(world.config)
        return world

    return make


def lap(world, vehicles):
    """Drive a lap, steering by truth, so that all laps are the same; returns errors and NEES."""
    errors, nees = [], []
    for _ in range(LAP):
        for vehicle in range(vehicles):
            place = LAP * vehicle // 3 + len(errors) // vehicles + 1
            target = compose([0.0, -1.6, 0.0], circle_pose(place))
            increment = between(world.true[world.newest[vehicle]], target)
            keyframe = world.drive(vehicle, increment, NOISE)
            world.see(keyframe)
            world.graph.optimize(vehicle)
            error = between(world.true[keyframe], world.graph.estimate(keyframe))
            theta = world.true[keyframe][2]
            c, s = np.cos(theta), np.sin(theta)
            turned = np.array([c * error[0] - s * error[1], s * error[0] + c * error[1], error[2]])
            errors.append(np.hypot(*error[:2]))
            nees.append(turned @ np.linalg.solve(world.graph.covariance(keyframe), turned))
    return errors, nees


def circle_pose(place):
    pose = np.zeros(3)
    for _ in range(place % LAP):
        pose = compose(pose, [0.4, 0.0, 2 * np.pi / LAP])
    return pose


def start(world, vehicles):
    for vehicle in range(vehicles):
        pose = compose([0.0, -1.6, 0.0], circle_pose(LAP * vehicle // 3))
        world.start(vehicle, pose)


@pytest.mark.parametrize('visits', [2, 3])
def test_graph_stops_growing_and_stays_consistent(bounded_world, visits):
    """It is complete once the newest keyframes of the last visit that is kept are old ones."""
    nees, sizes = [], []
    for seed in range(3):
        world = bounded_world(seed, graph_visits=visits)
        start(world, 2)
        for _ in range(6):
            nees += lap(world, 2)[1]
            sizes.append(len(world.graph.live_keyframes()))
    by_lap = np.array(sizes).reshape(3, 6)
    assert (by_lap[:, 5] <= by_lap[:, visits] + 2).all(), by_lap
    assert (by_lap[:, 5] < 2 * (visits + 1) * LAP).all(), by_lap
    # means over 6 laps of errors that are correlated along a lap, expectation 3
    assert 2.0 < np.mean(nees) < 4.0


@pytest.mark.parametrize('landmarks', [40, 300])
def test_many_landmarks_keep_two_visits_of_a_view_and_few_keep_all(make_world, landmarks):
    world = make_world(1, landmarks=landmarks)
    world.config = replace(
        world.config, graph_bounded=True, graph_visits=6, graph_observations_per_keyframe=15
    )
    world.graph = JointGraph(world.config)
    start(world, 1)
    kept, nees = [], []
    for _ in range(6):
        nees += lap(world, 1)[1]
        kept.append(len(world.graph.observing_keyframes([0])))
    if landmarks == 300:
        assert kept[5] <= kept[2] + 2, kept
    else:
        assert kept[5] > kept[2] + LAP, kept
    assert 1.5 < np.mean(nees) < 4.5


@pytest.mark.parametrize(
    ('shown', 'common'), [(40, 3), (40, 2), (25, 3)], ids=['rich', 'place in doubt', 'few']
)
def test_of_a_rich_texture_that_is_new_at_every_visit_two_visits_are_kept(
    bounded_world, shown, common
):
    """shown: new landmarks per keyframe, each seen from two; common: those of every lap."""
    graph = bounded_world(graph_observations_per_keyframe=15).graph
    graph.add_start(0, 0, circle_pose(0))
    kept = []
    for k in range(1, 5 * LAP + 1):
        graph.add_keyframe(0, k, between(circle_pose(k - 1), circle_pose(k)), NOISE)
        first = 1000 + k * shown // 2
        ids = np.append(np.arange(first, first + shown), np.arange(common))
        z = np.tile([2.0, 0.0, 1.0], (len(ids), 1))
        graph.add_observations(k, ids, z, np.repeat(LANDMARK_NOISE, len(ids), axis=0))
        if k % LAP == 0:
            kept.append(len(graph.observing_keyframes([0])))
    if (shown, common) == (40, 3):
        assert kept[4] <= kept[1] + 10, kept  # its newest keyframes are always kept
    else:
        assert kept[4] == 5 * LAP, kept


def test_bound_costs_little_accuracy(bounded_world):
    errors = {}
    for bounded in (True, False):
        world = bounded_world(5)
        world.graph = JointGraph(replace(world.config, graph_bounded=bounded))
        start(world, 1)
        errors[bounded] = np.concatenate([lap(world, 1)[0] for _ in range(4)])
    rms = {bounded: np.sqrt(np.mean(e**2)) for bounded, e in errors.items()}
    assert rms[True] < 1.2 * rms[False]


def test_motion_over_dropped_keyframes_is_exact(bounded_world):
    """Without landmarks, dropping changes neither the estimate nor the covariance."""
    world, whole = bounded_world(), JointGraph(GraphConfig(graph_bounded=False))
    for graph in (world.graph, whole):
        graph.add_start(0, 0, [1.0, 2.0, 0.3])
        for k in range(1, 40):
            graph.add_keyframe(0, k, STEP, NOISE)
        graph.optimize()
    assert world.graph.live_keyframes().tolist() == [0, *range(32, 40)]
    np.testing.assert_allclose(world.graph.path(), whole.path(), atol=1e-9)
    for k in (33, 39):
        expected = whole.covariance(k)
        np.testing.assert_allclose(world.graph.covariance(k), expected, rtol=1e-6, atol=1e-12)


def test_dropped_keyframes_stay_where_the_whole_graph_has_them(bounded_world):
    """A correction between two kept keyframes is spread as the exact smoother spreads it."""
    world, whole = bounded_world(), JointGraph(GraphConfig(graph_bounded=False))
    for graph in (world.graph, whole):
        graph.add_start(0, 0, [0.0, 0.0, 0.0])
        for k in range(1, 30):
            graph.add_keyframe(0, k, [0.4, 0.0, 0.05 * (k % 3)], NOISE)
            if k == 20:
                graph.pin(k)
        graph.optimize()
        pose = graph.estimate(20) + [0.05, -0.04, 0.03]
        graph.add_prior(20, pose, 1e-4 * np.eye(3))
        graph.optimize()
    assert len(world.graph.live_keyframes()) < len(whole.live_keyframes())
    np.testing.assert_allclose(world.graph.path(), whole.path(), atol=2e-3)
    assert np.abs(world.graph.path() - whole.path())[:, 2].max() < 1e-3
    np.testing.assert_array_equal(world.graph.estimate(7), world.graph.path()[7])


def test_what_is_measured_or_pinned_stays(bounded_world):
    graph = bounded_world().graph
    graph.add_start(0, 0, [0.0, 0.0, 0.0])
    for k in range(1, 9):
        graph.add_keyframe(0, k, STEP, NOISE)
    graph.pin(2)
    graph.pin(2)
    closure = graph.add_relative_pose(1, 4, [1.2, 0.0, 0.7], 1e3 * np.eye(3))
    for k in range(9, 30):
        graph.add_keyframe(0, k, STEP, NOISE)
    newest = list(range(22, 30))
    assert graph.live_keyframes().tolist() == [0, 1, 2, 4, *newest]
    graph.unpin(2)
    assert 2 in graph.live_keyframes()
    graph.unpin(2)
    assert graph.live_keyframes().tolist() == [0, 1, 4, *newest]
    with pytest.raises(SlamError, match='keyframe 2 is not pinned'):
        graph.unpin(2)
    with pytest.raises(SlamError, match='keyframe 2 was dropped'):
        graph.pin(2)
    with pytest.raises(SlamError, match='keyframe 3 was dropped'):
        graph.add_relative_pose(0, 3, [0, 0, 0], NOISE)
    graph.remove_factor(closure)
    assert graph.live_keyframes().tolist() == [0, *newest]
    graph.optimize()
    np.testing.assert_allclose(graph.estimate(29), graph.path()[-1])


def test_observations_kept_per_visit(bounded_world):
    """A landmark that is in view now and then: three observations of three visits are kept."""
    graph = bounded_world(graph_recent_observations=0).graph
    R = [[0.01, 0.0, 0.0, 0.01, 0.0, 0.01]]
    graph.add_start(0, 0, [0.0, 0.0, 0.0])
    for k in range(1, 100):
        graph.add_keyframe(0, k, [0.0, 0.0, 0.0], NOISE)
        if k % 30 < 10:  # 1 … 9, 30 … 39, 60 … 69, 90 … 99
            graph.add_observations(k, [7], [[2.0, 0.0, 1.0]], R)
    kept = graph.observations_of([7]).keyframes
    assert kept.tolist() == [1, 2, 3, 30, 31, 32, 60, 61, 62, *range(92, 100)]
    assert graph.live_keyframes().tolist() == [0, *kept]


@pytest.mark.parametrize('beside', [False, True], ids=['alone', 'beside one at rest'])
def test_what_is_known_of_the_present_pose_is_not_dropped(bounded_world, beside):
    """Three landmarks fix the pose, seen often before; then only one of them is in view.

    beside: another vehicle rests, and observes landmarks of its own from an old keyframe.
    """
    places = np.array([[2.0, 0.0, 1.0], [0.0, 2.0, 1.0], [-2.0, 1.0, 1.0]])
    noise = np.repeat(LANDMARK_NOISE, 3, axis=0)
    bounded, whole = bounded_world().graph, JointGraph(GraphConfig(graph_bounded=False))
    for graph in (bounded, whole):
        graph.add_start(1, 0, [0.0, 5.0, 0.0])
        graph.add_start(0, 1, [0.0, 0.0, 0.0])
        for k in range(2, 121):
            graph.add_keyframe(0, k, np.zeros(3), NOISE)
            if k < 111:
                graph.add_observations(k, [0, 1, 2], places, noise)
            else:
                graph.add_observations(k, [0], places[:1], noise[:1])
            if beside:
                graph.add_observations(0, [7, 8, 9], places, noise)
        graph.optimize()
    assert len(bounded.live_keyframes()) < 60
    deviations, expected = (np.sqrt(np.diag(g.covariance(120))) for g in (bounded, whole))
    assert (deviations < 1.5 * expected).all()


def test_keyframes_that_wait_for_newer_observations_are_bounded(bounded_world):
    graph = bounded_world().graph
    graph.add_start(0, 0, [0.0, 0.0, 0.0])
    for k in range(1, 400):
        graph.add_keyframe(0, k, np.zeros(3), NOISE)
        graph.add_observations(k, [7], [[2.0, 0.0, 1.0]], LANDMARK_NOISE)
    assert len(graph.live_keyframes()) < 110


def test_paths_on_both_sides_of_a_restart_are_bounded(bounded_world):
    graph = bounded_world().graph
    graph.add_start(0, 0, [0.0, 0.0, 0.0])
    for k in range(1, 100):
        if k == 50:
            graph.restart(0, k, [9.0, 0.0, 0.0], 1e-4 * np.eye(3))
        else:
            graph.add_keyframe(0, k, STEP, NOISE)
        if k == 45:
            graph.add_observations(k, [7], [[2.0, 0.0, 1.0]], LANDMARK_NOISE)
    graph.optimize()
    # 45 is the only one with an observation
    assert graph.live_keyframes().tolist() == [0, 45, 49, 50, *range(92, 100)]
    assert np.isfinite(graph.path()).all()


def test_last_chain_is_where_the_next_motion_starts(bounded_world):
    graph = bounded_world().graph
    white = np.diag([0.02, 0.02, 0.01]) ** 2
    graph.add_start(0, 0, [0.0, 0.0, 0.0])
    for k in range(1, 5):
        graph.add_keyframe(0, k, STEP, NOISE, white)
    graph.add_prior(4, compose(graph.estimate(4), [0.1, 0.0, 0.0]), white)
    graph.optimize()
    chain = graph.draw(1, np.random.default_rng(0)).chains[-1, :, 0]
    graph.add_keyframe(0, 5, STEP, NOISE, white)
    np.testing.assert_allclose(graph.estimate(5), compose(chain, STEP), atol=1e-12)
    assert np.abs(chain - graph.estimate(4))[0] > 0.005


def test_dropped_keyframes_keep_what_was_known_of_their_white_error():
    white = np.diag([0.05, 0.05, 0.02]) ** 2
    graph = JointGraph(GraphConfig(graph_bounded=True, graph_recent_keyframes=1))
    graph.add_start(0, 0, [0.0, 0.0, 0.0])
    for k in range(1, 6):
        graph.add_keyframe(0, k, STEP, NOISE, white)
        if k == 2:
            graph.pin(2)
    precise = np.diag([1e-3, 1e-3, 1e-3]) ** 2
    prior = graph.add_prior(2, compose(graph.estimate(2), [0.04, 0.02, 0.01]), precise)
    graph.optimize()
    known, beside = graph.path()[2], graph.path()[5]
    graph.unpin(2)
    graph.remove_factor(prior)
    assert 2 not in graph.live_keyframes()
    np.testing.assert_allclose(graph.path()[2], known, atol=1e-12)
    graph.optimize()  # the rest of the path goes back, and takes the keyframe along
    left = between(graph.path()[2], graph.path()[5])
    np.testing.assert_allclose(left, between(known, beside), atol=0.01)
    straight = compose(compose(STEP, STEP), STEP)
    assert np.hypot(*(left - straight)[:2]) > 0.02


def test_path_begins_at_the_first_keyframe_even_without_its_prior(bounded_world):
    graph = bounded_world().graph
    start = graph.add_start(0, 0, [0.0, 0.0, 0.0])
    graph.add_keyframe(0, 1, STEP, NOISE)
    graph.add_prior(1, STEP)
    graph.remove_factor(start)
    for k in range(2, 30):
        graph.add_keyframe(0, k, STEP, NOISE)
    graph.optimize()
    assert graph.live_keyframes().tolist() == [0, 1, *range(22, 30)]
    np.testing.assert_allclose(graph.path()[0], 0.0, atol=1e-6)


DEVIATIONS = [0.1, 0.05, 0.05]


def drive_wheels(graph, first, last):
    """Add keyframes of wheel odometry, which depends on the calibration."""
    for k in range(first, last):
        wheel = Pose2(0.4, 0.0, 0.3 if k // 10 % 2 else -0.25)
        graph.add_keyframe(0, k, wheel, NOISE, sensitivity=calibrated(wheel, np.zeros(3))[1])


def calibration_deviations(graph):
    return graph.draw(4000, np.random.default_rng(0)).calibrations[0].std(axis=1)


def test_compounding_dropped_keyframes_keeps_the_calibration(bounded_world):
    """What a known pose tells of the calibration is the same over kept and dropped keyframes."""
    world, whole = bounded_world(), JointGraph(GraphConfig(graph_bounded=False))
    for graph in (world.graph, whole):
        graph.add_start(0, 0, [1.0, 2.0, 0.3])
        graph.add_calibration(0, DEVIATIONS)
        drive_wheels(graph, 1, 40)
    right = np.array([0.01, -0.01, 0.005])
    truth = np.array([1.0, 2.0, 0.3])
    for k in range(1, 40):
        wheel = Pose2(0.4, 0.0, 0.3 if k // 10 % 2 else -0.25)
        truth = compose(truth, np.asarray(calibrated(wheel, right).increment))
    for graph in (world.graph, whole):
        graph.add_prior(39, truth, 1e-6 * np.eye(3))
        graph.optimize()
    assert len(world.graph.live_keyframes()) < 0.3 * len(whole.live_keyframes())
    deviations = calibration_deviations(whole)
    assert (deviations < 0.9 * np.array(DEVIATIONS)).any()
    off = world.graph.calibration(0) - whole.calibration(0)
    assert (np.abs(off) < 0.1 * deviations).all()
    np.testing.assert_allclose(calibration_deviations(world.graph), deviations, rtol=0.02)
    np.testing.assert_allclose(
        world.graph.covariance(35), whole.covariance(35), rtol=0.05, atol=1e-6
    )


def test_keyframes_dropped_at_a_known_calibration_are_compounded_exactly(bounded_world):
    """Linearized where the calibration is: the optimum does not move when keyframes go."""
    world, whole = bounded_world(), JointGraph(GraphConfig(graph_bounded=False))
    for graph in (world.graph, whole):
        graph.add_start(0, 0, [1.0, 2.0, 0.3])
        graph.add_calibration(0, DEVIATIONS)
        drive_wheels(graph, 1, 9)
        graph.pin(8)
        graph.add_prior(8, graph.estimate(8) + [0.1, -0.1, 0.15], 1e-6 * np.eye(3))
        for k in range(1, 8):
            graph.pin(k)  # what contradicts the prior stays, what comes later is compounded
        graph.optimize()
        drive_wheels(graph, 9, 40)
        graph.optimize()
    assert np.abs(whole.calibration(0)).max() > 0.01
    assert len(world.graph.live_keyframes()) < len(whole.live_keyframes())
    np.testing.assert_allclose(world.graph.calibration(0), whole.calibration(0), atol=1e-7)
    np.testing.assert_allclose(world.graph.path(), whole.path(), atol=1e-6)
    for k in (35, 39):
        expected = whole.covariance(k)
        np.testing.assert_allclose(
            world.graph.covariance(k), expected, atol=1e-4 * np.abs(expected).max()
        )


def test_dropped_keyframes_follow_the_calibrated_motion(bounded_world):
    """Wheels that turn 1.1 times too far: straight legs and turns, and nothing seen between."""
    graph = bounded_world().graph
    graph.add_start(0, 0, [0.0, 0.0, 0.0])
    graph.add_calibration(0, [0.3, 0.05, 0.05])
    true = np.array([0.0, 0.0, 0.0])
    path = [true]
    for k in range(1, 61):
        turn = 0.5 if k % 10 < 4 else 0.0
        wheel = Pose2(0.4, 0.0, 1.1 * turn)
        graph.add_keyframe(
            0, k, wheel, 1e-2 * NOISE, sensitivity=calibrated(wheel, np.zeros(3))[1]
        )
        true = compose(true, np.array([0.4, 0.0, turn]))
        path.append(true)
        if (k % 6 == 0 and k < 20) or k == 60:
            graph.add_prior(k, true, 1e-6 * np.eye(3))
            graph.optimize()
    assert graph.calibration(0)[0] == pytest.approx(1.0 / 1.1 - 1.0, abs=0.01)
    assert len(graph.live_keyframes()) < 15
    np.testing.assert_allclose(graph.path()[:, :2], np.array(path)[:, :2], atol=0.02)


def drive_back_and_forth(bounded_world, sees):
    """Drive ten times past a row of landmarks, half a metre apart, of which three are in view.

    Wheel odometry drifts sideways after the first pass, the caller's estimates do not. sees:
    whether the landmarks are observed after the first pass. Returns the graph and the true path.
    """
    graph = bounded_world().graph
    graph.add_start(0, 0, [0.0, 0.0, 0.0])
    path = [np.zeros(3)]
    for k in range(1, 200):
        turn = math.pi if k % 20 == 0 else 0.0
        true = compose(path[-1], np.array([0.5, 0.0, turn]))
        path.append(true)
        graph.add_keyframe(0, k, [0.5, 0.01 if k > 20 else 0.0, turn], NOISE, estimate=true)
        if sees or k < 20 or k > 190:
            places = round(float(true[0]) * 2.0) + np.arange(3)
            seen = np.c_[0.5 * places, np.full(3, 2.0), np.zeros(3)]
            graph.add_observations(
                k, places, between(true, seen), np.repeat(LANDMARK_NOISE, 3, axis=0)
            )
    return graph, np.array(path)


def test_dropped_keyframes_stay_where_their_landmarks_had_them(bounded_world):
    graph, true = drive_back_and_forth(bounded_world, sees=True)
    assert len(graph.live_keyframes()) < 100
    graph.optimize()
    np.testing.assert_allclose(graph.path()[:, :2], true[:, :2], atol=0.05)


def test_dropped_keyframes_move_with_the_kept_ones_that_share_landmarks(bounded_world):
    graph, _ = drive_back_and_forth(bounded_world, sees=True)
    graph.optimize()
    before = graph.path()
    graph.move([0], [3.0, 1.0, 0.5], [1.0, 1.0, 1.0])
    np.testing.assert_allclose(graph.path(), compose(np.array([3.0, 1.0, 0.5]), before))
    graph.add_prior(0, [3.0, 2.0, 0.6], 1e-8 * np.eye(3))
    graph.optimize()
    expected = compose(np.array([3.0, 2.0, 0.6]), between(before[0], before))
    np.testing.assert_allclose(graph.path()[:, :2], expected[:, :2], atol=0.05)


def test_dropped_keyframes_without_landmarks_are_interpolated_by_their_motion(bounded_world):
    graph, true = drive_back_and_forth(bounded_world, sees=False)
    graph.optimize()
    path = graph.path()
    np.testing.assert_allclose(path[:20, :2], true[:20, :2], atol=0.05)
    np.testing.assert_allclose(path[-5:, :2], true[-5:, :2], atol=0.05)
    live = graph.live_keyframes()
    between_live = np.flatnonzero(~np.isin(np.arange(25, 180), live)) + 25
    assert len(between_live) > 140
    jumps = np.diff(between(path[24:-1], path[25:])[between_live - 25, 1])
    assert np.abs(jumps).max() < 0.002  # smooth, as the wheels had it


def test_motion_covariance_has_the_lever_of_the_calibrated_motion(bounded_world):
    graph = bounded_world().graph
    graph.add_start(0, 0, [0.0, 0.0, 0.0])
    graph.add_calibration(0, [0.3, 0.05, 0.05])
    true, mean, expected = np.zeros(3), np.zeros(3), np.zeros((3, 3))
    for k in range(1, 13):
        wheel = Pose2(0.4, 0.0, 0.3)
        sensitivity = calibrated(wheel, np.zeros(3))[1]
        graph.add_keyframe(0, k, wheel, NOISE, sensitivity=sensitivity)
        true = compose(true, np.array([0.4, 0.0, 0.2]))
        graph.pin(k)
        graph.add_prior(k, true, 1e-6 * np.eye(3))
    graph.optimize()
    for _ in range(12):
        mean, expected = compound(mean, expected, np.array([0.4, 0.0, 0.2]), NOISE)
    found = graph.motion_covariance(0, 12)
    np.testing.assert_allclose(found, expected, rtol=0.05, atol=0.02 * expected.max())
    np.testing.assert_array_equal(graph.motion_covariance(12, 12), np.zeros((3, 3)))


def test_calibrations_are_drawn_jointly_with_the_path(bounded_world):
    graph = bounded_world().graph
    graph.add_start(0, 0, [0.0, 0.0, 0.0])
    graph.add_calibration(0, DEVIATIONS)
    for k in range(1, 30):
        wheel = Pose2(0.4, 0.0, 0.2)
        graph.add_keyframe(
            0, k, wheel, 1e-4 * NOISE, sensitivity=calibrated(wheel, np.zeros(3))[1]
        )
    graph.optimize()
    draws = graph.draw(2000, np.random.default_rng(0))
    some = draws.calibrations[0]
    np.testing.assert_allclose(some.std(axis=1), DEVIATIONS, rtol=0.06)
    # the heading at the end follows the scale of turning and the drift of each sample
    expected = 29 * (0.2 * (1.0 + some[0]) + 0.4 * some[2])
    off = np.remainder(draws.poses[-1, 2] - expected + np.pi, 2 * np.pi) - np.pi
    assert np.abs(off).max() < 0.01


def test_calibrations_are_checked():
    graph = JointGraph()
    with pytest.raises(SlamError, match='vehicle 0 has no start'):
        graph.add_calibration(0, DEVIATIONS)
    graph.add_start(0, 0, [0.0, 0.0, 0.0])
    with pytest.raises(SlamError, match='vehicle 0 has no calibration'):
        graph.add_keyframe(0, 1, STEP, NOISE, sensitivity=np.eye(3))
    for bad, message in (
        ([0.1, 0.0, 0.1], 'positive'),
        ([0.1, 0.1], 'shape'),
        ([0.1, np.nan, 1], 'finite'),
    ):
        with pytest.raises(SlamError, match=message):
            graph.add_calibration(0, bad)
    with pytest.raises(SlamError, match='vehicle 3 is not in the graph'):
        graph.calibration(3)
    assert graph.live_keyframes().tolist() == [0]
    assert graph.calibration(0).tolist() == [0.0, 0.0, 0.0]
    graph.add_calibration(0, DEVIATIONS)
    with pytest.raises(SlamError, match='sensitivity has shape'):
        graph.add_keyframe(0, 1, STEP, NOISE, sensitivity=np.eye(2))
    assert graph.live_keyframes().tolist() == [0]


def test_a_keyframe_whose_closure_is_dropped_stays_beside_what_it_closed_on(bounded_world):
    """Wheels that slide sideways and back on the second pass, which only closures show."""
    graph = bounded_world().graph
    graph.add_start(0, 0, [0.0, 0.0, 0.0])
    factors, slides = {}, {35: 0.5, 50: -0.5}
    for k in range(1, 75):
        spread = (4.0 if k > 30 else 1e-4) * NOISE
        graph.add_keyframe(0, k, [0.4, slides.get(k, 0.0), 0.0], spread)
        graph.pin(k)
        if 30 <= k <= 60:
            sharp = np.diag([1e4, 1e4, 1e4])
            factors[k] = graph.add_relative_pose(k - 30, k, [12.0, 0.0, 0.0], sharp, robust=False)
    graph.optimize()
    before = graph.path()
    assert np.abs(before[:, 1]).max() < 0.1
    for k in range(31, 59):
        graph.unpin(k)
        graph.drop_factor(factors[k])
    assert not np.isin(np.arange(31, 59), graph.live_keyframes()).any()
    np.testing.assert_array_equal(graph.path(), before)
    graph.optimize()
    np.testing.assert_allclose(graph.path(), before, atol=0.1)
    with pytest.raises(SlamError, match='not in the graph'):
        graph.drop_factor(factors[31])


def test_what_is_kept_of_a_posterior_gives_covariances_without_the_measurements(bounded_world):
    world = bounded_world()
    start(world, 1)
    lap(world, 1)
    graph = world.graph
    newest = int(graph.live_keyframes()[-1])
    solved = graph.solve(graph.snapshot(0))
    graph.adopt(solved)
    kept = graph.posterior(0)
    assert len(solved.problem.factors.kind) > LAP
    assert not len(kept.problem.factors.kind)
    np.testing.assert_array_equal(kept.covariance(newest), solved.covariance(newest))
