"""Sparse Cholesky factorization H = L Lᵀ in blocks of 3 × 3, and what is computed with it.

Blocks are stored as `ordering.Structure` lays them out: diagonal (N, 3, 3), of which the lower
triangle counts, and blocks (n, 3, 3) below it. Left-looking: Davis, Direct methods for sparse
linear systems, 2006, section 4.8.
"""

import math

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.geometry import Array
from explore_slam.slam.graph.factors import Integers

Flags = NDArray[np.bool_]


@kernel
def _subtract_outer(D: Array, m: Array) -> None:
    """Subtract m mᵀ (3, 3) from the lower triangle of D."""
    D[0, 0] -= m[0, 0] * m[0, 0] + m[0, 1] * m[0, 1] + m[0, 2] * m[0, 2]
    D[1, 0] -= m[1, 0] * m[0, 0] + m[1, 1] * m[0, 1] + m[1, 2] * m[0, 2]
    D[1, 1] -= m[1, 0] * m[1, 0] + m[1, 1] * m[1, 1] + m[1, 2] * m[1, 2]
    D[2, 0] -= m[2, 0] * m[0, 0] + m[2, 1] * m[0, 1] + m[2, 2] * m[0, 2]
    D[2, 1] -= m[2, 0] * m[1, 0] + m[2, 1] * m[1, 1] + m[2, 2] * m[1, 2]
    D[2, 2] -= m[2, 0] * m[2, 0] + m[2, 1] * m[2, 1] + m[2, 2] * m[2, 2]


@kernel
def _factor_diagonal(D: Array) -> bool:
    """Replace the lower triangle of D (3, 3) by its Cholesky factor; False if it has none."""
    for j in range(3):
        pivot = D[j, j]
        for k in range(j):
            pivot -= D[j, k] * D[j, k]
        if not (pivot > 0.0 and pivot < math.inf):
            return False
        D[j, j] = math.sqrt(pivot)
        for i in range(j + 1, 3):
            value = D[i, j]
            for k in range(j):
                value -= D[i, k] * D[j, k]
            D[i, j] = value / D[j, j]
    return True


@kernel
def factorize(first: Integers, rows: Integers, diagonal: Array, blocks: Array) -> int:
    """Replace H by its factor L in place; returns −1, or the place where H is not positive."""
    nodes = len(diagonal)
    head, link = np.full(nodes, -1), np.full(nodes, -1)  # columns whose next row is this one
    cursor = np.zeros(nodes, np.int64)  # that row
    at = np.zeros(nodes, np.int64)  # block of each row in the column at hand
    for j in range(nodes):
        begin, end = first[j], first[j + 1]
        for p in range(begin, end):
            at[rows[p]] = p
        k = head[j]
        while k >= 0:
            following = link[k]
            q, stop = cursor[k], first[k + 1]
            m = blocks[q]
            _subtract_outer(diagonal[j], m)
            m00, m01, m02 = m[0, 0], m[0, 1], m[0, 2]
            m10, m11, m12 = m[1, 0], m[1, 1], m[1, 2]
            m20, m21, m22 = m[2, 0], m[2, 1], m[2, 2]
            for p in range(q + 1, stop):
                t = at[rows[p]]
                for r in range(3):
                    u, v, w = blocks[p, r, 0], blocks[p, r, 1], blocks[p, r, 2]
                    blocks[t, r, 0] -= u * m00 + v * m01 + w * m02
                    blocks[t, r, 1] -= u * m10 + v * m11 + w * m12
                    blocks[t, r, 2] -= u * m20 + v * m21 + w * m22
            if q + 1 < stop:
                cursor[k] = q + 1
                link[k] = head[rows[q + 1]]
                head[rows[q + 1]] = k
            k = following
        D = diagonal[j]
        if not _factor_diagonal(D):
            return j
        i0, i1, i2 = 1.0 / D[0, 0], 1.0 / D[1, 1], 1.0 / D[2, 2]
        for p in range(begin, end):
            for r in range(3):
                u = blocks[p, r, 0] * i0
                v = (blocks[p, r, 1] - u * D[1, 0]) * i1
                blocks[p, r, 0], blocks[p, r, 1] = u, v
                blocks[p, r, 2] = (blocks[p, r, 2] - u * D[2, 0] - v * D[2, 1]) * i2
        if begin < end:
            cursor[j] = begin
            link[j] = head[rows[begin]]
            head[rows[begin]] = j
    return -1


