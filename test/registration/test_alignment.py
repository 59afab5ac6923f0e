"""Point-to-line alignment: accuracy, the prior, and what the geometry leaves open."""

import math
from dataclasses import replace

import numpy as np
import pytest
from registration.ray_caster import box, polyline, scan_of

from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.registration import LocalMap, Prior, scan_cloud
from explore_slam.registration.alignment import (
    _CORRELATED_BEAMS,
    NORMAL_DEVIATION,
    _noise,
    _without_normal_noise,
    keeping_prior,
    open_direction,
    without_direction,
)

ROOM = np.vstack([box(-3.0, -2.0, 3.0, 2.0), polyline((1.0, -2.0), (1.0, -0.5))])
CORRIDOR = np.vstack([polyline((-50.0, 1.0), (50.0, 1.0)), polyline((-50.0, -1.0), (50.0, -1.0))])


def map_of(world, *poses, seed=0):
    random = np.random.default_rng(seed)
    return LocalMap.of([scan_cloud(scan_of(world, p, 0.01, random)) for p in poses], poses)


@pytest.mark.parametrize('start', [(0.1, 0.05, 0.06), (-0.15, 0.1, -0.1), (0.2, -0.15, 0.05)])
def test_a_wrong_start_is_put_right(start):
    local_map = map_of(ROOM, IDENTITY, Pose2(0.3, 0.1, 0.3), Pose2(-0.2, 0.2, -0.4))
    true = Pose2(0.2, -0.1, 0.15)
    cloud = scan_cloud(scan_of(ROOM, true, 0.01, np.random.default_rng(9)))
    found = local_map.align(cloud, true.compose(Pose2(*start)), 0.4)
    off = np.abs(true.between(found.pose))
    assert off[:2].max() < 0.008
    assert off[2] < 0.003
    assert found.overlap > 0.95
    assert found.rms < 0.02


def test_returns_count_by_their_weights():
    """Returns of the left wall err by 0.04 m: with equal weights, the pose errs by half of it."""
    local_map = map_of(ROOM, IDENTITY, Pose2(0.1, 0.1, 0.2))
    cloud = scan_cloud(scan_of(ROOM, IDENTITY))
    left = cloud.points[:, 1] > 1.9
    points = cloud.points + np.outer(left, [0.0, 0.04])
    errors = []
    for weight in (1.0, 0.01):
        weights = np.where(left, weight, 1.0)
        found = local_map.align(replace(cloud, points=points, weights=weights), IDENTITY, 0.4)
        errors.append(abs(found.pose.y))
    assert errors[0] > 0.012
    assert errors[1] < 0.003


def test_an_alignment_says_how_much_of_the_errors_beams_share():
    """Walls as even as the map's, and walls of panels 0.4 m wide, 0.03 m out of line."""
    corners = box(-3.0, -2.0, 3.0, 2.0)
    local_map = map_of(corners, IDENTITY, Pose2(0.3, 0.1, 0.3), Pose2(-0.2, 0.2, -0.4))
    random = np.random.default_rng(3)
    x, y = np.linspace(-3.0, 3.0, 121), np.linspace(-2.0, 2.0, 81)
    off = [0.03 * np.repeat(random.normal(size=16), 8) for _ in range(4)]
    walls = [
        (x, -2.0 + off[0][:121]), (x, 2.0 + off[1][:121]),
        (-3.0 + off[2][:81], y), (3.0 + off[3][:81], y),
    ]  # fmt: skip
    uneven = np.vstack([polyline(*np.column_stack(wall)) for wall in walls])
    shares = []
    for world in (corners, uneven):
        random = np.random.default_rng(4)
        clouds = [scan_cloud(scan_of(world, IDENTITY, 0.01, random)) for _ in range(20)]
        found = [local_map.align(cloud, IDENTITY, 0.4) for cloud in clouds]
        shares.append(np.median([alignment.independent for alignment in found]))
    assert shares[0] > 0.6
    assert shares[1] < 0.3


def test_errors_are_about_as_large_as_the_information_says():
    """The information allows for errors that beams share, so independent noise is below it."""
    local_map = map_of(ROOM, *[Pose2(0.1 * k, 0.0, 0.1 * k) for k in range(-3, 4)])
    true, distances = Pose2(0.1, -0.1, 0.1), []
    for seed in range(40):
        cloud = scan_cloud(scan_of(ROOM, true, 0.02, np.random.default_rng(seed)))
        found = local_map.align(cloud, true, 0.3)
        off = np.array(found.pose.between(true))
        distances.append(off @ found.information @ off)
    assert 0.05 < np.mean(distances) < 6.0


def test_along_a_corridor_the_prior_decides_and_the_information_says_so():
    local_map = map_of(CORRIDOR, IDENTITY, Pose2(0.4, 0.0, 0.0), Pose2(0.8, 0.0, 0.0))
    cloud = scan_cloud(scan_of(CORRIDOR, Pose2(1.2, 0.0, 0.0), 0.01, np.random.default_rng(3)))
    prior = Pose2(1.0, 0.06, 0.04)
    certainty = np.diag([1 / 0.1**2, 1 / 0.1**2, 1 / 0.1**2])
    found = local_map.align(cloud, prior, 0.4, Prior(prior, certainty))
    assert found.pose.x == pytest.approx(1.0, abs=0.02)
    assert found.pose.y == pytest.approx(0.0, abs=0.005)
    assert found.pose.theta == pytest.approx(0.0, abs=0.003)
    direction, deviation = found.weakest_direction()
    assert abs(direction[0]) > 0.99
    assert deviation > 0.2
    assert 1.0 / math.sqrt(found.information[1, 1]) < 0.02


