import dataclasses

import numpy as np
import pytest

from explore_slam.data import LandmarkObservations
from explore_slam.errors import SlamError
from explore_slam.geometry import Pose2, to_world
from explore_slam.slam import FastSlamConfig

STARTS = {'a': Pose2(1.0, 1.0, 0.0), 'b': Pose2(5.0, 4.0, 1.0)}


def rms(errors):
    return np.sqrt((errors[..., :2] ** 2).sum(-1).mean()), np.sqrt((errors[..., 2] ** 2).mean())


def test_fastslam2_keeps_two_vehicles_on_course(make_world, make_slam, drive_circles):
    world = make_world()
    slam = make_slam(world.start(**STARTS))
    position, heading = rms(drive_circles(slam, world, 60))
    assert position < 0.1
    assert heading < 0.03
    landmarks = slam.landmarks()
    assert 10 < len(landmarks) <= 60
    true = world.points[np.argmax(landmarks.descriptors @ world.descriptors.T, axis=1)]
    assert np.linalg.norm(landmarks.means - true, axis=1).mean() < 0.12
    assert (landmarks.covariances[:, 0, 0] > 0.0).all()
    assert set(landmarks.owners) == {0, 1}


def test_paper_engine_beats_odometry(make_world, make_slam, drive_circles):
    world = make_world(deviation=0.1)
    starts = world.start(a=STARTS['a'])
    slam = make_slam(starts, engine='paper', particles=1000, minimum_association_probability=0.05)
    dead = starts['a']
    errors, dead_errors = [], []
    for step in range(60):
        errors.append(drive_circles(slam, world, 1, step)[0, 0])
        dead = dead.compose(Pose2(0.4, 0.0, 0.3))
        dead_errors.append(world.error('a', dead))
    assert rms(np.array(errors))[0] < 0.5 * rms(np.array(dead_errors))[0]


def test_paper_engine_multiplies_the_weights_of_all_vehicles_before_resampling(
    make_world, make_slam, drive_circles
):
    world = make_world()
    slam = make_slam(world.start(**STARTS), engine='paper', minimum_association_probability=0.1)
    drive_circles(slam, world, 8)
    resampled = []
    for step, vehicle in ((8, 'a'), (8, 'b'), (9, 'b'), (10, 'b')):
        slam.predict(vehicle, Pose2(0.0, 0.0, 0.0), 1e-6 * np.eye(3))
        resampled.append(slam.update(vehicle, world.see(vehicle, float(step))).resampled)
    assert resampled == [False, True, False, False]


def test_same_seed_same_bits_other_seed_other_bits(make_world, make_slam, drive_circles):
    results = []
    for seed in (1, 1, 2):
        world = make_world()
        slam = make_slam(world.start(**STARTS), seed)
        drive_circles(slam, world, 12)
        results.append((slam.best_path(), slam.landmarks().means))
    np.testing.assert_array_equal(results[0][0], results[1][0])
    np.testing.assert_array_equal(results[0][1], results[1][1])
    assert not np.array_equal(results[0][0], results[2][0])


def test_the_path_of_a_continuing_lineage_is_the_same_bit_by_bit(
    make_world, make_slam, drive_circles
):
    world = make_world()
    slam = make_slam(world.start(**STARTS))
    drive_circles(slam, world, 20)
    before, best = slam.best_path(), slam.best_particle()
    assert before.shape == (40, 3)
    slam.predict('a', Pose2(0.0, 0.0, 0.0), np.zeros((3, 3)))
    slam.add_keyframe('a', 20.0)
    assert slam.best_particle() == best
    np.testing.assert_array_equal(slam.best_path()[:40], before)
    stamps, poses = slam.trajectory('b')
    assert stamps.tolist() == list(range(20))
    np.testing.assert_array_equal(poses, before[1::2])


def test_estimate_includes_motion_since_the_update(make_slam):
    slam = make_slam({'a': Pose2(1.0, 2.0, np.pi / 2)})
    slam.predict('a', Pose2(1.0, 0.0, 0.0), np.diag([0.01, 0.04, 0.0001]))
    pose, covariance = slam.estimate('a')
    assert pose == pytest.approx((1.0, 3.0, np.pi / 2))
    np.testing.assert_allclose(np.diag(covariance), [0.04, 0.01, 0.0001])
    assert slam.best_pose('a') == pytest.approx((1.0, 3.0, np.pi / 2))


