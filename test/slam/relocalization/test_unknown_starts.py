"""Vehicles of unknown start: they are in frames of their own until they join the map."""

import math

import numpy as np
import pytest

from explore_slam.data import InterRobotObservation
from explore_slam.errors import SlamError
from explore_slam.geometry import IDENTITY, Pose2, between, compose
from explore_slam.settings import with_values
from explore_slam.slam import FastSlam, FastSlamConfig, RelativePose, TeamBelief

STARTS = {'a': Pose2(1.0, 1.0, 0.0), 'b': Pose2(5.0, 4.0, 1.0)}
UNKNOWN = {'a': STARTS['a'], 'b': None}
EXACT = np.diag([1e4, 1e4, 1e5])
STEP = Pose2(0.4, 0.0, 0.25)


def drive(slam, world, rounds, first=0):
    """Drive both vehicles in circles; return vehicle -> [(keyframe, true pose)], all pinned."""
    found = {name: [] for name in world.true}
    for k in range(first, first + rounds):
        for name in world.true:
            world.drive(name, STEP)
            slam.predict(name, STEP)
            slam.update(name, world.see(name, float(k)))
            keyframe = slam.add_keyframe(name, float(k))
            slam.pin(keyframe)
            found[name].append((keyframe, world.true[name]))
    return found


def closures(driven, *pairs):
    """Return exact relative poses of b's keyframes in the frames of a's."""
    return [
        RelativePose(a, b, true_a.between(true_b), EXACT)
        for (a, true_a), (b, true_b) in ((driven['a'][i], driven['b'][j]) for i, j in pairs)
    ]


@pytest.fixture
def unlocalized(make_world, make_slam):
    world = make_world(3)
    world.start(**STARTS)
    slam = make_slam(UNKNOWN, 1, relocalization=False)
    return slam, world, drive(slam, world, 12)


@pytest.mark.parametrize('seed', [0, 1, 2])
def test_landmarks_in_common_join_too(make_world, make_slam, seed):
    world = make_world(seed)
    world.start(**STARTS)
    slam = make_slam(UNKNOWN, seed)
    rounds = 0
    while not slam.is_in_map('b') and rounds < 40:
        drive(slam, world, 1, first=rounds)
        rounds += 1
        if rounds == 3:  # the search survives a checkpoint
            slam = FastSlam.from_state(slam.state_dict())
    assert 3 < rounds < 40
    drive(slam, world, 8, first=rounds)
    assert slam.groups.of(0) is slam.groups.of(1)
    for name in 'ab':
        pose, P = slam.estimate(name)
        error = world.error(name, pose)
        assert np.abs(error).max() < 0.35
        assert error @ np.linalg.solve(P, error) < 20.0
    path, first = slam.best_path(), slam.path.of_vehicle(1)[0]
    off = STARTS['b'].compose(STEP).between(Pose2.from_array(path[first]))
    assert math.hypot(off.x, off.y) < 0.6


@pytest.mark.parametrize('seed', [0, 1, 2])
def test_a_vehicle_among_other_landmarks_does_not_join(make_world, make_slam, seed):
    """Nothing in its world is in the map, though half of the descriptors are alike."""
    world, elsewhere = make_world(seed), make_world(seed + 100)
    elsewhere.descriptors[::2] = world.descriptors[::2]
    world.start(a=STARTS['a'])
    elsewhere.start(b=STARTS['b'])
    slam = make_slam(UNKNOWN, seed)
    for k in range(25):
        for name, around in (('a', world), ('b', elsewhere)):
            around.drive(name, STEP)
            slam.predict(name, STEP)
            slam.update(name, around.see(name, float(k)))
    assert not slam.is_in_map('b')


def test_landmarks_of_another_frame_are_not_observed(unlocalized):
    """The same landmarks are seen by both; each vehicle maps them by itself."""
    slam, world, _ = unlocalized
    assert [slam.is_in_map(name) for name in 'ab'] == [True, False]
    assert not slam.are_in_one_frame('a', 'b')
    assert slam.groups.of(0) is not slam.groups.of(1)
    owners = slam.map.owners[slam.map.entries()]
    assert set(owners.tolist()) == {0, 1}
    assert set(slam.landmarks().owners.tolist()) == {0}
    in_own_frame = STARTS['b'].compose(slam.estimate('b')[0])
    assert np.abs(world.error('b', in_own_frame)).max() < 0.25
    np.testing.assert_array_equal(slam.keyframes_in_map(), np.tile([True, False], 12))


