"""Particles as samples of the joint graph: what is recorded, drawn, deferred, merged and kept."""

import math

import numpy as np
import pytest

from explore_slam.data import InterRobotObservation, LandmarkObservations
from explore_slam.errors import SlamError
from explore_slam.geometry import Pose2, between
from explore_slam.slam import FastSlam
from explore_slam.slam.particles.joint_samples import JointSamples
from explore_slam.slam.particles.motion import Segment
from explore_slam.slam.storage.row_format import packed, unpacked

STARTS = {'a': Pose2(1.0, 1.0, 0.0), 'b': Pose2(5.0, 4.0, 1.0)}
STILL = Pose2(0.0, 0.0, 0.0)
UNBOUNDED = {'graph_bounded': False, 'correlated_observations': False}


def drawn(slam):
    """Redraw all vehicles; returns the group and the samples of the first."""
    slam.redraw(range(len(slam.vehicles)))
    group = slam.groups.of(0)
    (samples,) = group.samples
    return group, samples


def moments(poses):
    mean = poses.mean(axis=0)
    return mean, np.cov((poses - mean).T, bias=True)


# -- recording ----------------------------------------------------------------------------------


def test_every_measurement_is_recorded_once_and_raw(make_world, make_slam):
    world = make_world()
    slam = make_slam(world.start(**STARTS), **UNBOUNDED, redraw_fraction=0.0, redraw_ancestors=0)
    recorded, steps, seen_by = 0, 0, {}
    for step in range(6):
        for vehicle in 'ab':
            world.drive(vehicle, Pose2(0.4, 0.0, 0.3))
            for part in range(2):  # two increments between updates become one motion
                slam.predict(vehicle, Pose2(0.2, 0.0, 0.15), (part + 1) * 1e-4 * np.eye(3))
            seen = world.see(vehicle, float(step))
            summary = slam.update(vehicle, seen)
            recorded += summary.associated + summary.inserted
            steps += 1
            seen_by[vehicle] = seen, summary.matches
            for stamp in (0.2, 0.4):  # keyframes of the path without motion add no node
                slam.add_keyframe(vehicle, step + stamp)
    graph = slam.joint.graph
    ids, stored = graph.observations_from([0, 1])
    assert len(stored.z) == recorded
    assert len(graph.live_keyframes()) == steps + 2
    assert len(ids) == len(slam.map)
    seen, matches = seen_by['b']
    newest = graph.live_keyframes()[-1]
    for number, z, R in zip(matches, seen.positions, packed(seen.covariances), strict=True):
        if number < 0:
            continue
        one = graph.observations_of([number])
        mine = np.flatnonzero(one.keyframes == newest)
        np.testing.assert_array_equal(one.z[mine], z[None])
        np.testing.assert_allclose(
            unpacked(one.W[mine])[0] @ unpacked(R[None])[0], np.eye(3), atol=1e-6
        )


def test_motions_between_updates_are_compounded_once(make_slam):
    slam = make_slam({'a': STARTS['a']})
    steps = [Pose2(0.3, 0.1, 0.4), Pose2(0.5, 0.0, -0.2), Pose2(0.1, -0.1, 0.3)]
    for step in steps:
        slam.predict('a', step, 1e-4 * np.eye(3))
    slam.add_keyframe('a', 1.0)
    slam.predict('a', steps[0], 1e-4 * np.eye(3))
    slam.add_keyframe('a', 2.0)
    expected = STARTS['a']
    for step in steps:
        expected = expected.compose(step)
    path = slam.best_path()
    np.testing.assert_allclose(path[0], expected, atol=1e-9)
    np.testing.assert_allclose(path[1], expected.compose(steps[0]), atol=1e-9)
    slam.redraw([0])
    np.testing.assert_allclose(slam.best_path(), path, atol=1e-6)


# -- drawing ------------------------------------------------------------------------------------


@pytest.mark.parametrize('seed', [0, 1, 2])
def test_samples_have_mean_and_covariance_of_the_graph(make_world, make_slam, drive_circles, seed):
    """Before the redraw the particles of a short run agree with it too; afterwards exactly."""
    world = make_world(seed)
    values = {'particles': 3000, 'independent_observations': 1e6} | UNBOUNDED
    slam = make_slam(world.start(a=STARTS['a']), seed, **values)
    drive_circles(slam, world, 5)
    before, spread = slam.estimate('a')
    group, samples = drawn(slam)
    assert group.effective_particles() == pytest.approx(3000)
    newest = int(samples.keyframes[-1])
    exact, covariance = slam.joint.graph.estimate(newest), slam.joint.graph.covariance(newest)
    after, resampled = slam.estimate('a')
    # antithetic pairs: the mean is the optimum but for the curvature of headings
    deviations = np.sqrt(np.diag(covariance))
    assert (np.abs(between(exact, after)) < 0.01 * deviations).all()
    np.testing.assert_allclose(np.sqrt(np.diag(resampled)), deviations, rtol=0.06)
    correlation = covariance / np.outer(deviations, deviations)
    found = resampled / np.outer(deviations, deviations)
    np.testing.assert_allclose(found, correlation, atol=0.12)
    # the filter's own particles: the same posterior, sampled step by step
    assert (np.abs(between(exact, before)) < 0.5 * deviations).all()
    np.testing.assert_allclose(np.sqrt(np.diag(spread)), deviations, rtol=0.3)