@kernel
def solve_lower(
    first: Integers,
    rows: Integers,
    diagonal: Array,
    blocks: Array,
    affected: Flags,
    x: Array,
) -> None:
    """Replace the right-hand sides x (N, 3, R) by L⁻¹ x.

    affected (N,): rows that may become nonzero, which are the `ancestors` of those that are not
    zero in x.
    """
    count = x.shape[2]
    for j in range(len(diagonal)):
        if not affected[j]:
            continue
        D = diagonal[j]
        for m in range(count):
            u = x[j, 0, m] / D[0, 0]
            v = (x[j, 1, m] - D[1, 0] * u) / D[1, 1]
            x[j, 0, m], x[j, 1, m] = u, v
            x[j, 2, m] = (x[j, 2, m] - D[2, 0] * u - D[2, 1] * v) / D[2, 2]
        for p in range(first[j], first[j + 1]):
            i, L = rows[p], blocks[p]
            for m in range(count):
                u, v, w = x[j, 0, m], x[j, 1, m], x[j, 2, m]
                x[i, 0, m] -= L[0, 0] * u + L[0, 1] * v + L[0, 2] * w
                x[i, 1, m] -= L[1, 0] * u + L[1, 1] * v + L[1, 2] * w
                x[i, 2, m] -= L[2, 0] * u + L[2, 1] * v + L[2, 2] * w


@kernel
def solve_upper(
    first: Integers,
    rows: Integers,
    diagonal: Array,
    blocks: Array,
    needed: Flags,
    x: Array,
) -> None:
    """Replace the right-hand sides x (N, 3, R) by L⁻ᵀ x in the rows that are needed (N,)."""
    count = x.shape[2]
    for j in range(len(diagonal) - 1, -1, -1):
        if not needed[j]:
            continue
        x0, x1, x2 = x[j, 0], x[j, 1], x[j, 2]
        for p in range(first[j], first[j + 1]):
            y0, y1, y2 = x[rows[p], 0], x[rows[p], 1], x[rows[p], 2]
            L = blocks[p]
            a00, a01, a02 = L[0, 0], L[0, 1], L[0, 2]
            a10, a11, a12 = L[1, 0], L[1, 1], L[1, 2]
            a20, a21, a22 = L[2, 0], L[2, 1], L[2, 2]
            for m in range(count):
                u, v, w = y0[m], y1[m], y2[m]
                x0[m] -= a00 * u + a10 * v + a20 * w
                x1[m] -= a01 * u + a11 * v + a21 * w
                x2[m] -= a02 * u + a12 * v + a22 * w
        D = diagonal[j]
        d10, d20, d21 = D[1, 0], D[2, 0], D[2, 1]
        i0, i1, i2 = 1.0 / D[0, 0], 1.0 / D[1, 1], 1.0 / D[2, 2]
        for m in range(count):
            w = x2[m] * i2
            v = (x1[m] - d21 * w) * i1
            x2[m], x1[m] = w, v
            x0[m] = (x0[m] - d10 * v - d20 * w) * i0


@kernel
def ancestors(first: Integers, rows: Integers, wanted: Flags) -> Flags:
    """Return which rows of L⁻ᵀ x must be known for the wanted ones (N,).

    They are also those of L⁻¹ x that are not zero if x is zero in all rows but the wanted ones.
    """
    needed = wanted.copy()
    for j in range(len(needed)):
        if needed[j]:
            for p in range(first[j], first[j + 1]):
                needed[rows[p]] = True
    return needed


