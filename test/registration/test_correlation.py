"""Branch and bound finds what an exhaustive search finds."""

import math

import numpy as np
import pytest
from registration.ray_caster import box, polyline, scan_of

from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.registration import LocalMap, SearchWindow, scan_cloud
from explore_slam.registration.correlation import find_other_mode, find_peak
from explore_slam.registration.likelihood_grid import RESOLUTION, LikelihoodGrid

ROOM = np.vstack([box(-3.0, -2.0, 3.0, 2.0), polyline((1.0, -2.0), (1.0, -0.5))])


def likelihoods(grid):
    """Level 0 as a function of points: 0 outside."""
    level = grid.levels(1)[0]

    def at(points):
        cells = np.floor(points / RESOLUTION).astype(int) - grid.origin
        inside = (cells >= 0).all(axis=1) & (cells < level.shape[::-1]).all(axis=1)
        values = np.zeros(len(points))
        values[inside] = level[cells[inside, 1], cells[inside, 0]] / 255.0
        return values

    return at


def exhaustive(grid, points, window, keep=lambda _pose: True):
    """Return the best penalised score, its raw score and pose by trying all poses."""
    at, best = likelihoods(grid), (-np.inf, 0.0, None)
    for turn in range(-window.turns, window.turns + 1):
        angle = turn * window.angle_step
        heading = window.centre.theta + angle
        c, s = math.cos(heading), math.sin(heading)
        turned = points @ np.array([[c, s], [-s, c]])
        for i in range(-window.cells, window.cells + 1):
            for j in range(-window.cells, window.cells + 1):
                x, y = window.centre.x + i * RESOLUTION, window.centre.y + j * RESOLUTION
                if not keep((x, y, heading)):
                    continue
                raw = at(turned + (x, y)).mean()
                score = raw - window.heading_penalty * angle**2
                score -= window.position_penalty * (i**2 + j**2) * RESOLUTION**2
                if score > best[0] + 1e-12:
                    best = (score, raw, (x, y, heading))
    return best


@pytest.mark.parametrize('penalty', [0.0, 2.0])
@pytest.mark.parametrize('centre', [(0.13, -0.22, 0.07), (-0.31, 0.05, -0.12), (2.9, 1.7, 0.5)])
def test_the_peak_is_that_of_an_exhaustive_search(centre, penalty):
    grid = LikelihoodGrid(scan_cloud(scan_of(ROOM, IDENTITY)).sparse_points)
    points = scan_cloud(scan_of(ROOM, Pose2(0.1, -0.1, 0.05))).query_points
    window = SearchWindow(
        Pose2(*centre), 0.4, 0.14, position_penalty=penalty, heading_penalty=penalty
    )
    score, raw, pose = exhaustive(grid, points, window)
    peak = find_peak(grid, points, window, -10.0)
    assert peak.score == pytest.approx(raw, abs=1e-6)
    found = np.array(peak.pose) - window.centre
    value = peak.score - penalty * (found**2).sum()
    assert value == pytest.approx(score, abs=1e-6)
    np.testing.assert_allclose(peak.pose, pose, atol=1e-6)
    assert find_peak(grid, points, window, score + 1e-6) is None


def test_the_other_mode_is_that_of_an_exhaustive_search():
    rooms = np.vstack([box(0.0, 0.0, 1.0, 1.5), box(1.0, 0.0, 2.0, 1.5)])
    poses = [Pose2(0.5, 0.7, 0.3), Pose2(1.5, 0.7, 0.3)]
    local_map = LocalMap.of([scan_cloud(scan_of(rooms, pose)) for pose in poses], poses)
    points = scan_cloud(scan_of(rooms, poses[0])).query_points
    window = SearchWindow(Pose2(0.9, 0.7, 0.3), 0.8, 0.1)
    best = local_map.find_peak(points, window, 0.0).pose
    apart = (0.5, 0.17)

    def other(pose):
        far = math.hypot(pose[0] - best.x, pose[1] - best.y) >= apart[0]
        return far or abs(pose[2] - best.theta) >= apart[1]

    score, _, pose = exhaustive(local_map.grid, points, window, other)
    found = find_other_mode(local_map.grid, points, window, best, apart, 0.1)
    assert found.score == pytest.approx(score, abs=1e-6)
    np.testing.assert_allclose(found.pose, pose, atol=1e-6)
    assert find_other_mode(local_map.grid, points, window, best, apart, score + 1e-6) is None


def test_a_wide_window_is_searched_through():
    """All headings and 5 m: the true pose is found, in parts of the map that are negative."""
    world = np.vstack([ROOM, box(-1.5, 0.5, -1.0, 1.2)]) - 40.0
    there = Pose2(-40.5, -40.3, 2.8)
    local_map = LocalMap.of([scan_cloud(scan_of(world, there, sight=6.2, beams=361))], [there])
    cloud = scan_cloud(scan_of(world, Pose2(-39.6, -40.4, -2.9)))
    window = SearchWindow(Pose2(-37.0, -42.0, 0.0), 5.0, math.pi, math.radians(2.0))
    peak = local_map.find_peak(cloud.query_points, window, 0.3)
    np.testing.assert_allclose(peak.pose, (-39.6, -40.4, -2.9), atol=0.06)
    assert peak.score > 0.75


def test_the_profile_is_the_score_of_shifted_poses():
    local_map = LocalMap([scan_cloud(scan_of(ROOM, IDENTITY))])
    points = scan_cloud(scan_of(ROOM, IDENTITY)).query_points
    offsets = np.arange(-4, 5) * 0.1
    profile = local_map.score_profile(points, IDENTITY, (0.6, 0.8), offsets)
    at = likelihoods(local_map.grid)
    expected = [at(points + k * np.array([0.6, 0.8])).mean() for k in offsets]
    np.testing.assert_allclose(profile, expected, atol=1e-6)
    assert profile.argmax() == 4


def test_nothing_is_found_without_points_and_bad_windows_are_named():
    grid = LikelihoodGrid(np.array([[0.0, 0.0], [1.0, 0.0]]))
    assert find_peak(grid, np.empty((0, 2)), SearchWindow(IDENTITY, 1.0, 0.1), 0.0) is None
    with pytest.raises(match='not finite'):
        SearchWindow(IDENTITY, np.nan, 0.1)
    with pytest.raises(match='negative'):
        SearchWindow(IDENTITY, 1.0, -0.1)
    with pytest.raises(match='angle_step'):
        SearchWindow(IDENTITY, 1.0, 0.1, 0.0)
