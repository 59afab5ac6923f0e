"""Factors of the graph: errors, Jacobians, robust kernels, and the sum of them as a linear system.

Every node has three coordinates: a pose (x m, y m, heading rad) or a landmark (x, y, z m). A step
δ moves a pose in its own frame, p ⊞ δ = (t + R δ_xy, θ + δ_θ), and a landmark in the map.
A calibration is a node whose three coordinates are scale and drift errors of wheel odometry; a
step adds to them.
Every factor has an error e (3,) in the axes its measurement z is given in, the Jacobians A and B
(3, 3) of e in the steps of its nodes a and b, and an information matrix W (3, 3). The measured
motion z + C x_c may depend on a calibration x_c.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.geometry import Array
from explore_slam.slam.graph.se2 import wrapped
from explore_slam.slam.graph.tables import GrowingTable

Integers = NDArray[np.int64]

# kinds of factors
PRIOR = 0  # pose b in the map; there is no node a
RELATIVE_POSE = 1  # pose b in the frame of pose a
RELATIVE_POSITION = 2  # position of pose b in the frame of pose a
OBSERVATION = 3  # position of landmark b in the frame of pose a
CALIBRATION = 4  # prior of calibration b; there is no node a

# robust kernels
SQUARED, HUBER, CAUCHY = 0, 1, 2


class Factors(NamedTuple):
    """Measurements, one per row."""

    kind: Integers
    a: Integers  # nodes; −1 where there is none
    b: Integers
    z: Array  # (F, 3)
    W: Array  # (F, 3, 3)
    robust: Integers
    scale: Array  # (F,) threshold of the robust kernel, sigma
    c: Integers  # calibrations that measured motions depend on; −1 where there is none
    C: Array  # (F, 3, 3) Jacobian of z in the calibration

    @classmethod
    def of(
        cls,
        kind: int,
        a: Integers,
        b: Integers,
        z: Array,
        W: Array,
        robust: int = SQUARED,
        scale: float = 1.0,
        c: Integers | None = None,
        C: Array | None = None,
    ) -> 'Factors':
        """Make factors of one kind and one robust kernel."""
        n = len(b)
        return cls(
            np.full(n, kind, np.int64),
            np.asarray(a, np.int64),
            np.asarray(b, np.int64),
            np.ascontiguousarray(z, np.float64).reshape(n, 3),
            np.ascontiguousarray(W, np.float64).reshape(n, 3, 3),
            np.full(n, robust, np.int64),
            np.full(n, scale, np.float64),
            np.full(n, -1, np.int64) if c is None else np.asarray(c, np.int64),
            np.zeros((n, 3, 3)) if C is None else np.ascontiguousarray(C, np.float64),
        )

    @classmethod
    def of_rows(cls, table: GrowingTable, rows: Integers | NDArray[np.bool_]) -> 'Factors':
        """Return some rows of a table of measurements that depend on no calibration."""
        names = ('kind', 'a', 'b', 'z', 'W', 'robust', 'scale')
        kind, a, b, z, W, robust, scale = (table[name][rows] for name in names)
        none = np.full(len(kind), -1, np.int64)
        return cls(kind, a, b, z, W, robust, scale, none, np.zeros((len(kind), 3, 3)))

    @classmethod
    def joined(cls, *parts: 'Factors') -> 'Factors':
        """Concatenate factors."""
        return cls._make(np.concatenate(columns) for columns in zip(*parts, strict=True))

    def last(self, count: int) -> 'Factors':
        """Return the last factors."""
        return Factors._make(column[len(column) - count :] for column in self)


@kernel
def linearize_factor(
    kind: int, p: Array, q: Array, z: Array, e: Array, A: Array, B: Array
) -> None:
    """Write error e (3,) and Jacobians A, B (3, 3) of a factor between nodes at p and q (3,)."""
    A[:, :] = 0.0
    B[:, :] = 0.0
    if kind == CALIBRATION:
        for i in range(3):
            e[i] = q[i] - z[i]
            B[i, i] = 1.0
        return
    if kind == PRIOR:
        c, s = math.cos(q[2]), math.sin(q[2])
        e[0], e[1], e[2] = q[0] - z[0], q[1] - z[1], wrapped(q[2] - z[2])
        B[0, 0], B[0, 1], B[1, 0], B[1, 1], B[2, 2] = c, -s, s, c, 1.0
        return
    c, s = math.cos(p[2]), math.sin(p[2])
    dx, dy = q[0] - p[0], q[1] - p[1]
    hx, hy = c * dx + s * dy, c * dy - s * dx
    e[0], e[1] = hx - z[0], hy - z[1]
    A[0, 0], A[0, 2] = -1.0, hy
    A[1, 1], A[1, 2] = -1.0, -hx
    if kind == OBSERVATION:
        e[2] = q[2] - z[2]
        B[0, 0], B[0, 1], B[1, 0], B[1, 1], B[2, 2] = c, s, -s, c, 1.0
        return
    turn = q[2] - p[2]
    c, s = math.cos(turn), math.sin(turn)
    B[0, 0], B[0, 1], B[1, 0], B[1, 1] = c, -s, s, c
    e[2] = 0.0
    if kind == RELATIVE_POSE:
        e[2] = wrapped(turn - z[2])
        A[2, 2], B[2, 2] = -1.0, 1.0


@kernel
def _calibrate(c: int, C: Array, x: Array, e: Array) -> None:
    """Subtract from an error what its measurement changes by the calibration x[c]."""
    if c >= 0:
        for i in range(3):
            e[i] -= C[i, 0] * x[c, 0] + C[i, 1] * x[c, 1] + C[i, 2] * x[c, 2]


@kernel
def squared_norm(e: Array, W: Array) -> float:
    """Return eᵀ W e."""
    norm: float = (
        W[0, 0] * e[0] * e[0]
        + W[1, 1] * e[1] * e[1]
        + W[2, 2] * e[2] * e[2]
        + 2.0 * (W[0, 1] * e[0] * e[1] + W[0, 2] * e[0] * e[2] + W[1, 2] * e[1] * e[2])
    )
    return norm


@kernel
def robust_weight(robust: int, scale: float, q: float) -> float:
    """Return the weight of a factor in iteratively reweighted least squares; q is eᵀ W e."""
    if robust == HUBER:
        return 1.0 if q <= scale * scale else scale / math.sqrt(q)
    if robust == CAUCHY:
        return 1.0 / (1.0 + q / (scale * scale))
    return 1.0


@kernel
def robust_cost(robust: int, scale: float, q: float) -> float:
    """Return twice the loss ρ of a factor: q where it is not robust; q is eᵀ W e."""
    if robust == HUBER:
        return q if q <= scale * scale else 2.0 * scale * math.sqrt(q) - scale * scale
    if robust == CAUCHY:
        return scale * scale * math.log1p(q / (scale * scale))
    return q


@kernel
def _linearize(
    factors: Factors, f: int, x: Array, e: Array, A: Array, B: Array
) -> tuple[int, int]:
    """Write error e (3,) and Jacobians A, B (3, 3) of a factor; returns its nodes a and b.

    For a prior, a is b. Calibrated motion is corrected by the calibration at x (N, 3).
    """
    b = factors.b[f]
    a = factors.a[f] if factors.a[f] >= 0 else b
    linearize_factor(factors.kind[f], x[a], x[b], factors.z[f], e, A, B)
    _calibrate(factors.c[f], factors.C[f], x, e)
    return a, b


@kernel
def squared_norms(factors: Factors, x: Array) -> Array:
    """Return eᵀ W e (F,) of all factors with the nodes at x (N, 3)."""
    n = len(factors.kind)
    norms = np.empty(n)
    e, A, B = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    for f in range(n):
        _linearize(factors, f, x, e, A, B)
        norms[f] = squared_norm(e, factors.W[f])
    return norms


@kernel
def total_cost(factors: Factors, x: Array) -> float:
    """Return the sum of the robust costs of all factors with the nodes at x (N, 3)."""
    norms = squared_norms(factors, x)
    cost = 0.0
    for f in range(len(norms)):
        cost += robust_cost(factors.robust[f], factors.scale[f], norms[f])
    return cost


@kernel
def robust_weights(factors: Factors, x: Array) -> Array:
    """Return the robust weights (F,) of all factors with the nodes at x (N, 3)."""
    weights = squared_norms(factors, x)
    for f in range(len(weights)):
        weights[f] = robust_weight(factors.robust[f], factors.scale[f], weights[f])
    return weights


@kernel
def _add_product(H: Array, J: Array, WK: Array) -> None:
    """Add Jᵀ (W K) to a block H (3, 3)."""
    for r in range(3):
        for c in range(3):
            H[r, c] += J[0, r] * WK[0, c] + J[1, r] * WK[1, c] + J[2, r] * WK[2, c]


@kernel
def _product(W: Array, J: Array, weight: float, out: Array) -> None:
    """Write weight · W J (3, 3)."""
    for r in range(3):
        for c in range(3):
            out[r, c] = weight * (W[r, 0] * J[0, c] + W[r, 1] * J[1, c] + W[r, 2] * J[2, c])


@kernel
def assemble(
    factors: Factors,
    x: Array,
    place: Integers,
    slots: Integers,
    calibration_slots: Integers,
    diagonal: Array,
    blocks: Array,
    gradient: Array,
) -> float:
    """Sum H = Σ w Jᵀ W J and g = Σ w Jᵀ W e over all factors at x (N, 3); returns the cost.

    place (N,): row of each node in the system. slots (F,): block of `blocks` (n, 3, 3) that
    holds the factor's off-diagonal part, its row that of the node with the later place;
    calibration_slots (F, 2): those of its nodes a and b with its calibration.
    diagonal (N, 3, 3), blocks and gradient (N, 3) are overwritten.
    """
    diagonal[:] = 0.0
    blocks[:] = 0.0
    gradient[:] = 0.0
    cost = 0.0
    e, A, B = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    WA, WB = np.empty((3, 3)), np.empty((3, 3))
    C, WC = np.empty((3, 3)), np.empty((3, 3))
    for f in range(len(factors.kind)):
        a, b = _linearize(factors, f, x, e, A, B)
        W = factors.W[f]
        q = squared_norm(e, W)
        cost += robust_cost(factors.robust[f], factors.scale[f], q)
        weight = robust_weight(factors.robust[f], factors.scale[f], q)
        pb = place[b]
        _product(W, B, weight, WB)
        _add_product(diagonal[pb], B, WB)
        for i in range(3):
            gradient[pb, i] += WB[0, i] * e[0] + WB[1, i] * e[1] + WB[2, i] * e[2]
        if a == b:
            continue
        pa = place[a]
        _product(W, A, weight, WA)
        _add_product(diagonal[pa], A, WA)
        for i in range(3):
            gradient[pa, i] += WA[0, i] * e[0] + WA[1, i] * e[1] + WA[2, i] * e[2]
        if pa > pb:
            _add_product(blocks[slots[f]], A, WB)
        else:
            _add_product(blocks[slots[f]], B, WA)
        c = factors.c[f]
        if c < 0:
            continue
        pc = place[c]
        C[:, :] = -factors.C[f]
        _product(W, C, weight, WC)
        _add_product(diagonal[pc], C, WC)
        for i in range(3):
            gradient[pc, i] += WC[0, i] * e[0] + WC[1, i] * e[1] + WC[2, i] * e[2]
        if pa > pc:
            _add_product(blocks[calibration_slots[f, 0]], A, WC)
        else:
            _add_product(blocks[calibration_slots[f, 0]], C, WA)
        if pb > pc:
            _add_product(blocks[calibration_slots[f, 1]], B, WC)
        else:
            _add_product(blocks[calibration_slots[f, 1]], C, WB)
    return cost


@kernel
def _subtract_transposed(J: Array, v: Array, out: Array) -> None:
    """Subtract Jᵀ v from a vector out (3,)."""
    for i in range(3):
        out[i] -= J[0, i] * v[0] + J[1, i] * v[1] + J[2, i] * v[2]


@kernel
def steepest_descent(factors: Factors, x: Array, place: Integers, out: Array) -> float:
    """Write −g = −Σ w Jᵀ W e over all factors at x (N, 3); returns the cost. See `assemble`.

    out (N, 3): in the order of the system, overwritten.
    """
    out[:] = 0.0
    cost = 0.0
    e, We = np.empty(3), np.empty(3)
    A, B = np.empty((3, 3)), np.empty((3, 3))
    for f in range(len(factors.kind)):
        a, b = _linearize(factors, f, x, e, A, B)
        W = factors.W[f]
        q = squared_norm(e, W)
        cost += robust_cost(factors.robust[f], factors.scale[f], q)
        weight = robust_weight(factors.robust[f], factors.scale[f], q)
        for i in range(3):
            We[i] = weight * (W[i, 0] * e[0] + W[i, 1] * e[1] + W[i, 2] * e[2])
        _subtract_transposed(B, We, out[place[b]])
        if a == b:
            continue
        _subtract_transposed(A, We, out[place[a]])
        if factors.c[f] >= 0:
            _subtract_transposed(-factors.C[f], We, out[place[factors.c[f]]])
    return cost


@kernel
def moved(x: Array, step: Array, place: Integers, poses: int) -> Array:
    """Return the nodes x (N, 3) moved by a step (N, 3) in the order of the system.

    The first `poses` nodes are poses, the others landmarks.
    """
    out = np.empty_like(x)
    for n in range(len(x)):
        d = step[place[n]]
        if n < poses:
            c, s = math.cos(x[n, 2]), math.sin(x[n, 2])
            out[n, 0] = x[n, 0] + c * d[0] - s * d[1]
            out[n, 1] = x[n, 1] + s * d[0] + c * d[1]
            out[n, 2] = wrapped(x[n, 2] + d[2])
        else:
            for i in range(3):
                out[n, i] = x[n, i] + d[i]
    return out


@kernel
def antithetic_poses(x: Array, steps: Array, place: Integers, out: Array, begin: int) -> None:
    """Write to out (P, 3, M), from sample `begin` on, poses x (P, 3) moved by ± steps.

    steps (N, 3, m): in the order of the system, in which place (P,) finds the poses.
    """
    for n in range(len(x)):
        c, s = math.cos(x[n, 2]), math.sin(x[n, 2])
        along, across, turn = steps[place[n], 0], steps[place[n], 1], steps[place[n], 2]
        ox, oy, otheta = out[n, 0, begin:], out[n, 1, begin:], out[n, 2, begin:]
        for m in range(len(turn)):
            dx, dy = c * along[m] - s * across[m], s * along[m] + c * across[m]
            ox[2 * m], ox[2 * m + 1] = x[n, 0] + dx, x[n, 0] - dx
            oy[2 * m], oy[2 * m + 1] = x[n, 1] + dy, x[n, 1] - dy
            otheta[2 * m] = wrapped(x[n, 2] + turn[m])
            otheta[2 * m + 1] = wrapped(x[n, 2] - turn[m])
