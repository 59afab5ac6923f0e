"""Vehicles without common observations have particles of their own; then groups merge."""

import dataclasses

import numpy as np
import pytest

from explore_slam.data import InterRobotObservation, LandmarkObservations
from explore_slam.errors import SlamError
from explore_slam.geometry import Pose2
from explore_slam.slam.particles.group import Groups
from explore_slam.slam.storage.row_store import RowStore

APART = {'a': Pose2(0.0, 0.0, 0.0), 'b': Pose2(40.0, 0.0, 0.0)}
STILL = Pose2(0.0, 0.0, 0.0)


def vehicles_of(slam):
    return [group.vehicles for group in slam.groups.all]


def seen_from(pose, points, stamp, first, deviation=0.02):
    """Return points (n, 2) as a vehicle at pose sees them, descriptors numbered from first."""
    random = np.random.default_rng(int(stamp))
    local = np.array([pose.inverse().compose(Pose2(x, y, 0.0))[:2] for x, y in points])
    positions = np.c_[local, np.full(len(points), 0.5)]
    positions += deviation * random.standard_normal(positions.shape)
    return LandmarkObservations(
        stamp,
        positions,
        np.tile(deviation**2 * np.eye(3), (len(points), 1, 1)),
        np.eye(128, dtype=np.float32)[first : first + len(points)],
    )


def look_around(slam, vehicle, pose, points, stamp, first, noise=1e-3):
    slam.predict(vehicle, STILL, noise * np.eye(3))
    return slam.update(vehicle, seen_from(pose, points, stamp, first))


HERE = [(3.0, -1.0), (3.0, 1.0), (4.0, 0.0)]
THERE = [(43.0, -1.0), (43.0, 1.0), (44.0, 0.0)]


def test_what_one_vehicle_sees_leaves_the_particles_of_another(make_slam):
    slam = make_slam(APART, correlated_observations=False)
    for step in range(4):
        look_around(slam, 'a', APART['a'], HERE, float(step), 0)
        slam.add_keyframe('a', float(step))
    poses, weights, path = slam.particle_poses('a'), slam.weights('a'), slam.best_path()
    resampled = [
        look_around(slam, 'b', APART['b'], THERE, float(step), 50).resampled for step in range(12)
    ]
    assert any(resampled)
    assert len(path) == 4
    slam.redraw([1])
    np.testing.assert_array_equal(slam.particle_poses('a'), poses)
    np.testing.assert_array_equal(slam.weights('a'), weights)
    np.testing.assert_array_equal(slam.best_path(), path)
    assert vehicles_of(slam) == [[0], [1]]
    assert len(slam.landmarks()) == 6


def test_a_landmark_of_another_vehicle_merges_the_groups(make_slam):
    starts = {'a': Pose2(0.0, 0.0, 0.0), 'b': Pose2(40.0, 0.0, 0.0), 'c': Pose2(1.0, 0.0, 0.0)}
    slam = make_slam(starts)
    for step in range(5):
        look_around(slam, 'a', starts['a'], HERE, float(step), 0)
        look_around(slam, 'b', starts['b'], THERE, float(step), 50)
    slam.add_keyframe('a', 4.0)
    slam.add_keyframe('b', 4.0)
    before = slam.best_path()[1]
    summary = look_around(slam, 'c', starts['c'], HERE, 5.0, 0)
    assert vehicles_of(slam) == [[0, 2], [1]]
    assert (summary.associated, summary.inserted) == (3, 0)
    assert summary.together == ('a', 'c')
    assert summary.effective_particles == pytest.approx(200)  # drawn by the observations
    assert len(slam.landmarks()) == 6
    np.testing.assert_array_equal(slam.best_path()[1], before)
    # the poses are correlated: observations of c determine the pose of a
    for step in range(6, 20):
        look_around(slam, 'c', starts['c'], HERE, float(step), 0)
    assert np.hypot(*slam.estimate('a')[0][:2]) < 0.05


def test_one_update_may_merge_three_groups(make_slam):
    near = Pose2(0.0, 0.0, 0.0)
    slam = make_slam({'a': near, 'b': near, 'c': near})
    others = [(3.0, -2.5), (3.0, 2.5)]
    for step in range(4):
        look_around(slam, 'a', near, HERE, float(step), 0)
        look_around(slam, 'b', near, others, float(step), len(HERE))
    assert vehicles_of(slam) == [[0], [1], [2]]
    summary = look_around(slam, 'c', near, HERE + others, 4.0, 0)
    assert vehicles_of(slam) == [[0, 1, 2]]
    assert (summary.associated, summary.inserted) == (5, 0)
    assert len(slam.landmarks()) == 5


