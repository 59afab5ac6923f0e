import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from explore_slam.data import LaserScan
from explore_slam.geometry import Pose2
from explore_slam.vehicle.clearance import free_distance, scan_points


def stepped(points, curvature, radius, forward):
    """Reference: moves the circle in small steps until it touches."""
    points = points if forward else points * [-1, 1]
    for s in np.arange(0.0, 5.0, 0.002):
        angle = s * curvature
        if abs(curvature) > 1e-3:
            center = np.array([math.sin(angle), 1 - math.cos(angle)]) / curvature
            if abs(angle) > math.pi:
                return math.inf
        else:
            center = np.array([s, 0.0])
        if np.min(np.hypot(*(points - center).T)) < radius:
            return s
    return math.inf


@given(
    st.lists(
        st.tuples(st.floats(-3, 3), st.floats(-3, 3)).filter(lambda p: math.hypot(*p) > 0.31),
        min_size=1,
        max_size=4,
    ),
    st.sampled_from([0.0, 0.4, -0.4, 1.5, -3.0]),
    st.booleans(),
)
def test_free_distance_agrees_with_small_steps(points, curvature, forward):
    points = np.array(points)
    wider, narrower = (stepped(points, curvature, radius, forward) for radius in (0.302, 0.298))
    assume((wider == math.inf) == (narrower == math.inf))  # else a point is only grazed
    found = free_distance(points, curvature, 0.3, forward)
    if wider == math.inf:
        assert found > 4.9 or abs(curvature * found) > 3.1
    else:
        assert wider - 0.003 <= found <= narrower + 0.003


def test_scan_points_take_too_close_as_an_obstacle_and_skip_the_rest():
    ranges = np.array([np.nan, np.inf, -np.inf, 1.0, 9.0], np.float32)
    scan = LaserScan(0.0, 0.0, math.pi / 2, ranges, 0.1, 8.0)
    points = scan_points(scan, Pose2(0.5, 0.0, 0.0))
    np.testing.assert_allclose(points, [[0.4, 0.0], [0.5, -1.0]], atol=1e-6)


def test_scan_points_lie_in_the_vehicle_frame():
    scan = LaserScan(0.0, 0.0, 1.0, np.array([2.0], np.float32), 0.01, 8.0)
    points = scan_points(scan, Pose2(0.1, 0.0, math.pi / 2))
    np.testing.assert_allclose(points, [[0.1, 2.0]], atol=1e-9)


@pytest.mark.parametrize('side', [1.0, -1.0])
@pytest.mark.parametrize('forward', [True, False])
def test_free_distance_on_an_arc_by_hand(side, forward):
    """A point on the arc is touched one chord of the disc's radius before it."""
    turn, radius, angle = 2.0, 0.3, 1.2
    x, y = turn * math.sin(angle), side * turn * (1.0 - math.cos(angle))
    point = np.array([[x if forward else -x, y]])
    contact = angle - 2.0 * math.asin(0.5 * radius / turn)
    found = free_distance(point, side / turn, radius, forward)
    assert found == pytest.approx(turn * contact)
    assert free_distance(point, -side / turn, radius, forward) == math.inf
    assert free_distance(point, side / turn, radius, not forward) == math.inf


def test_free_distance_on_a_line_by_hand():
    points = np.array([[3.0, 0.0], [2.0, 0.18], [1.0, 0.31], [-1.0, 0.0]])
    assert free_distance(points, 0.0, 0.3) == pytest.approx(2.0 - 0.24)
    assert free_distance(points[2:], 0.0, 0.3) == math.inf
    assert free_distance(points, 0.0, 0.3, forward=False) == pytest.approx(0.7)
    assert free_distance(np.empty((0, 2)), 0.0, 0.3) == math.inf


def test_points_inside_the_disc_stop_only_motion_towards_them():
    ahead, behind = np.array([[0.1, 0.05]]), np.array([[-0.1, 0.05]])
    for curvature in (0.0, 1.0, -1.0):
        assert free_distance(ahead, curvature, 0.3) == 0.0
        assert free_distance(behind, curvature, 0.3) == math.inf
        assert free_distance(behind, curvature, 0.3, forward=False) == 0.0


def test_only_half_a_turn_is_looked_at():
    almost, beyond = math.pi - 0.2, math.pi + 0.5
    for angle, touched in ((almost, True), (beyond, False)):
        point = np.array([[math.sin(angle), 1.0 - math.cos(angle)]])
        assert (free_distance(point, 1.0, 0.1) < math.inf) == touched
    center = np.array([[0.0, 1.0]])  # of the turn: never nearer than its radius
    assert free_distance(center, 1.0, 0.3) == math.inf
