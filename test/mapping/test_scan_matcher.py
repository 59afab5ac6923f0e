"""Laser odometry: a scan is put where it lies on the scans before it; the wheels fill the gaps."""

import itertools
import math

import numpy as np
import pytest

from explore_slam.data import LaserScan
from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.mapping import ScanMatcher, ScanMatchingConfig
from explore_slam.mapping.scan_matcher import (
    Cloud,
    _normal_equations,
    _sorted_into_cells,
    scan_cloud,
)

BEAMS = 361
WHEELS = np.diag([0.05, 0.05, 0.05]) ** 2
ROOM = [(-3.0, -2.0), (3.0, -2.0), (3.0, 1.0), (1.0, 1.0), (1.0, 3.0), (-3.0, 3.0), (-3.0, -2.0)]
CORRIDOR = [[(-50.0, -1.0), (50.0, -1.0)], [(-50.0, 1.0), (50.0, 1.0)]]


def scan_of(lines, pose, noise=0.0, seed=0, stamp=0.0):
    """A 180 degree scan of polylines from a pose of the laser."""
    angles = np.linspace(-math.pi / 2, math.pi / 2, BEAMS)
    rays = np.column_stack([np.cos(angles + pose.theta), np.sin(angles + pose.theta)])
    ranges = np.full(BEAMS, np.inf)
    for line in lines:
        for a, b in itertools.pairwise(line):
            edge, start = np.subtract(b, a), np.subtract(a, (pose.x, pose.y))
            across = rays[:, 0] * edge[1] - rays[:, 1] * edge[0]
            with np.errstate(divide='ignore', invalid='ignore'):
                far = (start[0] * edge[1] - start[1] * edge[0]) / across
                part = (start[0] * rays[:, 1] - start[1] * rays[:, 0]) / across
            hit = (far > 0.0) & (part >= 0.0) & (part <= 1.0)
            ranges = np.where(hit, np.minimum(ranges, far), ranges)
    ranges += noise * np.random.default_rng(seed).normal(size=BEAMS)
    ranges[ranges > 8.0] = np.inf
    return LaserScan(stamp, -math.pi / 2, math.pi / (BEAMS - 1), ranges.astype(np.float32), 0, 8.0)


def started(lines, pose=IDENTITY, **settings):
    matcher = ScanMatcher(ScanMatchingConfig(**settings))
    assert matcher.match(scan_of(lines, pose), IDENTITY, pose, WHEELS) is None
    assert matcher.started
    return matcher


@pytest.mark.parametrize('error', [(0.1, 0.05, 0.06), (-0.08, 0.1, -0.08), (0.0, -0.12, 0.1)])
def test_a_wrong_prior_is_put_right(error):
    matcher = started([ROOM])
    true = Pose2(0.2, -0.1, 0.15)
    prior = true.compose(Pose2(*error))
    match = matcher.match(scan_of([ROOM], true, 0.01), IDENTITY, prior, WHEELS)
    off = np.array(true.between(match.pose))
    assert np.abs(off[:2]).max() < 0.01
    assert abs(off[2]) < 0.004
    assert match.overlap > 0.8
    deviations = np.sqrt(np.diag(match.covariance))
    assert (deviations < 0.2 * np.sqrt(np.diag(WHEELS))).all()


def test_the_mounting_of_the_laser_counts():
    laser = Pose2(0.2, 0.0, 0.3)
    matcher = ScanMatcher(ScanMatchingConfig())
    matcher.match(scan_of([ROOM], laser), laser, IDENTITY, WHEELS)
    true = Pose2(0.1, 0.1, -0.2)
    prior = Pose2(0.0, 0.0, -0.1)
    match = matcher.match(scan_of([ROOM], true.compose(laser)), laser, prior, WHEELS)
    np.testing.assert_allclose(match.pose, true, atol=0.005)