def test_an_inter_robot_observation_merges_the_groups(make_slam):
    slam = make_slam(APART, particles=1000)
    for name in 'ab':
        slam.predict(name, STILL, np.diag([0.04, 0.04, 1e-6]))
        slam.update(name, seen_from(APART[name], [(APART[name].x + 60.0, 0.0)], 1.0, ord(name)))
    slam.update_inter_robot(
        'a', [InterRobotObservation(1.0, 'b', np.array([40.0, 0.0]), 1e-4 * np.eye(2))]
    )
    assert vehicles_of(slam) == [[0, 1]]
    apart = slam.particle_poses('b')[:, :2] - slam.particle_poses('a')[:, :2]
    assert np.abs(apart - [40.0, 0.0]).max() < 0.2


def test_a_rejected_call_does_not_merge(make_slam):
    slam = make_slam(APART)
    for step in range(3):
        look_around(slam, 'a', APART['a'], HERE, float(step), 0)
    slam.set_pose('b', STILL, 1e-4 * np.eye(3))
    slam.predict('b', STILL, np.diag([1e-4, 1e-4, 1.0]))  # the heading is sampled then
    before = slam.state_dict()
    seen = seen_from(STILL, HERE, 5.0, 0)
    seen = dataclasses.replace(seen, covariances=1e-150 * seen.covariances)
    with pytest.raises(SlamError, match='numbers overflow'):
        slam.update('b', seen)
    observation = InterRobotObservation(5.0, 'a', np.zeros(2), 1e200 * np.eye(2))
    with pytest.raises(SlamError, match='numbers overflow'):
        slam.update_inter_robot('b', [observation])
    after = slam.state_dict()
    assert vehicles_of(slam) == [[0], [1]]
    assert [name for name in before if not np.array_equal(before[name], after[name])] == []


def test_engine_paper_has_one_group(make_slam):
    assert vehicles_of(make_slam(APART, engine='paper')) == [[0, 1]]


def test_a_saved_state_continues_before_and_after_a_merge(make_slam):
    states = []
    for stop in (False, True):
        slam = make_slam(APART)
        for step in range(4):
            look_around(slam, 'a', APART['a'], HERE, float(step), 0)
            look_around(slam, 'b', APART['b'], THERE, float(step), 50)
            slam.add_keyframe('b', float(step))
        for step in range(4, 16):
            if stop:
                slam = type(slam).from_state(slam.state_dict())
            if step == 8:
                slam.set_pose('b', Pose2(0.5, 0.0, 0.0), 1e-2 * np.eye(3))
            place = APART['b'] if step < 8 else Pose2(0.5, 0.0, 0.0)
            points, first = (THERE, 50) if step < 8 else (HERE, 0)
            look_around(slam, 'b', place, points, float(step), first)
            assert len(slam.groups.all) == (2 if step < 8 else 1)
        states.append(slam.state_dict())
    for name, value in states[0].items():
        np.testing.assert_array_equal(value, states[1][name], err_msg=name)


def test_pairs_are_drawn_by_the_likelihood():
    """x ~ N(0, 1) in both groups, measured to differ by N(0, 0.05²): more pairs fit."""
    random = np.random.default_rng(3)
    particles = 1000
    groups = Groups(2, particles, joint=False)
    poses = np.zeros((2, particles, 3))
    poses[:, :, 0] = random.standard_normal((2, particles))
    store = RowStore(particles, 1)
    for number, group in enumerate(groups.all):  # a landmark at the pose, in each group
        addresses = store.allocate(1)
        store.workspace[addresses[0], 0] = poses[number, :, 0]
        store.commit(np.array([number]), addresses, group.tree)
    x, y = poses[0, :, 0].copy(), poses[1, :, 0].copy()

    def likelihood_of(apart):
        return -0.5 * (apart / 0.05) ** 2

    def likelihood(orders):
        return likelihood_of(x - y[orders[0]])

    ancestors = groups.merge(groups.all[0], groups.all[1:], likelihood, poses, random)
    (group,) = groups.all
    assert group.vehicles == [0, 1]
    np.testing.assert_array_equal(poses[0, :, 0], x[ancestors])
    np.testing.assert_array_equal(store.read(np.arange(2))[:, 0], poses[:, :, 0])
    apart = poses[0, :, 0] - poses[1, :, 0]
    assert apart.std() == pytest.approx(0.05, rel=0.2)
    assert poses[0, :, 0].var() == pytest.approx(0.5, rel=0.25)
    assert len(np.unique(poses[:, :, 0], axis=1).T) > 200  # 28 of 1000 random pairs fit
    # the weights are equal after the update with the same observation
    assert np.ptp(group.log_weights + likelihood_of(apart)) < 1e-9
