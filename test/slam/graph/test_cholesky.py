import numpy as np
import pytest

from explore_slam.slam.graph import cholesky
from explore_slam.slam.graph.factors import RELATIVE_POSE, Factors, assemble
from explore_slam.slam.graph.ordering import eliminate


def random_factors(random, nodes, factors):
    """Return a chain of poses with as many further factors between random ones."""
    a = np.r_[np.arange(nodes - 1), random.integers(0, nodes, factors), -1]
    b = np.r_[np.arange(1, nodes), random.integers(0, nodes, factors), 0]
    keep = a != b
    a, b = a[keep], b[keep]
    root = random.standard_normal((len(a), 3, 3))
    W = root @ root.transpose(0, 2, 1) + np.eye(3)
    return Factors.of(RELATIVE_POSE, a, b, random.standard_normal((len(a), 3)), W)._replace(
        kind=np.where(a < 0, 0, RELATIVE_POSE)
    )


def system_of(factors, x):
    structure = eliminate(factors, len(x))
    parts = np.empty((len(x), 3, 3)), np.empty((len(structure.rows), 3, 3)), np.empty((len(x), 3))
    slots = structure.slots, structure.calibration_slots
    assemble(factors, x, structure.place, *slots, *parts)
    return structure, *parts


def dense_of(structure, diagonal, blocks):
    n = len(diagonal)
    H = np.zeros((n, n, 3, 3))
    H[np.arange(n), np.arange(n)] = diagonal
    for j in range(n):
        for p in range(structure.first[j], structure.first[j + 1]):
            H[structure.rows[p], j] = blocks[p]
            H[j, structure.rows[p]] = blocks[p].T
    return H.transpose(0, 2, 1, 3).reshape(3 * n, 3 * n)


@pytest.fixture(params=[(1, 0), (2, 1), (30, 10), (130, 80)], ids=str)
def problem(request):
    nodes, more = request.param
    random = np.random.default_rng(nodes)
    structure, diagonal, blocks, _ = system_of(
        random_factors(random, nodes, more), random.uniform(-2, 2, (nodes, 3))
    )
    H = dense_of(structure, diagonal, blocks)
    assert cholesky.factorize(structure.first, structure.rows, diagonal, blocks) == -1
    return structure, diagonal, blocks, H


def test_factor_times_its_transpose_is_the_matrix(problem):
    structure, diagonal, blocks, H = problem
    L = np.tril(dense_of(structure, diagonal, blocks))
    np.testing.assert_allclose(L @ L.T, H, atol=1e-9 * np.abs(H).max())


def test_solves_like_a_dense_matrix(problem):
    structure, diagonal, blocks, H = problem
    right = np.random.default_rng(0).standard_normal((len(diagonal), 3, 5))
    x = right.copy()
    everything = np.ones(len(x), np.bool_)
    cholesky.solve_lower(structure.first, structure.rows, diagonal, blocks, everything, x)
    cholesky.solve_upper(structure.first, structure.rows, diagonal, blocks, everything, x)
    expected = np.linalg.solve(H, right.reshape(-1, 5))
    np.testing.assert_allclose(x.reshape(-1, 5), expected, rtol=1e-7, atol=1e-10)


def test_diagonal_of_the_inverse(problem):
    structure, diagonal, blocks, H = problem
    C = np.linalg.inv(H)
    found = cholesky.inverse_diagonal(structure.first, structure.rows, diagonal, blocks)
    for i, block in enumerate(found):
        span = slice(3 * i, 3 * i + 3)
        np.testing.assert_allclose(block, C[span, span], rtol=1e-7, atol=1e-12)


def test_rows_that_are_needed_suffice(problem):
    structure, diagonal, blocks, _ = problem
    n = len(diagonal)
    wanted = np.zeros(n, np.bool_)
    wanted[n // 2] = True
    needed = cholesky.ancestors(structure.first, structure.rows, wanted)
    full = np.random.default_rng(1).standard_normal((n, 3, 4))
    part = np.where(needed[:, None, None], full, np.nan)
    args = structure.first, structure.rows, diagonal, blocks
    cholesky.solve_upper(*args, np.ones(n, np.bool_), full)
    cholesky.solve_upper(*args, needed, part)
    np.testing.assert_array_equal(part[n // 2], full[n // 2])


def test_rows_that_are_affected_suffice(problem):
    structure, diagonal, blocks, _ = problem
    n = len(diagonal)
    known = np.zeros(n, np.bool_)
    known[n // 2] = True
    full = np.zeros((n, 3, 4))
    full[n // 2] = np.random.default_rng(1).standard_normal((3, 4))
    part = full.copy()
    args = structure.first, structure.rows, diagonal, blocks
    affected = cholesky.ancestors(structure.first, structure.rows, known)
    cholesky.solve_lower(*args, np.ones(n, np.bool_), full)
    cholesky.solve_lower(*args, affected, part)
    np.testing.assert_array_equal(part, full)
    assert not full[~affected].any()


def test_matrix_that_is_not_positive_is_reported():
    first, rows = np.zeros(3, np.int64), np.empty(0, np.int64)
    diagonal = np.tile(np.eye(3), (2, 1, 1))
    diagonal[1, 1, 1] = -1.0
    assert cholesky.factorize(first, rows, diagonal, np.empty((0, 3, 3))) == 1


def test_order_is_a_permutation_and_a_chain_gets_no_fill():
    nodes = 500
    factors = random_factors(np.random.default_rng(0), nodes, 0)
    structure = eliminate(factors, nodes)
    assert sorted(structure.place.tolist()) == list(range(nodes))
    assert len(structure.rows) == nodes - 1


def test_landmark_seen_by_all_poses_is_eliminated_last():
    poses = np.arange(100)
    factors = Factors.of(
        RELATIVE_POSE,
        poses,
        np.full(100, 100),
        np.zeros((100, 3)),
        np.tile(np.eye(3), (100, 1, 1)),
    )
    structure = eliminate(factors, 101)
    assert structure.place[100] >= 99
    assert len(structure.rows) == 100