def test_along_a_corridor_the_wheels_are_believed():
    matcher = started(CORRIDOR)
    prior = Pose2(0.5, 0.08, 0.05)
    match = matcher.match(scan_of(CORRIDOR, Pose2(0.6, 0.0, 0.0), 0.005), IDENTITY, prior, WHEELS)
    assert match.pose.x == pytest.approx(0.5, abs=0.02)
    assert match.pose.y == pytest.approx(0.0, abs=0.005)
    assert match.pose.theta == pytest.approx(0.0, abs=0.003)
    along, across, heading = np.sqrt(np.diag(match.covariance))
    assert along > 0.5 * 0.05
    assert across < 0.2 * 0.05
    assert heading < 0.2 * 0.05


def test_the_two_faces_of_a_thin_wall_are_not_taken_for_each_other():
    wall = [[(-3.0, 0.0), (3.0, 0.0)], [(-3.0, 0.1), (3.0, 0.1)]]
    around = [[(-3.0, -4.0), (-3.0, 4.0)], [(3.0, -4.0), (3.0, 4.0)]]
    matcher = started([*wall, *around], Pose2(0.0, -1.5, math.pi / 2))
    behind = Pose2(0.0, 1.5, -math.pi / 2)
    match = matcher.match(scan_of([*wall, *around], behind), IDENTITY, behind, WHEELS)
    assert match is None or abs(match.pose.y - 1.5) < 0.02


def test_what_lies_on_nothing_known_is_no_match():
    matcher = started([ROOM])
    far = Pose2(40.0, 0.0, 0.0)
    assert matcher.match(scan_of([ROOM], IDENTITY), IDENTITY, far, WHEELS) is None
    sure = 1e-6 * np.eye(3)
    lifted = scan_of([ROOM], Pose2(0.25, 0.2, 0.0))
    assert matcher.match(lifted, IDENTITY, Pose2(0.0, 0.0, 0.0), sure) is None


@pytest.mark.parametrize('value', [np.inf, -np.inf, np.nan, 0.0])
def test_scans_without_returns_change_nothing(value):
    matcher = started([ROOM])
    empty = LaserScan(
        1.0, -math.pi / 2, math.pi / 360, np.full(BEAMS, value, np.float32), 0.0, 8.0
    )
    assert matcher.match(empty, IDENTITY, IDENTITY, WHEELS) is None
    few = LaserScan(1.0, 0.0, 0.1, np.ones(3, np.float32), 0.0, 8.0)
    assert matcher.match(few, IDENTITY, IDENTITY, WHEELS) is None
    after = matcher.match(scan_of([ROOM], IDENTITY), IDENTITY, Pose2(0.05, 0.0, 0.0), WHEELS)
    np.testing.assert_allclose(after.pose, IDENTITY, atol=0.003)


def test_a_drive_drifts_far_less_than_the_wheels():
    rng = np.random.default_rng(4)
    matcher = ScanMatcher(ScanMatchingConfig())
    true = wheels = chain = IDENTITY
    for step in range(200):
        turn = 0.06 if step % 80 < 40 else -0.06
        move = Pose2(0.03 if step % 40 < 20 else -0.03, 0.0, turn)
        told = Pose2(*(np.array(move) + rng.normal(0.0, [0.01, 0.003, 0.015])))
        true, wheels, prior = true.compose(move), wheels.compose(told), chain.compose(told)
        noise = np.diag([0.01, 0.003, 0.015]) ** 2
        match = matcher.match(scan_of([ROOM], true, 0.01, step), IDENTITY, prior, noise)
        chain = prior if match is None else match.pose
    drift, alone = true.between(chain), true.between(wheels)
    assert math.hypot(drift.x, drift.y) < min(0.05, 0.3 * math.hypot(alone.x, alone.y))
    assert abs(drift.theta) < min(0.05, 0.3 * abs(alone.theta))


def test_forgotten_scans_are_not_matched_with():
    matcher = started([ROOM])
    matcher.reset()
    assert not matcher.started
    assert matcher.match(scan_of([ROOM], IDENTITY), IDENTITY, IDENTITY, WHEELS) is None


