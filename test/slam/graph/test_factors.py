import math

import numpy as np
import pytest

from explore_slam.slam.graph.factors import (
    CALIBRATION,
    CAUCHY,
    HUBER,
    OBSERVATION,
    PRIOR,
    RELATIVE_POSE,
    RELATIVE_POSITION,
    SQUARED,
    Factors,
    assemble,
    linearize_factor,
    moved,
    robust_cost,
    robust_weight,
    steepest_descent,
    total_cost,
)
from explore_slam.slam.graph.ordering import eliminate

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


def calibrated_factors(random):
    """Three poses in a chain of motions that depend on a calibration, node 3, and its prior."""
    root = random.standard_normal((3, 3, 3))
    W = root @ root.transpose(0, 2, 1) + np.eye(3)
    nodes = np.array([3, 3, -1])
    sensitivity = random.uniform(-1, 1, (3, 3, 3))
    motions = Factors.of(
        RELATIVE_POSE,
        np.array([0, 1, 2]),
        np.array([1, 2, 0]),
        random.uniform(-1, 1, (3, 3)),
        W,
        HUBER,
        2.0,
        c=nodes,
        C=sensitivity,
    )
    prior = Factors.of(CALIBRATION, np.array([-1]), np.array([3]), np.zeros((1, 3)), W[:1])
    return Factors.joined(motions, prior)


def system_at(factors, x):
    structure = eliminate(factors, len(x))
    diagonal, gradient = np.empty((len(x), 3, 3)), np.empty((len(x), 3))
    blocks = np.empty((len(structure.rows), 3, 3))
    slots = structure.slots, structure.calibration_slots
    cost = assemble(factors, x, structure.place, *slots, diagonal, blocks, gradient)
    return structure, cost, diagonal, blocks, gradient


@pytest.mark.parametrize('seed', range(5))
def test_gradient_with_calibration_is_the_numeric_derivative_of_the_cost(seed):
    random = np.random.default_rng(seed)
    factors, x = calibrated_factors(random), random.uniform(-1, 1, (4, 3))
    structure, cost, _, _, gradient = system_at(factors, x)
    assert cost == pytest.approx(total_cost(factors, x), rel=1e-12)
    for node in range(4):
        for i in range(3):
            step = np.zeros((4, 3))
            step[structure.place[node], i] = STEP
            ends = [
                total_cost(factors, moved(x, sign * step, structure.place, 3)) for sign in (1, -1)
            ]
            slope = (ends[0] - ends[1]) / (2 * STEP)
            # the cost is twice the sum whose gradient is assembled
            assert gradient[structure.place[node], i] == pytest.approx(0.5 * slope, abs=2e-6)


@pytest.mark.parametrize('seed', range(3))
def test_steepest_descent_is_the_negative_gradient(seed):
    random = np.random.default_rng(seed)
    factors, x = calibrated_factors(random), random.uniform(-1, 1, (4, 3))
    structure, cost, _, _, gradient = system_at(factors, x)
    descent = np.full((4, 3), np.nan)
    assert steepest_descent(factors, x, structure.place, descent) == pytest.approx(cost, rel=1e-12)
    np.testing.assert_allclose(descent, -gradient, rtol=1e-12, atol=1e-12)


def test_information_with_calibration_is_that_of_the_stacked_jacobians():
    """Without robust kernels: H = Jᵀ W J with J the numeric derivative of all errors."""
    random = np.random.default_rng(7)
    factors, x = calibrated_factors(random), random.uniform(-1, 1, (4, 3))
    factors = factors._replace(robust=np.full(4, SQUARED))
    structure, _, diagonal, blocks, _ = system_at(factors, x)
    H = np.zeros((4, 3, 4, 3))
    for n in range(4):
        H[n, :, n] = diagonal[n]
        for p in range(structure.first[n], structure.first[n + 1]):
            H[structure.rows[p], :, n] = blocks[p]
            H[n, :, structure.rows[p]] = blocks[p].T

    def errors(nodes):
        found = []
        for f in range(4):
            b = factors.b[f]
            a = factors.a[f] if factors.a[f] >= 0 else b
            e = error_of(factors.kind[f], nodes[a], nodes[b], factors.z[f])[0]
            if factors.c[f] >= 0:
                e = e - factors.C[f] @ nodes[factors.c[f]]
            found.append(e)
        return np.concatenate(found)

    J = np.empty((12, 12))
    for column in range(12):
        step = np.zeros((4, 3))
        step[column // 3, column % 3] = STEP
        ends = [errors(moved(x, sign * step, structure.place, 3)) for sign in (1, -1)]
        J[:, column] = (ends[0] - ends[1]) / (2 * STEP)
    W = np.zeros((12, 12))
    for f in range(4):
        W[3 * f : 3 * f + 3, 3 * f : 3 * f + 3] = factors.W[f]
    np.testing.assert_allclose(H.reshape(12, 12), J.T @ W @ J, atol=1e-6)