@pytest.mark.parametrize('off', [(0.0, 0.0, 0.0), (0.6, -0.5, 0.25)])
def test_a_join_brings_path_landmarks_and_particles_into_the_map(unlocalized, off):
    """Even from a guess of the frame that is some way off."""
    slam, world, driven = unlocalized
    measured = closures(driven, (2, 3), (5, 6), (8, 9), (11, 11))
    guess = STARTS['b'].compose(Pose2(*off))
    numbers = slam.join('b', guess, measured)
    assert len(set(numbers)) == 4
    assert slam.is_in_map('b')
    assert slam.keyframes_in_map().all()
    assert slam.groups.of(0) is slam.groups.of(1)
    assert max(slam.closure_distances().values()) < 30.0
    assert np.abs(world.error('b', slam.estimate('b')[0])).max() < 0.15
    path = slam.best_path()
    for keyframe, true in driven['b']:
        assert math.dist(path[keyframe][:2], true[:2]) < 0.15
    # afterwards both observe each other's landmarks, at their places
    drive(slam, world, 6, first=12)
    found = slam.landmarks()
    assert set(found.owners.tolist()) == {0, 1}
    nearest = np.linalg.norm(found.means[:, None] - world.points, axis=2).min(axis=1)
    assert np.median(nearest) < 0.1
    for name in 'ab':
        pose, P = slam.estimate(name)
        error = world.error(name, pose)
        assert error @ np.linalg.solve(P, error) < 20.0


def test_a_known_pose_joins_too(unlocalized):
    slam, world, _ = unlocalized
    slam.set_pose('b', world.true['b'], np.diag([1e-4, 1e-4, 1e-4]))
    assert slam.is_in_map('b')
    pose, P = slam.estimate('b')
    assert np.abs(world.error('b', pose)).max() < 0.05
    assert np.sqrt(P[0, 0] + P[1, 1]) < 0.1
    start = STARTS['b'].inverse().compose(Pose2.from_array(slam.trajectory('b')[1][0]))
    assert math.hypot(start.x, start.y) < 0.7  # the path came along: the first step is 0.4 m


def test_a_vehicle_that_was_moved_unobserved_stays_in_its_frame(unlocalized):
    slam, _, _ = unlocalized
    before = slam.estimate('b')[0]
    slam.displace('b', np.diag([1.0, 1.0, 0.5]))
    assert not slam.is_in_map('b')
    pose, P = slam.estimate('b')
    np.testing.assert_allclose(pose, before, atol=0.1)
    assert 1.8 < P[0, 0] + P[1, 1] < 2.3
    with pytest.raises(SlamError, match='covariance'):
        slam.displace('b', -np.eye(3))


def test_what_cannot_join_is_refused_and_changes_nothing(unlocalized):
    slam, _, driven = unlocalized
    good = closures(driven, (2, 3), (5, 6))
    before = slam.state_dict()
    wrong = [
        ('a', good, 'in the map already'),
        ('b', [], 'closures tie'),
        (
            'b',
            [RelativePose(driven['b'][0][0], driven['b'][9][0], IDENTITY, EXACT)],
            'closures tie',
        ),
        ('b', [good[0], good[1]._replace(information=-EXACT)], 'information'),
    ]
    for name, measured, message in wrong:
        with pytest.raises(SlamError, match=message):
            slam.join(name, STARTS['b'], measured)
    with pytest.raises(SlamError, match='frame is'):
        slam.join('b', Pose2(math.nan, 0.0, 0.0), good)
    after = slam.state_dict()
    assert before.keys() == after.keys()
    for name in before:
        np.testing.assert_array_equal(before[name], after[name], err_msg=name)
    slam.join('b', STARTS['b'], good)


def test_a_vehicle_observed_from_another_frame_adds_no_information(unlocalized):
    slam, _, _ = unlocalized
    before = slam.estimate('b')[0]
    seen = InterRobotObservation(20.0, 'b', np.array([1.0, 0.0]), 1e-4 * np.eye(2))
    slam.update_inter_robot('a', [seen])
    assert slam.estimate('b')[0] == before