def test_a_cloud_has_its_normals_towards_the_laser():
    cloud = scan_cloud(scan_of([ROOM], Pose2(0.0, 0.0, 0.5)), IDENTITY, 10.0)
    assert len(cloud.points) > 100
    np.testing.assert_allclose(np.hypot(*cloud.normals.T), 1.0)
    assert ((cloud.points * cloud.normals).sum(axis=1) < 0.0).all()
    assert np.hypot(*np.diff(cloud.points, axis=0).T).min() > 0.005


def random_cloud(seed, count):
    """Points on a few walls, with their normals."""
    generator = np.random.default_rng(seed)
    headings = generator.integers(0, 4, count) * (math.pi / 2) + 0.2
    normals = np.column_stack([np.cos(headings), np.sin(headings)])
    return Cloud(generator.uniform(-2.0, 2.0, (count, 2)), normals)


@pytest.mark.parametrize('seed', range(3))
def test_the_normal_equations_are_those_of_weighted_point_to_line_residuals(seed):
    cloud, walls = random_cloud(seed, 40), random_cloud(10 + seed, 300)
    pose, distance, deviation = Pose2(0.2, -0.1, 0.15), 0.25, 0.05
    A, b, matched = _normal_equations(
        cloud, _sorted_into_cells(walls), tuple(pose), distance, deviation
    )

    def residuals(step):
        placed = cloud.moved(pose.compose(Pose2(*step)))
        return (across * (near - placed.points)).sum(axis=1)

    placed = cloud.moved(pose)
    gaps = np.linalg.norm(placed.points[:, None] - walls.points[None], axis=2)
    gaps[placed.normals @ walls.normals.T <= 0.8] = np.inf
    nearest = gaps.argmin(axis=1)
    found = gaps.min(axis=1) < distance
    assert 15 < found.sum() < 40
    assert matched == found.sum()
    near, across = walls.points[nearest], walls.normals[nearest]
    zero, h = residuals(np.zeros(3)), 1e-6
    jacobian = np.column_stack(
        [(residuals(-h * axis) - residuals(h * axis)) / (2.0 * h) for axis in np.eye(3)]
    )
    weights = found / (deviation**2 + zero**2)
    np.testing.assert_allclose(A, jacobian.T @ (weights[:, None] * jacobian), rtol=1e-6, atol=1e-4)
    np.testing.assert_allclose(b, jacobian.T @ (weights * zero), rtol=1e-6, atol=1e-4)


def test_many_points_count_as_sixty_independent_ones():
    walls = random_cloud(1, 3000)
    cells = _sorted_into_cells(walls)
    some = Cloud(walls.points[:90], walls.normals[:90])
    few = Cloud(walls.points[:45], walls.normals[:45])
    twice = Cloud(np.tile(few.points, (2, 1)), np.tile(few.normals, (2, 1)))
    single, _, matched = _normal_equations(few, cells, (0.0, 0.0, 0.0), 0.1, 0.02)
    double, _, both = _normal_equations(twice, cells, (0.0, 0.0, 0.0), 0.1, 0.02)
    assert (matched, both) == (45, 90)
    np.testing.assert_allclose(double, single * (60.0 / 45.0))
    assert _normal_equations(some, cells, (0.0, 0.0, 0.0), 0.1, 0.02)[2] == 90


def test_points_outside_of_the_window_have_no_correspondence():
    walls = random_cloud(1, 50)
    cells = _sorted_into_cells(walls)
    for x, y in ((40.0, 0.0), (-40.0, 0.0), (0.0, 40.0), (0.0, -40.0)):
        _, _, matched = _normal_equations(walls, cells, (x, y, 0.0), 0.3, 0.02)
        assert matched == 0


def flat_scan(ranges, increment=0.01):
    ranges = np.array(ranges, np.float32)
    return LaserScan(0.0, -0.5 * increment * (len(ranges) - 1), increment, ranges, 0.0, 30.0)


