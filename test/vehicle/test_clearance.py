import math

import numpy as np
from hypothesis import given
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
    found = free_distance(points, curvature, 0.3, forward)
    grazing = free_distance(points, curvature, 0.299, forward)
    expected = stepped(points, curvature, 0.3, forward)
    if expected == math.inf:
        assert found > 4.9 or abs(curvature * found) > 3.1 or found != grazing
    else:
        assert abs(found - expected) < 0.003 or found < expected + 0.003 < grazing + 0.1


def test_scan_points_take_too_close_as_an_obstacle_and_skip_the_rest():
    ranges = np.array([np.nan, np.inf, -np.inf, 1.0, 9.0], np.float32)
    scan = LaserScan(0.0, 0.0, math.pi / 2, ranges, 0.1, 8.0)
    points = scan_points(scan, Pose2(0.5, 0.0, 0.0))
    np.testing.assert_allclose(points, [[0.4, 0.0], [0.5, -1.0]], atol=1e-6)


def test_scan_points_lie_in_the_vehicle_frame():
    scan = LaserScan(0.0, 0.0, 1.0, np.array([2.0], np.float32), 0.01, 8.0)
    points = scan_points(scan, Pose2(0.1, 0.0, math.pi / 2))
    np.testing.assert_allclose(points, [[0.1, 2.0]], atol=1e-9)