def test_whole_paths_are_drawn_jointly(make_world, make_slam, drive_circles):
    """The relative pose of two keyframes is far better known than either of them."""
    world = make_world()
    slam = make_slam(world.start(a=STARTS['a']), particles=2000, **UNBOUNDED)
    slam.set_pose('a', STARTS['a'], np.diag([0.25, 0.25, 4e-4]))
    drive_circles(slam, world, 6)
    _, samples = drawn(slam)
    newest, other = (int(n) for n in samples.keyframes[[-1, -3]])
    poses = [samples.pose_of(n) for n in (other, newest)]
    assert poses[0][:, 0].std() > 0.3
    relative = between(poses[0], poses[1])
    expected = slam.joint.graph.relative_covariance(other, [newest])[0]
    np.testing.assert_allclose(
        np.sqrt(np.diag(moments(relative)[1])), np.sqrt(np.diag(expected)), rtol=0.1
    )
    np.testing.assert_array_equal(slam.particle_poses('a'), poses[1])


def test_rows_are_the_product_of_the_stored_observations(make_world, make_slam, drive_circles):
    world = make_world()
    slam = make_slam(world.start(**STARTS), **UNBOUNDED)
    drive_circles(slam, world, 8)
    _, samples = drawn(slam)
    counts = np.diff(samples.observations.first)
    ids = samples.ids[[int(np.argmax(counts)), int(np.argmin(counts)), 3]]
    rows = samples.fused(ids)
    stored = slam.joint.graph.observations_of(ids)
    for n in range(len(ids)):
        for m in (0, 7, 150):
            information, vector = np.zeros((3, 3)), np.zeros(3)
            for o in range(stored.first[n], stored.first[n + 1]):
                x, y, theta = samples.pose_of(int(stored.keyframes[o]))[m]
                c, s = math.cos(theta), math.sin(theta)
                turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
                W = turn @ unpacked(stored.W[o][None])[0] @ turn.T
                information += W
                vector += W @ (turn @ stored.z[o] + [x, y, 0.0])
            mean = np.linalg.solve(information, vector)
            np.testing.assert_allclose(rows[n, :3, m], mean, atol=1e-9)
            np.testing.assert_allclose(
                unpacked(rows[n, 3:, m][None])[0], np.linalg.inv(information), atol=1e-12
            )


def test_rows_follow_the_sample_that_a_particle_descends_from(
    make_world, make_slam, drive_circles
):
    world = make_world()
    slam = make_slam(world.start(a=STARTS['a']), **UNBOUNDED)
    drive_circles(slam, world, 6)
    group, samples = drawn(slam)
    whole = samples.fused(samples.ids)
    ancestors = np.random.default_rng(0).integers(0, 200, 200).astype(np.int32)
    group.resample(ancestors)
    np.testing.assert_array_equal(samples.fused(samples.ids), whole[:, :, ancestors])


def test_motion_since_the_newest_keyframe_is_still_to_come(make_world, make_slam, drive_circles):
    world = make_world()
    slam = make_slam(world.start(a=STARTS['a']), **UNBOUNDED)
    drive_circles(slam, world, 6)
    slam.redraw([0])
    before, spread = slam.estimate('a')
    noise = np.diag([0.04, 0.01, 1e-6])
    slam.predict('a', Pose2(1.0, 0.0, 0.0), noise)
    moved, more = slam.estimate('a')
    slam.redraw([0])
    pose, covariance = slam.estimate('a')
    np.testing.assert_allclose(pose, moved, atol=0.01)
    assert np.hypot(pose.x - before.x, pose.y - before.y) == pytest.approx(1.0, abs=0.02)
    np.testing.assert_allclose(covariance, more, atol=0.02 * np.trace(more))
    assert np.trace(covariance) > np.trace(spread) + 0.045


# -- lineage ------------------------------------------------------------------------------------