def test_returns_at_a_step_in_depth_have_no_normal():
    ranges = np.full(101, 2.0)
    ranges[50:] = 2.26  # more than 0.05 m + 0.1 per metre
    cloud = scan_cloud(flat_scan(ranges), IDENTITY, 10.0)
    bearings = np.arctan2(cloud.points[:, 1], cloud.points[:, 0])
    assert np.abs(bearings).min() > 0.02
    assert (bearings < 0.0).any()
    assert (bearings > 0.0).any()
    ranges[50:] = 2.2
    whole = scan_cloud(flat_scan(ranges), IDENTITY, 10.0)
    assert len(whole.points) >= len(cloud.points)


def test_returns_off_a_line_have_no_normal():
    generator = np.random.default_rng(0)
    rough = scan_cloud(flat_scan(2.0 + generator.normal(0.0, 0.06, 201)), IDENTITY, 10.0)
    smooth = scan_cloud(flat_scan(2.0 + generator.normal(0.0, 0.005, 201)), IDENTITY, 10.0)
    assert len(rough.points) < 0.2 * len(smooth.points)


def test_returns_too_near_or_too_far_are_left_out():
    assert len(scan_cloud(flat_scan(np.full(101, 0.04)), IDENTITY, 10.0).points) == 0
    assert len(scan_cloud(flat_scan(np.full(101, 0.06)), IDENTITY, 10.0).points) > 0
    assert len(scan_cloud(flat_scan(np.full(101, 4.0)), IDENTITY, 3.9).points) == 0
    assert len(scan_cloud(flat_scan(np.full(101, 4.0)), IDENTITY, 4.1).points) > 50


def test_the_window_takes_scans_by_travel_and_forgets_the_oldest():
    matcher = ScanMatcher(
        ScanMatchingConfig(
            matching_window=2, matching_window_distance=0.5, matching_window_heading=0.5
        )
    )
    sizes = []
    for x, theta in ((0.0, 0.0), (0.4, 0.0), (0.6, 0.0), (0.6, 0.4), (0.6, 0.6), (1.2, 0.6)):
        pose = Pose2(x, 0.0, theta)
        matcher.match(scan_of([ROOM], pose), IDENTITY, pose, WHEELS)
        sizes.append(len(matcher._window))
        last = matcher._last
    assert sizes == [1, 1, 2, 2, 2, 2]
    np.testing.assert_allclose(last, (1.2, 0.0, 0.6), atol=0.01)


def test_a_scan_too_much_of_which_is_new_is_no_match():
    matcher = started([ROOM], matching_overlap=0.8)
    half = scan_of([ROOM], IDENTITY)
    half.ranges[:200] = 0.4 * half.ranges[:200]
    assert matcher.match(half, IDENTITY, IDENTITY, WHEELS) is None
    lenient = started([ROOM], matching_overlap=0.2)
    assert 0.2 < lenient.match(half, IDENTITY, IDENTITY, WHEELS).overlap < 0.8


@pytest.mark.parametrize(('gate', 'matched'), [(3.0, False), (6.0, True)])
def test_the_gate_is_a_mahalanobis_distance(gate, matched):
    """The wheels are 0.1 m off with a deviation of 0.02 m: 5 sigma."""
    matcher = started([ROOM], matching_gate=gate)
    covariance = np.diag([0.02, 0.02, 0.05]) ** 2
    prior = Pose2(0.1, 0.0, 0.0)
    match = matcher.match(scan_of([ROOM], IDENTITY), IDENTITY, prior, covariance)
    assert (match is not None) is matched


def test_part_of_the_variance_of_the_wheels_remains():
    covariances = [
        started([ROOM], matching_drift=drift)
        .match(scan_of([ROOM], IDENTITY), IDENTITY, IDENTITY, WHEELS)
        .covariance
        for drift in (0.0, 0.5)
    ]
    np.testing.assert_allclose(covariances[1] - covariances[0], 0.5 * WHEELS, rtol=1e-6)


def test_no_motion_is_known_better_than_a_tenth_of_a_millimetre():
    matcher = started(CORRIDOR)
    match = matcher.match(scan_of(CORRIDOR, IDENTITY), IDENTITY, IDENTITY, np.zeros((3, 3)))
    assert math.sqrt(match.covariance[0, 0]) == pytest.approx(1e-4, rel=0.02)
