import math

import numpy as np
import pytest

from explore_slam.slam.graph.factors import (
    CAUCHY,
    HUBER,
    OBSERVATION,
    PRIOR,
    RELATIVE_POSE,
    RELATIVE_POSITION,
    SQUARED,
    linearize_factor,
    moved,
    robust_cost,
    robust_weight,
)

STEP = 1e-6


def error_of(kind, p, q, z):
    e, A, B = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    linearize_factor(kind, p, q, z, e, A, B)
    return e, A, B


def moved_node(node, step, *, pose):
    return moved(node[None], step[None], np.zeros(1, np.int64), 1 if pose else 0)[0]


@pytest.mark.parametrize('kind', [PRIOR, RELATIVE_POSE, RELATIVE_POSITION, OBSERVATION])
def test_jacobians_are_the_numeric_derivatives(kind):
    random = np.random.default_rng(kind)
    for _ in range(20):
        p, q, z = random.uniform(-3, 3, (3, 3))
        _, A, B = error_of(kind, p, q, z)
        for i, step in enumerate(STEP * np.eye(3)):
            for sign_of_pose, expected in ((True, A), (False, B)):
                ends = []
                for d in (step, -step):
                    a = moved_node(p, d, pose=True) if sign_of_pose else p
                    b = q if sign_of_pose else moved_node(q, d, pose=kind != OBSERVATION)
                    ends.append(error_of(kind, a, b, z)[0])
                difference = ends[0] - ends[1]
                difference[2] = math.remainder(difference[2], math.tau)
                np.testing.assert_allclose(difference / (2 * STEP), expected[:, i], atol=1e-8)


def test_errors_vanish_where_the_measurement_is_right():
    p, q = np.array([1.0, 2.0, 0.5 * math.pi]), np.array([0.0, 4.0, math.pi])
    assert error_of(RELATIVE_POSE, p, q, np.array([2.0, 1.0, 0.5 * math.pi]))[0] == pytest.approx(
        np.zeros(3), abs=1e-15
    )
    assert error_of(RELATIVE_POSITION, p, q, np.array([2.0, 1.0, 9.0]))[0] == pytest.approx(
        np.zeros(3), abs=1e-15
    )
    seen = error_of(OBSERVATION, p, np.array([0.0, 4.0, 1.5]), np.array([2.0, 1.0, 1.0]))[0]
    assert seen == pytest.approx([0.0, 0.0, 0.5], abs=1e-15)


def test_heading_errors_are_the_short_way_round():
    e, _, _ = error_of(PRIOR, np.zeros(3), np.array([0, 0, 3.1]), np.array([0, 0, -3.1]))
    assert e[2] == pytest.approx(6.2 - math.tau)


@pytest.mark.parametrize(('robust', 'scale'), [(SQUARED, 1.0), (HUBER, 2.0), (CAUCHY, 1.5)])
def test_robust_weight_is_the_slope_of_the_cost(robust, scale):
    for q in (0.01, 1.0, 3.9, 4.1, 50.0, 1e4):
        d = 1e-6 * q
        slope = robust_cost(robust, scale, q + d) - robust_cost(robust, scale, q - d)
        assert robust_weight(robust, scale, q) == pytest.approx(slope / (2 * d), rel=1e-6)