def test_an_unlocalized_vehicle_survives_a_checkpoint(unlocalized):
    slam, _, driven = unlocalized
    other = FastSlam.from_state(slam.state_dict())
    assert not other.is_in_map('b')
    measured = closures(driven, (2, 3), (5, 6))
    for one in (slam, other):
        one.join('b', STARTS['b'], measured)
    np.testing.assert_array_equal(slam.best_path(), other.best_path())
    assert FastSlam.from_state(slam.state_dict()).is_in_map('b')


def test_if_no_start_is_known_the_first_vehicle_makes_the_map():
    slam = FastSlam({'a': None, 'b': None}, FastSlamConfig(particles=20))
    assert [slam.is_in_map(name) for name in 'ab'] == [True, False]
    assert slam.estimate('a')[0] == IDENTITY


@pytest.mark.parametrize(
    ('settings', 'message'),
    [
        ({'engine': 'paper'}, 'joint_graph'),
        ({'joint_graph': False}, 'joint_graph'),
        ({'insertion_policy': 'unmapped_region'}, 'insertion_policy'),
        ({'maps': 'dedicated'}, 'maps: common'),
    ],
)
def test_unknown_starts_need_one_joint_map(settings, message):
    config = with_values(FastSlamConfig(), {'particles': 20, **settings})
    with pytest.raises(SlamError, match=f"'b'.*{message}"):
        TeamBelief(UNKNOWN, config)


def test_the_graph_moves_as_a_rigid_body(unlocalized):
    slam, _, driven = unlocalized
    graph = slam.joint.graph
    slam.redraw([1])
    frame = np.array([3.0, -2.0, 2.0])
    keyframes = [slam.path.nodes[k] for k, _ in driven['b']]
    before = np.array([graph.estimate(k) for k in keyframes])
    others = graph.path()[[slam.path.nodes[k] for k, _ in driven['a']]]
    ids, positions = graph.landmarks()
    relative = graph.relative_covariance(keyframes[-1], keyframes[:3])
    graph.move([1], frame, [30.0, 30.0, 3.0])
    after = np.array([graph.estimate(k) for k in keyframes])
    np.testing.assert_allclose(after, compose(frame, before), atol=1e-12)
    np.testing.assert_array_equal(
        graph.path()[[slam.path.nodes[k] for k, _ in driven['a']]], others
    )
    _, moved = graph.landmarks()
    mine = np.flatnonzero(np.abs(moved - positions).max(axis=1) > 1e-9)
    owners = dict(zip(slam.map.ids.tolist(), slam.map.owners.tolist(), strict=True))
    assert {owners[n] for n in ids[mine].tolist()} == {1}
    np.testing.assert_allclose(moved[mine, 2], positions[mine, 2])
    # nothing but the tie to the map is looser: relative poses are as well known as before
    # (linearized at the optimum, before a small step away from it)
    again = graph.relative_covariance(keyframes[-1], keyframes[:3])
    for found, expected in zip(again, relative, strict=True):
        np.testing.assert_allclose(found, expected, atol=3e-3 * np.abs(expected).max())
    graph.optimize(1)
    off = between(after, np.array([graph.estimate(k) for k in keyframes]))
    assert np.abs(off).max() < 0.01
    for vehicles, pose, deviations, message in [
        ([7], frame, [1.0, 1.0, 1.0], 'vehicle 7'),
        ([1], [math.nan, 0.0, 0.0], [1.0, 1.0, 1.0], 'frame'),
        ([1], frame, [1.0, 0.0, 1.0], 'deviations'),
    ]:
        with pytest.raises(SlamError, match=message):
            graph.move(vehicles, pose, deviations)


def test_vehicles_of_unknown_start_cannot_be_tied_to_each_other_by_a_join():
    slam = FastSlam(
        {'a': IDENTITY, 'b': None, 'c': None}, with_values(FastSlamConfig(), {'particles': 5})
    )
    first = {name: slam.add_keyframe(name, 0.0) for name in 'abc'}
    for name in 'abc':
        slam.pin(first[name])
    between_all = [RelativePose(first['a'], first[name], IDENTITY, EXACT) for name in 'bc']
    with pytest.raises(SlamError, match=r"closures tie \['a', 'b', 'c'\]"):
        slam.join('b', IDENTITY, between_all)
    with pytest.raises(SlamError, match=r"closures tie \['a', 'c'\]"):
        slam.join('b', IDENTITY, between_all[1:])
    assert not slam.is_in_map('b')
    slam.join('b', IDENTITY, between_all[:1])
    assert slam.is_in_map('b')
    assert not slam.is_in_map('c')