def test_without_covariance_the_configured_noise_is_used(make_slam):
    slam = make_slam({'a': Pose2(0.0, 0.0, 0.0)}, forward_variance_per_metre=0.25)
    slam.predict('a', Pose2(1.0, 0.0, 0.0))
    scale = slam.config.calibration.distance_scale_deviation
    assert slam.estimate('a')[1][0, 0] == pytest.approx(0.25 + scale**2, rel=1e-3)


def test_set_pose_moves_one_vehicle(make_slam):
    slam = make_slam(STARTS)
    slam.set_pose('b', Pose2(-1.0, -2.0, 0.5), np.diag([0.04, 0.01, 0.01]))
    pose, covariance = slam.estimate('b')
    assert pose == pytest.approx((-1.0, -2.0, 0.5))
    np.testing.assert_allclose(covariance, np.diag([0.04, 0.01, 0.01]), atol=1e-12)
    assert slam.best_pose('a') == pytest.approx(STARTS['a'], abs=1e-12)


def test_a_heading_uncertain_by_a_radian_is_found_by_landmarks(make_world, make_slam):
    world = make_world(seed=4)
    slam = make_slam(world.start(a=STARTS['a']), particles=500)
    slam.predict('a', Pose2(0.0, 0.0, 0.0), np.zeros((3, 3)))
    for stamp in range(5):
        slam.update('a', world.see('a', float(stamp), reach=6.0))
    slam.set_pose('a', STARTS['a'], np.diag([0.25, 0.25, 1.0]))
    for stamp in range(5, 10):
        slam.update('a', world.see('a', float(stamp), reach=6.0))
    error = np.abs(world.error('a', slam.estimate('a')[0]))
    assert error[:2].max() < 0.1
    assert error[2] < 0.05


def test_a_lost_vehicle_is_relocalized(make_world, make_slam, drive_circles):
    world = make_world()
    slam = make_slam(world.start(a=STARTS['a']))
    drive_circles(slam, world, 25)
    world.true['a'] = world.true['a'].compose(Pose2(-0.6, 0.5, 0.5))
    found = []
    for step in range(25, 40):
        world.drive('a', Pose2(0.1, 0.0, 0.3))
        slam.predict('a', Pose2(0.1, 0.0, 0.3), 0.1 * np.diag([0.02, 0.01, 0.03]) ** 2)
        found.append(slam.update('a', world.see('a', float(step))))
    assert any(summary.lost for summary in found)
    assert sum(summary.relocated for summary in found) == 1
    assert np.abs(world.error('a', slam.estimate('a')[0]))[:2].max() < 0.15
    assert len(slam.map) <= 60 + 3
    # the joint graph goes on from the pose that was found: no motion pulls it back
    slam.redraw([0])
    assert np.abs(world.error('a', slam.estimate('a')[0]))[:2].max() < 0.15
    assert len(slam.landmarks()) > 10


@pytest.mark.parametrize(('engine', 'relocated'), [('paper', False), ('fastslam2', True)])
def test_only_engine_fastslam2_relocalizes_a_lost_vehicle(
    make_world, make_slam, engine, relocated
):
    world = make_world()
    slam = make_slam(world.start(a=STARTS['a']), engine=engine)
    slam.predict('a', Pose2(0.0, 0.0, 0.0), np.zeros((3, 3)))
    slam.update('a', world.see('a', 0.0, reach=6.0))
    world.true['a'] = world.true['a'].compose(Pose2(-0.5, 0.4, 0.1))
    summary = slam.update('a', world.see('a', 1.0, reach=6.0))
    assert (summary.lost, summary.relocated) == (True, relocated)
    off = np.abs(world.error('a', slam.estimate('a')[0]))[:2].max()
    assert off < 0.15 if relocated else off > 0.4


def test_landmarks_that_are_not_there_vanish(make_world, make_slam):
    world = make_world(seed=2, landmarks=40)
    slam = make_slam(world.start(a=Pose2(0.0, 3.0, 0.0)))
    slam.predict('a', Pose2(0.0, 0.0, 0.0), np.zeros((3, 3)))
    seen = world.see('a', 0.0, reach=9.0)
    ghost = seen.positions.mean(axis=0) * [0.6, 1.0, 1.0]
    descriptor = np.zeros((1, 128), np.float32)
    descriptor[0, 0] = 1.0
    with_ghost = LandmarkObservations(
        0.0,
        np.vstack([seen.positions, ghost]),
        np.concatenate([seen.covariances, seen.covariances[:1]]),
        np.vstack([seen.descriptors, descriptor]),
    )
    slam.update('a', with_ghost)
    count = len(slam.map)
    removed = [
        slam.update('a', world.see('a', float(stamp), reach=9.0)).removed for stamp in range(1, 15)
    ]
    assert sum(removed) == 1
    assert len(slam.map) == count - 1