def test_lineage_follows_resampling(make_slam):
    slam = make_slam({'a': STARTS['a']}, particles=8)
    slam.predict('a', Pose2(0.5, 0.0, 0.1), np.diag([0.01, 0.01, 0.01]))
    slam.add_keyframe('a', 0.0)
    group, samples = drawn(slam)
    poses = samples.pose_of(int(samples.keyframes[-1]))
    np.testing.assert_array_equal(slam.particle_poses('a'), poses)
    first = np.array([0, 0, 2, 3, 3, 3, 6, 7], np.int32)
    second = np.array([1, 1, 1, 2, 5, 5, 6, 6], np.int32)
    group.resample(first)
    group.resample(second)
    assert samples.lineage.tolist() == [0, 0, 0, 2, 3, 3, 6, 6]
    assert samples.distinct() == 4
    np.testing.assert_array_equal(
        samples.pose_of(int(samples.keyframes[-1])), poses[samples.lineage]
    )
    again = JointSamples.from_state(samples.state_dict())
    np.testing.assert_array_equal(again.lineage, samples.lineage)
    np.testing.assert_array_equal(again.pose_of(1), samples.pose_of(1))


def test_a_redraw_is_due_when_few_ancestors_or_few_effective_particles_are_left(make_slam):
    values = {'redraw_fraction': 0.1, 'redraw_ancestors': 50, 'redraw_effective': 0.05}
    slam = make_slam({'a': STARTS['a']}, particles=400, **values)
    group, _ = drawn(slam)
    assert slam.joint.is_fresh(group)
    assert not slam.joint.is_due(group)

    def resample(distinct):
        group.resample(np.minimum(np.arange(400), distinct - 1).astype(np.int32))

    resample(201)
    assert slam.joint.is_fresh(group)
    resample(200)
    assert not slam.joint.is_fresh(group)
    resample(50)
    assert not slam.joint.is_due(group)
    resample(49)
    assert slam.joint.is_due(group)
    group, _ = drawn(slam)
    weights = np.full(400, 1e-9)
    weights[:20] = 1.0
    group.reweight(np.log(weights))
    assert not slam.joint.is_due(group)
    weights[19] = 1e-9
    group, _ = drawn(slam)
    group.reweight(np.log(weights))
    assert slam.joint.is_due(group)


def test_few_particles_are_not_redrawn_at_every_update(make_slam):
    """redraw_ancestors beyond the number of particles means three tenths of them."""
    slam = make_slam({'a': STARTS['a']}, particles=20)
    group, _ = drawn(slam)
    group.resample(np.minimum(np.arange(20), 5).astype(np.int32))
    assert not slam.joint.is_due(group)
    group.resample(np.minimum(np.arange(20), 4).astype(np.int32))
    assert slam.joint.is_due(group)


# -- landmarks ----------------------------------------------------------------------------------


def test_rows_wait_until_they_are_needed(make_world, make_slam, drive_circles):
    world = make_world()
    slam = make_slam(world.start(a=STARTS['a']), **UNBOUNDED)
    drive_circles(slam, world, 12)
    count = len(slam.map)
    _, samples = drawn(slam)
    entries = slam.map.entries()
    assert len(entries) == count
    assert (slam.map.draw[entries] == samples.number).all()
    # what is published of them is given the most likely path
    landmarks = slam.landmarks()
    expected = samples.fused_at_mean(landmarks.ids)
    np.testing.assert_array_equal(landmarks.means, expected[:, :3])
    np.testing.assert_allclose(slam.map.reference[entries], expected[:, :3])
    slam.predict('a', STILL, np.zeros((3, 3)))
    rows = samples.fused(landmarks.ids)
    summary = slam.update('a', world.see('a', 12.0))
    assert summary.associated > 3
    waiting = slam.map.draw[entries] >= 0
    assert waiting.any()
    assert (~waiting).sum() >= summary.associated
    # those in view but not observed again are what the samples say, column by column
    near = np.setdiff1d(
        landmarks.ids[~waiting[np.argsort(slam.map.ids[entries])]], summary.matches
    )
    if not summary.resampled and len(near):
        found = slam.map.rows.read(slam.map.entries_with(near))
        np.testing.assert_array_equal(found, rows[np.isin(landmarks.ids, near)])


def test_landmarks_of_which_nothing_is_stored_are_removed(make_world, make_slam, drive_circles):
    world = make_world()
    slam = make_slam(world.start(a=STARTS['a']), correlated_observations=False)
    drive_circles(slam, world, 10)
    landmarks = slam.landmarks()
    gone = landmarks.ids[:3]
    slam.joint.graph.remove_landmarks(gone)
    drawn(slam)
    np.testing.assert_array_equal(slam.landmarks().ids, landmarks.ids[3:])
    slam.predict('a', STILL, np.zeros((3, 3)))
    assert slam.update('a', world.see('a', 10.0)).associated > 0