@kernel
def _inverse_lower(D: Array, out: Array) -> None:
    """Write the inverse of the lower triangular D (3, 3)."""
    out[:, :] = 0.0
    out[0, 0], out[1, 1], out[2, 2] = 1.0 / D[0, 0], 1.0 / D[1, 1], 1.0 / D[2, 2]
    out[1, 0] = -D[1, 0] * out[0, 0] * out[1, 1]
    out[2, 1] = -D[2, 1] * out[1, 1] * out[2, 2]
    out[2, 0] = -(D[2, 0] * out[0, 0] + D[2, 1] * out[1, 0]) * out[2, 2]


@kernel(inline='always')
def _subtract_product(T: Array, t: int, M: Array, m: int, Y: Array, y: int) -> None:
    """Subtract M[m] Y[y] (3, 3) from T[t]; numbers instead of views, which cost more than this."""
    for r in range(3):
        u, v, w = M[m, r, 0], M[m, r, 1], M[m, r, 2]
        T[t, r, 0] -= u * Y[y, 0, 0] + v * Y[y, 1, 0] + w * Y[y, 2, 0]
        T[t, r, 1] -= u * Y[y, 0, 1] + v * Y[y, 1, 1] + w * Y[y, 2, 1]
        T[t, r, 2] -= u * Y[y, 0, 2] + v * Y[y, 1, 2] + w * Y[y, 2, 2]


@kernel(inline='always')
def _subtract_transposed_product(T: Array, t: int, M: Array, m: int, Y: Array, y: int) -> None:
    """Subtract M[m]ᵀ Y[y] (3, 3) from T[t]."""
    for r in range(3):
        u, v, w = M[m, 0, r], M[m, 1, r], M[m, 2, r]
        T[t, r, 0] -= u * Y[y, 0, 0] + v * Y[y, 1, 0] + w * Y[y, 2, 0]
        T[t, r, 1] -= u * Y[y, 0, 1] + v * Y[y, 1, 1] + w * Y[y, 2, 1]
        T[t, r, 2] -= u * Y[y, 0, 2] + v * Y[y, 1, 2] + w * Y[y, 2, 2]


@kernel
def inverse_diagonal(first: Integers, rows: Integers, diagonal: Array, blocks: Array) -> Array:
    """Return the diagonal blocks (N, 3, 3) of H⁻¹ = (L Lᵀ)⁻¹.

    Only the blocks Σ of the inverse at the positions of the factor are computed, from the last
    column to the first (Takahashi, Fagan and Chin, Formation of a sparse bus impedance matrix,
    1973). With Y_i = L_ij L_jj⁻¹: Σ_ij = −Σ_k Σ_ik Y_k and Σ_jj = (L_jj L_jjᵀ)⁻¹ − Σ_k Y_kᵀ Σ_kj.
    """
    nodes = len(diagonal)
    on, below = np.zeros((nodes, 3, 3)), np.zeros((len(rows), 3, 3))  # Σ, laid out like L
    Y, inverse = np.zeros((len(rows), 3, 3)), np.empty((2, 3, 3))  # L_jj⁻¹ and −L_jj⁻¹
    for j in range(nodes - 1, -1, -1):
        begin, end = first[j], first[j + 1]
        _inverse_lower(diagonal[j], inverse[0])
        inverse[1] = -inverse[0]
        for p in range(begin, end):
            _subtract_product(Y, p, blocks, p, inverse, 1)
        for p in range(begin, end):
            b = rows[p]
            _subtract_product(below, p, on, b, Y, p)
            at = first[b]  # the rows after b are also rows of its column
            for q in range(p + 1, end):
                while rows[at] != rows[q]:
                    at += 1
                _subtract_product(below, q, below, at, Y, p)
                _subtract_transposed_product(below, p, below, at, Y, q)
        _subtract_transposed_product(on, j, inverse, 0, inverse, 1)
        for p in range(begin, end):
            _subtract_transposed_product(on, j, Y, p, below, p)
    return on