def test_unmapped_region_leaves_places_to_who_mapped_them_first(make_world, make_slam):
    def inserted(policy):
        world = make_world(seed=3)
        slam = make_slam(
            world.start(a=Pose2(0.0, 5.0, 0.0), b=Pose2(0.0, 5.0, 0.0)),
            insertion_policy=policy,
            region_size=20.0,
        )
        for vehicle in 'ab':
            slam.predict(vehicle, Pose2(0.0, 0.0, 0.0), np.zeros((3, 3)))
        slam.update('a', world.see('a', 0.0, reach=2.0))
        return slam.update('b', world.see('b', 0.0, reach=4.0)).inserted

    assert inserted('always') > 3
    assert inserted('unmapped_region') == 0


def test_regions_are_squares_of_the_map_whatever_the_headings(make_world, make_slam):
    world = make_world(seed=4, landmarks=150, deviation=1e-4)
    starts = world.start(a=Pose2(2.0, 3.0, 0.6), b=Pose2(4.5, 2.0, 2.2))
    slam = make_slam(starts, insertion_policy='unmapped_region', region_size=1.5)
    for vehicle in 'ab':
        slam.predict(vehicle, Pose2(0.0, 0.0, 0.0), np.zeros((3, 3)))

    def squares(vehicle, seen):
        points = to_world(starts[vehicle], seen.positions)
        return [tuple(square) for square in np.floor(points[:, :2] / 1.5).astype(int).tolist()]

    first, second = (world.see(vehicle, 0.0) for vehicle in 'ab')
    assert slam.update('a', first).inserted == len(first)
    taken = set(squares('a', first))
    free = sum(square not in taken for square in squares('b', second))
    assert 5 < free < len(second) - 5
    assert slam.update('b', second).inserted == free


def changed(slam, before):
    after = slam.state_dict()
    return [name for name in before if not np.array_equal(before[name], after[name])]


def bad_observations(world):
    good = world.see('a', 50.0)
    R = good.covariances.copy()
    R[1] = np.diag([1.0, 0.0, 1.0])
    skew = good.covariances.copy()
    skew[0, 0, 1] = 0.5
    short = good.descriptors.copy()
    short[0] *= 0.5
    many = np.repeat(np.arange(len(good)), 400)
    return [
        (LandmarkObservations.empty(50.0), 'there are 0'),
        (dataclasses.replace(good, covariances=R), 'positive definite'),
        (dataclasses.replace(good, covariances=skew), 'not symmetric'),
        (dataclasses.replace(good, descriptors=short), 'length 0.5'),
        (dataclasses.replace(good, stamp=3.0), 'before the last one'),
        (
            LandmarkObservations(
                50.0, good.positions[many], good.covariances[many], good.descriptors[many]
            ),
            'maximum_observations',
        ),
    ]


def test_rejected_calls_name_the_value_and_leave_the_state(make_world, make_slam, drive_circles):
    world = make_world()
    slam = make_slam(world.start(**STARTS))
    drive_circles(slam, world, 10)
    slam.predict('a', Pose2(0.1, 0.0, 0.0), 1e-4 * np.eye(3))
    before = slam.state_dict()
    for observations, message in bad_observations(world):
        with pytest.raises(SlamError, match=message):
            slam.update('a', observations)
    zero = Pose2(0.0, 0.0, 0.0)
    calls = [
        (lambda: slam.update('c', world.see('a', 50.0)), "no vehicle 'c'"),
        (lambda: slam.predict('c', zero, np.eye(3)), "no vehicle 'c'"),
        (lambda: slam.predict('a', Pose2(np.nan, 0.0, 0.0), np.eye(3)), 'increment is'),
        (lambda: slam.predict('a', zero, np.full((3, 3), np.inf)), 'finite'),
        (lambda: slam.predict('a', zero, -np.eye(3)), 'eigenvalue -1'),
        (lambda: slam.predict('a', zero, np.eye(2)), r'shape \(2, 2\)'),
        (lambda: slam.set_pose('a', zero, np.diag([1.0, 1.0, np.nan])), 'finite'),
        (lambda: slam.add_keyframe('a', np.nan), 'stamp is nan'),
        (lambda: slam.estimate('nobody'), 'nobody'),
    ]
    for call, message in calls:
        with pytest.raises(SlamError, match=message):
            call()
    assert changed(slam, before) == []