def test_landmarks_removed_from_the_map_are_removed_from_the_graph(make_slam):
    """A ghost in front of a wall loses its evidence; nothing of it comes back by a redraw."""
    slam = make_slam({'a': STILL}, existence_miss=0.3)
    wall = np.array([[5.0, y, z] for y in np.linspace(-1.0, 1.0, 9) for z in (0.2, 0.45, 0.7)])
    points = np.vstack([[1.5, 0.1, 0.1], wall, [4.0, 0.0, 0.45]])  # near, wall, ghost

    def look(stamp, count):
        covariances = np.tile(1e-4 * np.eye(3), (count, 1, 1))
        descriptors = np.eye(128, dtype=np.float32)[:count]
        slam.predict('a', STILL, 1e-8 * np.eye(3))
        return slam.update(
            'a', LandmarkObservations(stamp, points[:count], covariances, descriptors)
        )

    look(0.0, len(points))
    ghost = int(slam.landmarks().ids[-1])
    assert len(slam.joint.graph.observations_of([ghost]).z) == 1
    removed = [look(float(stamp), len(points) - 1).removed for stamp in range(1, 7)]
    assert sum(removed) == 1
    assert len(slam.joint.graph.observations_of([ghost]).z) == 0
    drawn(slam)
    assert ghost not in slam.landmarks().ids
    assert len(slam.map) == len(points) - 1


# -- groups -------------------------------------------------------------------------------------


def test_groups_that_merge_keep_both_draws_until_the_next(make_world, make_slam):
    world = make_world()
    starts = {'a': Pose2(1.0, 3.0, 0.0), 'b': Pose2(6.0, 3.0, math.pi)}
    slam = make_slam(world.start(**starts))

    def look(vehicle, stamp, reach):
        slam.predict(vehicle, STILL, 1e-4 * np.eye(3))
        return slam.update(vehicle, world.see(vehicle, stamp, reach))

    for vehicle in 'ab':
        look(vehicle, 0.0, 2.4)
        slam.redraw([slam.vehicles.index(vehicle)])
    numbers = [group.samples[0].number for group in slam.groups.all]
    assert len(slam.groups.all) == 2
    assert slam.joint.graph.tied(0) == {0}
    summary = look('b', 1.0, 4.5)
    assert summary.together == ('a', 'b')
    (group,) = slam.groups.all
    if not summary.redrawn:
        assert sorted(samples.number for samples in group.samples) == numbers
        # landmarks of both draws that nobody has looked at since are still fused from them
        entries = slam.map.entries()
        waiting = slam.map.draw[entries]
        assert set(waiting[waiting >= 0]) <= set(numbers)
        assert len(slam.landmarks()) == len(slam.map)
    assert slam.joint.graph.tied(0) == {0, 1}
    slam.redraw([1])
    (group,) = slam.groups.all
    assert len(group.samples) == 1
    assert group.vehicles == [0, 1]
    assert len(group.trees) == 1
    assert (slam.map.draw[slam.map.entries()] == group.samples[0].number).all()
    assert look('a', 1.0, 3.5).associated > 0


def test_vehicles_apart_are_drawn_apart(make_world, make_slam):
    world = make_world()
    slam = make_slam(world.start(a=Pose2(1.0, 3.0, 0.0), b=Pose2(6.0, 3.0, 0.0)))
    for vehicle in 'ab':
        slam.predict(vehicle, STILL, 1e-4 * np.eye(3))
        slam.update(vehicle, world.see(vehicle, 0.0, 2.0))
    before = slam.particle_poses('a'), slam.weights('a'), slam.landmarks()
    slam.redraw([1])
    assert [group.samples[0].number for group in slam.groups.all] == [0, 2]
    np.testing.assert_array_equal(slam.particle_poses('a'), before[0])
    np.testing.assert_array_equal(slam.weights('a'), before[1])
    mine = before[2].owners == 0
    np.testing.assert_array_equal(
        slam.landmarks().means[slam.landmarks().owners == 0], before[2].means[mine]
    )