@pytest.mark.parametrize('seed', range(6))
def test_along_a_corridor_nothing_counts_as_measured_however_weak_the_prior(seed):
    """Noise alone seems to fix the position along it to a centimetre, a metre off."""
    local_map = map_of(CORRIDOR, IDENTITY, Pose2(0.4, 0.0, 0.0), Pose2(0.8, 0.0, 0.0))
    random = np.random.default_rng(seed)
    cloud = scan_cloud(scan_of(CORRIDOR, Pose2(1.2, 0.0, 0.0), 0.01, random))
    prior = Pose2(1.1, 0.06, 0.04)
    weak = Prior(prior, np.diag([1e-3, 100.0, 100.0]))
    found = local_map.align(cloud, prior, 0.4, weak)
    assert found.pose.x < 0.5
    assert found.weakest_direction()[1] < 0.02
    direction = open_direction(found)
    start, kept = keeping_prior(found, weak, direction)
    opened = without_direction(local_map.align(cloud, start, 0.15, kept), direction)
    assert opened.pose.x == pytest.approx(prior.x, abs=0.02)
    assert opened.pose.y == pytest.approx(0.0, abs=0.01)
    values = np.linalg.eigvalsh(opened.information[:2, :2])
    assert values[0] < 1e-9 * values[1]


def test_in_a_room_every_direction_counts():
    local_map, cloud = map_of(ROOM, IDENTITY), scan_cloud(scan_of(ROOM, IDENTITY))
    found = local_map.align(cloud, Pose2(0.1, 0.05, 0.02), 0.4)
    assert open_direction(found) is None


def test_the_two_faces_of_a_thin_wall_are_not_taken_for_each_other():
    wall = np.vstack([polyline((-3.0, 0.0), (3.0, 0.0)), polyline((-3.0, 0.1), (3.0, 0.1))])
    sides = np.vstack([polyline((-3.0, -4.0), (-3.0, 4.0)), polyline((3.0, -4.0), (3.0, 4.0))])
    world = np.vstack([wall, sides])
    local_map = map_of(world, Pose2(0.0, -1.5, math.pi / 2))
    behind = Pose2(0.0, 1.5, -math.pi / 2)
    cloud = scan_cloud(scan_of(world, behind))
    found = local_map.align(cloud, behind, 0.4)
    assert found is None or abs(found.pose.y - 1.5) < 0.02


def test_too_few_matches_give_no_pose():
    local_map = map_of(ROOM, IDENTITY)
    cloud = scan_cloud(scan_of(ROOM, IDENTITY))
    assert local_map.align(cloud, Pose2(40.0, 0.0, 0.0), 0.4) is None
    assert local_map.align(cloud.only(np.arange(len(cloud)) < 10), IDENTITY, 0.4) is None


def test_bad_input_is_named():
    local_map, cloud = map_of(ROOM, IDENTITY), scan_cloud(scan_of(ROOM, IDENTITY))
    with pytest.raises(match='start'):
        local_map.align(cloud, Pose2(math.nan, 0.0, 0.0), 0.4)
    with pytest.raises(match='reach'):
        local_map.align(cloud, IDENTITY, 0.0)
    with pytest.raises(match='prior information'):
        local_map.align(cloud, IDENTITY, 0.4, Prior(IDENTITY, np.eye(2)))
    with pytest.raises(match='one pose per cloud'):
        LocalMap.of([cloud], [])
    with pytest.raises(match='one cloud or more'):
        LocalMap([])


def test_spurious_information_from_noisy_normals_is_taken_from_the_weakest_direction():
    c, s = math.cos(0.5), math.sin(0.5)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    A, b = turn @ np.diag([100.0, 10.0, 50.0]) @ turn.T, np.array([3.0, -2.0, 1.0])
    less, of_less = _without_normal_noise(A, b)
    spurious = NORMAL_DEVIATION**2 * (100.0 + 10.0)
    np.testing.assert_allclose(less, turn @ np.diag([100.0, 10.0 - spurious, 50.0]) @ turn.T)
    np.testing.assert_allclose(np.linalg.solve(less, of_less), np.linalg.solve(A, b), rtol=1e-5)


def test_no_more_information_is_taken_than_a_direction_has():
    """Information of a corridor along x, where the heading is coupled to the position across."""
    A = np.array([[1e-3, 0.0, 0.0], [0.0, 100.0, 30.0], [0.0, 30.0, 20.0]])
    less, _ = _without_normal_noise(A, np.zeros(3))
    expected = A.copy()
    expected[0, 0] = 0.0
    np.testing.assert_allclose(less, expected, atol=1e-9)


@pytest.mark.parametrize('correlation', [0.5, 0.8])
def test_correlated_residuals_count_as_fewer_independent_ones(correlation):
    """The share is that of an autoregressive process, weighted by Bartlett's window."""
    random, beams = np.random.default_rng(4), 40_000
    residuals = np.empty(beams)
    value = 0.0
    for k, noise in enumerate(random.standard_normal(beams)):
        value = correlation * value + math.sqrt(1.0 - correlation**2) * noise
        residuals[k] = 0.03 * value
    deviation, share = _noise(residuals)
    lags = np.arange(1, _CORRELATED_BEAMS + 1)
    weights = 1.0 - lags / (_CORRELATED_BEAMS + 1.0)
    assert deviation == pytest.approx(0.03, rel=0.05)
    assert 1.0 / share == pytest.approx(1.0 + 2.0 * (weights @ correlation**lags), rel=0.08)
    products = np.array([residuals[k:] @ residuals[:-k] for k in lags]) / (residuals @ residuals)
    assert 1.0 / share == pytest.approx(1.0 + 2.0 * (weights @ products), rel=1e-9)


def test_residuals_that_alternate_count_no_more_than_independent_ones():
    assert _noise(np.tile([0.02, -0.02], 50)) == (pytest.approx(0.02), 1.0)