def test_update_before_predict_is_rejected(make_world, make_slam):
    world = make_world()
    slam = make_slam(world.start(**STARTS))
    before = slam.state_dict()
    with pytest.raises(SlamError, match='before any predict'):
        slam.update('a', world.see('a', 0.0))
    assert changed(slam, before) == []
    slam.predict('a', Pose2(0.0, 0.0, 0.0), np.zeros((3, 3)))
    assert slam.update('a', world.see('a', 0.0)).inserted > 0


def test_start_poses_are_checked(make_slam):
    with pytest.raises(SlamError, match='start_poses is empty'):
        make_slam({})
    with pytest.raises(SlamError, match="start pose of 'a'"):
        make_slam({'a': Pose2(0.0, np.inf, 0.0)})


@pytest.mark.parametrize('particles', [1, 2, 33])
def test_few_particles_work(make_world, make_slam, drive_circles, particles):
    world = make_world()
    slam = make_slam(world.start(**STARTS), particles=particles)
    assert np.isfinite(drive_circles(slam, world, 15)).all()
    assert FastSlamConfig(particles=particles).particles == particles


def test_the_number_of_threads_does_not_matter(make_world, make_slam, drive_circles):
    paths = []
    for threads in (1, 2, 5):
        world = make_world()
        slam = make_slam(world.start(**STARTS), filter_threads=threads, particles=300)
        drive_circles(slam, world, 12)
        paths.append(slam.best_path())
    np.testing.assert_array_equal(paths[0], paths[1])
    np.testing.assert_array_equal(paths[0], paths[2])


def test_copies_of_one_particle_get_different_poses(make_world, make_slam, drive_circles):
    world = make_world()
    slam = make_slam(world.start(a=STARTS['a']), resampling_threshold=1.0)
    drive_circles(slam, world, 10)
    world.drive('a', Pose2(0.4, 0.0, 0.3))
    slam.predict('a', Pose2(0.4, 0.0, 0.3), np.diag([0.02, 0.01, 0.03]) ** 2)
    summary = slam.update('a', world.see('a', 10.0))
    assert summary.resampled
    assert summary.effective_particles < 190
    assert len(np.unique(slam.particle_poses('a'), axis=0)) == 200
    np.testing.assert_allclose(slam.weights(), 1 / 200)


def test_matches_name_the_landmarks_of_the_best_particle(make_world, make_slam):
    world = make_world()
    slam = make_slam(world.start(a=STARTS['a']))
    slam.predict('a', Pose2(0.0, 0.0, 0.0), np.zeros((3, 3)))
    first = slam.update('a', world.see('a', 0.0))
    assert (first.matches == -1).all()
    seen = world.see('a', 1.0, reach=4.5)
    second = slam.update('a', seen)
    assert (second.matches >= 0).sum() == second.associated == first.inserted
    assert second.inserted == second.observed - second.associated > 0
    landmarks = slam.landmarks()
    for number, descriptor in zip(second.matches, seen.descriptors, strict=True):
        if number >= 0:
            row = int(np.flatnonzero(landmarks.ids == number)[0])
            np.testing.assert_array_equal(landmarks.descriptors[row], descriptor)


def test_repeated_textures_do_not_prevent_new_landmarks(make_slam):
    random = np.random.default_rng(0)
    kind = np.abs(random.standard_normal((1, 128)))
    blur = 0.03 * random.standard_normal((40, 128))
    rows = kind / np.linalg.norm(kind) + blur
    rows = (rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float32)
    places = np.c_[random.uniform(1, 3, 40), random.uniform(-2, 2, 40), random.uniform(0, 2, 40)]
    covariances = np.tile(1e-4 * np.eye(3), (20, 1, 1))
    slam = make_slam({'a': Pose2(0.0, 0.0, 0.0)}, maximum_descriptor_distance=0.5)
    slam.predict('a', Pose2(0.0, 0.0, 0.0), np.zeros((3, 3)))
    slam.update('a', LandmarkObservations(0.0, places[:20], covariances, rows[:20]))
    elsewhere = places[20:] + [0.0, 10.0, 0.0]
    summary = slam.update('a', LandmarkObservations(1.0, elsewhere, covariances, rows[20:]))
    assert summary.with_candidates == 0
    assert summary.associated == 0
    assert summary.inserted == 20


def test_a_distinctive_descriptor_elsewhere_is_no_new_landmark(make_world, make_slam):
    world = make_world()
    slam = make_slam(world.start(a=STARTS['a']))
    slam.predict('a', Pose2(0.0, 0.0, 0.0), np.zeros((3, 3)))
    seen = world.see('a', 0.0)
    slam.update('a', seen)
    moved = dataclasses.replace(seen, positions=seen.positions + [3.0, 3.0, 0.0], stamp=1.0)
    assert slam.update('a', moved).inserted == 0