def test_an_inter_robot_observation_is_a_factor_between_two_vehicles(make_slam):
    slam = make_slam({'a': Pose2(0.0, 0.0, 0.0), 'b': Pose2(2.0, 0.0, 0.0)}, particles=1000)
    slam.predict('b', Pose2(0.5, 0.0, 0.0), np.diag([0.3, 0.3, 0.1]) ** 2)
    slam.predict('a', Pose2(0.0, 0.0, 0.0), np.zeros((3, 3)))
    observation = InterRobotObservation(0.0, 'b', np.array([2.8, 0.1]), 0.01**2 * np.eye(2))
    slam.update_inter_robot('a', [observation])
    assert slam.joint.graph.tied(0) == {0, 1}
    slam.redraw([0])
    (group,) = slam.groups.all
    assert group.vehicles == [0, 1]
    pose, covariance = slam.estimate('b')
    np.testing.assert_allclose(pose[:2], [2.8, 0.1], atol=0.02)
    assert np.sqrt(covariance[0, 0]) == pytest.approx(0.01, rel=0.2)
    count = len(slam.joint.graph.closure_residuals()[0])
    # the same from the same place a moment later repeats it: left out of the graph
    again = InterRobotObservation(0.1, 'b', np.array([2.8, 0.1]), 0.01**2 * np.eye(2))
    slam.update_inter_robot('a', [again])
    assert len(slam.joint.graph.closure_residuals()[0]) == count


# -- closing loops ------------------------------------------------------------------------------

NOISE = np.diag([0.02, 0.005, 0.03]) ** 2  # of one step of 0.5 m


def ring(world, side):
    """Place landmarks along a square corridor; returns the poses of one lap, 0.5 m apart."""
    ways = np.arange(0.0, 4 * side, 0.5)
    leg, along = np.divmod(ways, side)
    heading = 0.5 * np.pi * leg
    corners = np.array([[0, 0], [side, 0], [side, side], [0, side]])[leg.astype(int)]
    path = corners + along[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    places = np.repeat(path[::2], 2, axis=0) + world.random.uniform(-1.5, 1.5, (len(path), 2))
    world.points = np.c_[places, world.random.uniform(0, 1, len(places))]
    world.descriptors = world.random.standard_normal((len(places), 128)).astype(np.float32)
    world.descriptors /= np.linalg.norm(world.descriptors, axis=1, keepdims=True)
    return [Pose2(*pose) for pose in np.c_[path, heading]]


def drive_ring(slam, world, path, steps):
    """Steer by truth along the path; returns updates, squared errors over covariance (NEES)."""
    summaries, nees = [], []
    for step in range(1, steps + 1):
        increment = world.true['a'].inverse().compose(path[step % len(path)])
        sample = np.linalg.cholesky(NOISE) @ world.random.standard_normal(3)
        world.true['a'] = world.true['a'].compose(Pose2(*(np.asarray(increment) + sample)))
        slam.predict('a', increment, NOISE)
        summaries.append(slam.update('a', world.see('a', float(step), 3.0)))
        pose, covariance = slam.estimate('a')
        error = world.error('a', pose)
        nees.append(error @ np.linalg.solve(covariance, error))
    return summaries, np.array(nees)


@pytest.mark.parametrize('seed', [0, 1, 2])
def test_a_late_return_closes_the_loop(make_world, make_slam, seed):
    """After 80 m all particles have one ancestor and its error: landmarks lie outside the gates.

    Without redraws they are inserted a second time.
    """
    duplicates, errors = {}, {}
    for joint in (True, False):
        world = make_world(seed, deviation=0.05)
        path = ring(world, 20.0)
        slam = make_slam(world.start(a=path[0]), seed, joint_graph=joint)
        summaries, nees = drive_ring(slam, world, path, len(path) + 16)
        duplicates[joint] = len(slam.map) - len(world.points)
        errors[joint] = nees[-8:].mean()
        if joint:
            assert any(summary.redrawn for summary in summaries)
            back = summaries[-10:]
            matched = sum(summary.associated for summary in back)
            assert matched > 0.8 * sum(summary.observed for summary in back)
            assert nees.mean() < 8.0
    assert duplicates[True] <= 2
    assert errors[True] < 12.0
    assert duplicates[False] > duplicates[True] or errors[False] > 5 * errors[True]


def test_contradicted_particles_are_redrawn_before_the_update(make_world, make_slam):
    """The particles agree on a wrong pose with certainty, the graph knows better."""
    world = make_world(0, deviation=0.05)
    path = ring(world, 6.0)
    slam = make_slam(world.start(a=path[0]), redraw_fraction=0.0, redraw_ancestors=0)
    drive_ring(slam, world, path, len(path))
    group = slam.groups.of(0)
    group.resample(np.zeros(200, np.int32))  # one ancestor, all alike
    arrays = slam._team.particles.arrays
    arrays[0] = arrays[0][:1]
    arrays[0, :, 0] += 0.5
    assert np.trace(slam.estimate('a')[1]) < 1e-12
    draws, count = slam.joint.draws, len(slam.map)
    slam.predict('a', STILL, 1e-8 * np.eye(3))
    summary = slam.update('a', world.see('a', 1e3, 3.0))
    assert slam.joint.draws == draws + 1
    assert summary.associated > 0.8 * summary.observed
    assert len(slam.map) <= count + 1
    assert np.abs(world.error('a', slam.estimate('a')[0])[:2]).max() < 0.2


# -- restarts -----------------------------------------------------------------------------------


def test_no_motion_leads_to_a_pose_that_was_given(make_world, make_slam, drive_circles):
    """Carried elsewhere, the vehicle goes on from there, and its past stays as it was."""
    world = make_world()
    slam = make_slam(world.start(a=STARTS['a']), correlated_observations=False)
    drive_circles(slam, world, 12)
    drawn(slam)
    past = slam.best_path()
    before = slam.joint.graph.covariance(int(slam.joint.graph.live_keyframes()[-1]))
    slam.predict('a', Pose2(3.0, 1.0, 0.7), 1e-6 * np.eye(3))  # what it is carried, as it measures
    elsewhere, spread = Pose2(60.0, -40.0, 2.0), np.diag([0.04, 0.01, 0.02])
    slam.set_pose('a', elsewhere, spread)
    node = int(slam.joint.graph.live_keyframes()[-1])
    np.testing.assert_allclose(slam.joint.graph.estimate(node), elsewhere)
    slam.predict('a', Pose2(1.0, 0.0, 0.0), 1e-6 * np.eye(3))
    slam.add_keyframe('a', 13.0)
    drawn(slam)
    np.testing.assert_allclose(slam.best_path()[:-1], past, atol=1e-6)
    pose, covariance = slam.estimate('a')
    assert pose == pytest.approx(elsewhere.compose(Pose2(1.0, 0.0, 0.0)), abs=0.05)
    np.testing.assert_allclose(covariance[2, 2], 0.02, rtol=0.45)  # 3 σ of 100 pairs
    np.testing.assert_allclose(slam.joint.graph.covariance(node), spread, rtol=1e-3, atol=1e-9)
    last = int(slam.joint.graph.live_keyframes()[-3])
    # each is linearized a small step away from the optimum
    after = slam.joint.graph.covariance(last)
    np.testing.assert_allclose(after, before, atol=3e-3 * np.abs(before).max())


def test_a_wrong_pose_that_was_given_is_corrected_by_landmarks(
    make_world, make_slam, drive_circles
):
    world = make_world()
    slam = make_slam(world.start(a=STARTS['a']))
    drive_circles(slam, world, 20)
    off = world.true['a'].compose(Pose2(0.3, -0.2, 0.2))
    slam.set_pose('a', off, np.diag([0.1, 0.1, 0.05]))
    errors = drive_circles(slam, world, 15, first=20)
    drawn(slam)
    assert np.abs(errors[-5:, 0, :2]).max() < 0.15
    assert np.abs(world.error('a', slam.estimate('a')[0])[:2]).max() < 0.15
    assert len(slam.map) <= 60 + 3


# -- bounds, state, determinism -----------------------------------------------------------------


def test_path_and_map_are_bounded_by_the_area(make_world, make_slam):
    """Ten laps of a ring: nothing but the list of keyframes grows after the third."""
    world = make_world(1, deviation=0.05)
    path = ring(world, 4.0)
    slam = make_slam(world.start(a=path[0]), particles=100, correlated_observations=False)
    sizes = []
    for _ in range(10):
        drive_ring(slam, world, path, len(path))
        slam.restart_clock('a')
        graph = slam.joint.graph
        state = slam.state_dict()
        sizes.append(
            (
                len(graph.live_keyframes()),
                len(graph.observations_from([0])[1].z),
                len(slam.map),
                sum(value.nbytes for name, value in state.items() if 'samples' in name),
            )
        )
        kept = [value.nbytes for name, value in state.items() if name.startswith('path/rows')]
        assert sum(kept) < 1000
    sizes = np.array(sizes)
    assert (sizes[9] <= 1.15 * sizes[2]).all(), sizes
    keyframes = state['joint/graph/storage/keyframes/number']
    assert len(keyframes) == 10 * len(path) + 1


def test_what_is_seen_only_once_is_forgotten_everywhere(make_world, make_slam):
    """Five features of every frame are never seen again, as real images have them."""
    world = make_world(1, deviation=0.05)
    path = ring(world, 4.0)
    slam = make_slam(world.start(a=path[0]), particles=100, correlated_observations=False)
    see, random = world.see, np.random.default_rng(0)

    def see_more(vehicle, stamp, reach):
        seen = see(vehicle, stamp, reach)
        places = random.uniform([0.5, -1.0, 0.0], [2.5, 1.0, 1.0], (5, 3))
        vectors = random.standard_normal((5, 128)).astype(np.float32)
        return LandmarkObservations(
            stamp,
            np.vstack([seen.positions, places]),
            np.concatenate([seen.covariances, np.tile(0.0025 * np.eye(3), (5, 1, 1))]),
            np.vstack([seen.descriptors, vectors / np.linalg.norm(vectors, axis=1)[:, None]]),
        )

    world.see = see_more
    sizes = []
    for _ in range(6):
        drive_ring(slam, world, path, len(path))
        slam.restart_clock('a')
        state = slam.state_dict()
        stored = state['joint/graph/storage/landmarks/number'] >= 0
        visits = state['joint/graph/storage/visits']
        sizes.append((len(slam.map), np.count_nonzero(stored), len(visits)))
    sizes = np.array(sizes)
    assert (sizes[5] <= 1.2 * sizes[2]).all(), sizes
    assert (sizes[:, 1] <= sizes[:, 0] + 5 * 8).all(), sizes


@pytest.mark.parametrize('threads', [1, 2])
def test_a_saved_state_continues_bit_by_bit_through_redraws(
    make_world, make_slam, drive_circles, threads
):
    states, draws = [], []
    for stop in (False, True):
        world = make_world()
        slam = make_slam(world.start(**STARTS), particles=60, filter_threads=threads)
        drive_circles(slam, world, 14)
        slam.predict('a', Pose2(0.1, 0.0, 0.05))  # wheels, pending
        if stop:
            slam = FastSlam.from_state(slam.state_dict())
        draws.append(slam.joint.draws)
        drive_circles(slam, world, 14, first=14)
        slam.redraw([0])
        slam.predict('b', Pose2(0.1, 0.0, 0.05))
        slam.update('b', world.see('b', 100.0))
        states.append(slam.state_dict())
        draws.append(slam.joint.draws)
    assert draws[0] > 3
    assert draws[1] > draws[0] + 3
    assert states[0].keys() == states[1].keys()
    for name, value in states[0].items():
        np.testing.assert_array_equal(value, states[1][name], err_msg=name)


def test_the_number_of_threads_changes_no_bit(make_world, make_slam, drive_circles):
    states = []
    for threads in (1, 2):
        world = make_world()
        slam = make_slam(world.start(**STARTS), particles=150, filter_threads=threads)
        drive_circles(slam, world, 16)
        assert slam.joint.draws > 3
        states.append(slam.state_dict())
    for name, value in states[0].items():
        if name != 'about':  # the settings differ
            np.testing.assert_array_equal(value, states[1][name], err_msg=name)


# -- what is refused ----------------------------------------------------------------------------


def test_without_a_graph_there_is_nothing_to_redraw(make_slam):
    for values in ({'engine': 'paper'}, {'joint_graph': False}):
        slam = make_slam(STARTS, **values)
        before = slam.state_dict()
        with pytest.raises(SlamError, match='redraws and closures need the setting joint_graph'):
            slam.redraw([0])
        after = slam.state_dict()
        assert all(np.array_equal(before[name], after[name]) for name in before)


def test_a_graph_without_an_optimum_leaves_the_particles(make_slam, make_world):
    """A pose known to 10¹⁵ m, then an exact motion: rounding decides whether both fit together."""
    refused = 0
    for k in range(12):
        world = make_world()
        slam = make_slam(world.start(a=Pose2(1.0, 1.0, 0.3 * k)), particles=20)
        slam.set_pose('a', world.true['a'], 1e30 * np.eye(3))
        slam.predict('a', Pose2(1.0, 0.0, 0.1 * k), 1e-12 * np.eye(3))
        slam.add_keyframe('a', 1.0)
        before = slam.state_dict()
        try:
            slam.redraw([0])
        except SlamError:
            refused += 1
            after = slam.state_dict()
            assert [n for n in before if not np.array_equal(before[n], after[n])] == []
            slam.groups.of(0).resample(np.zeros(20, np.int32))
            assert slam.joint.is_due(slam.groups.of(0))
            slam.set_pose('a', world.true['a'], 1e-4 * np.eye(3))
            assert not slam.update('a', world.see('a', 1.0)).redrawn
            assert np.abs(world.error('a', slam.estimate('a')[0])).max() < 0.05
    assert refused > 0


def test_a_redraw_beside_the_caller_that_finds_no_optimum_is_told(make_slam, make_world, caplog):
    for k in range(12):
        world = make_world()
        start = world.start(a=Pose2(1.0, 1.0, 0.3 * k))
        slam = make_slam(start, particles=20, async_redraw_threshold=0)
        slam.set_pose('a', world.true['a'], 1e30 * np.eye(3))
        slam.predict('a', Pose2(1.0, 0.0, 0.1 * k), 1e-12 * np.eye(3))
        slam.add_keyframe('a', 1.0)
        draws = slam.redraws
        assert slam._redrawer.redraw_soon([0])
        slam._redrawer.complete_pending()
        told = 'paths of a are not drawn anew' in caplog.text
        assert told == (slam.redraws == draws)
        if told:
            return
    raise AssertionError('all of them had an optimum')


def test_rejected_calls_leave_graph_and_random_stream(make_world, make_slam, drive_circles):
    world = make_world()
    slam = make_slam(world.start(**STARTS))
    drive_circles(slam, world, 6)
    slam.predict('a', Pose2(0.1, 0.0, 0.0))
    good = world.see('a', 50.0)
    thin = good.covariances.copy()
    thin[0] = np.diag([1.0, 1.0, 1.5e-10])  # the graph could not invert it
    skew = InterRobotObservation(50.0, 'b', np.ones(2), np.array([[1.0, 0.5], [0.0, 1.0]]))
    before = slam.state_dict()
    calls = [
        lambda: slam.update('a', LandmarkObservations(
            50.0, good.positions, thin, good.descriptors
        )),
        lambda: slam.update_inter_robot('a', [skew]),
        lambda: slam.set_pose('a', Pose2(0.0, np.inf, 0.0), np.eye(3)),
        lambda: slam.set_pose('a', STILL, -np.eye(3)),
        lambda: slam.predict('a', Pose2(0.0, 0.0, np.nan)),
    ]  # fmt: skip
    for call in calls:
        with pytest.raises(SlamError):
            call()
        after = slam.state_dict()
        assert [n for n in before if not np.array_equal(before[n], after[n])] == []


def test_a_motion_is_appended_to_the_graph_as_the_filter_has_it(make_slam):
    slam = make_slam({'a': STARTS['a']})
    for _ in range(30):
        slam.predict('a', Pose2(0.3, 0.0, 0.2))
    total = slam._team.particles.pending[0].total()
    recorded = slam.joint._motions[0].motion.total()
    for mine, theirs in zip(total, recorded, strict=True):
        np.testing.assert_array_equal(mine, theirs)
    assert isinstance(total, Segment)


@pytest.mark.parametrize('seed', [1, 4])
def test_a_look_alike_that_the_filter_takes_for_an_outlier_is_one_in_the_graph(make_slam, seed):
    random = np.random.default_rng(seed)

    def scatter(count, low, high):
        across, height = random.uniform(-1, 1, count), random.uniform(0, 1, count)
        return np.c_[random.uniform(low, high, count), across, height]

    # What is far away is known from the start, what is near only from the second pose on, but for
    # one landmark, of which the third pose sees a look-alike.
    points = np.vstack([scatter(30, 2.5, 3.5), scatter(12, 1.2, 1.8), [[1.2, 0.3, 0.0]]])
    deviations = np.array([0.02] * 30 + [0.003] * 13)
    descriptors = np.eye(43, 128, dtype=np.float32)
    everything = {'graph_observations_per_keyframe': 1000}
    slam = make_slam({'a': Pose2(0.0, 0.0, 0.0)}, seed, **everything)

    def see(stamp, x, chosen, moved=(0.0, 0.0)):
        positions = points - [x, 0.0, 0.0] + deviations[:, None] * random.standard_normal((43, 3))
        positions[42, :2] += moved
        covariances = deviations[:, None, None] ** 2 * np.eye(3)
        return LandmarkObservations(
            stamp, positions[chosen], covariances[chosen], descriptors[chosen]
        )

    step = Pose2(0.3, 0.0, 0.0), np.diag([0.03, 0.03, 0.02]) ** 2
    slam.predict('a', STILL, 1e-10 * np.eye(3))
    slam.update('a', see(0.0, 0.0, np.r_[:30, 42]))
    slam.predict('a', *step)
    slam.update('a', see(1.0, 0.3, np.r_[:42]))
    slam.predict('a', *step)
    summary = slam.update('a', see(2.0, 0.6, np.r_[:43], (0.045, 0.06)))
    assert summary.associated == 43  # the gate is as wide as the odometry is uncertain
    slam.redraw([0])
    pose, covariance = slam.estimate('a')
    error = np.array([pose.x - 0.6, pose.y, pose.theta])
    assert error @ np.linalg.solve(covariance, error) < 7.8  # 95 % of three degrees of freedom
