"""Particles in blocks: the scratch array of the update kernels, and what they have in common.

BLOCK particles at a time are worked on in one scratch array `w` (SCRATCH, BLOCK): a row per
quantity, a column per particle. The compiler turns loops over columns into vector instructions,
and the landmark rows of a block stay in the cache from the association to the accumulation.

    rows      contents (of each particle of the block)                        written by
    PX … SIN  pose to linearize at: x, y, cos and sin of the heading          linearize
    CD … D2   cos and sin of the turn, and δ, since the predicted pose        linearize
    LM … + 8  row of the landmark (storage.row_format)                        load
    ZX, ZY    expected observation; z needs no linearization                  expect
    VX … VZ   innovation ν                                                    expect
    S … + 5   covariance of the innovation, packed                            expect
    W … + 5   its inverse, packed; DET its determinant                        invert
    SQ        d²                                                              associate
    MASK      1 if the particle has a landmark for the observation, else 0    load
    ETA, LAMBDA   information vector η (3), matrix Λ (packed)                 accumulate
    COST      Σ w d² + terms of unmatched observations; −2 ln likelihood      accumulate, solve
    PRODUCT, WEIGHTS  Π |S| / |2R|, Π w: their powers of two go to COST       accumulate
    Q … + 5   posterior covariance of the pose error, packed                  solve
    WEIGHT    robust weight w of the observation                              reweight
    BEST, PICK    lowest score so far and its candidate                        associate
"""

from explore_slam.compiled import kernel
from explore_slam.geometry import Array
from explore_slam.slam.association.state import CandidateRows, Observed
from explore_slam.slam.storage.row_format import Choice

BLOCK = 64  # particles: the scratch array (30 kB) fits into a first-level cache of 32 kB

PX, PY, COS, SIN = 0, 1, 2, 3
CD, SD, D0, D1, D2 = 4, 5, 6, 7, 8
LM = 9
ZX, ZY, VX, VY, VZ = 18, 19, 20, 21, 22
S = 23
W = 29
DET = 35
SQ = 36
MASK = 37
ETA = 38
LAMBDA = 41
COST = 47
PRODUCT, WEIGHTS = 48, 49
Q = 50
WEIGHT = 56
BEST, PICK = 57, 58
SCRATCH = 59


@kernel(inline='always')
def count_choices(
    choice: Choice, k: int, m0: int, n: int
) -> tuple[int, int, int]:  # pragma: no cover - compiled
    """Return one of the candidates that particles m0 … m0 + n chose for observation k, or -1.

    Also returns how many of them chose any candidate, and how many chose this one: mostly all.
    """
    first, having, taking = -1, 0, 0
    for i in range(n):
        first = max(first, choice[k, m0 + i])
    for i in range(n):
        j = choice[k, m0 + i]
        having += 1 if j >= 0 else 0
        taking += 1 if j == first else 0
    return first, having, taking


@kernel(inline='always')
def load(
    w: Array, rows: CandidateRows, choice: Choice, k: int, m0: int, n: int
) -> bool:  # pragma: no cover - compiled
    """Load the landmark that each particle m0 … m0 + n chose for observation k, and the mask.

    Returns whether any of them chose one.
    """
    slab, addresses, candidates = rows.rows, rows.addresses, rows.candidates
    first, having, taking = count_choices(choice, k, m0, n)
    for i in range(n):
        w[MASK, i] = 1.0 if choice[k, m0 + i] >= 0 else 0.0
    if first >= 0:
        row = slab[addresses[candidates[k, first]]]
        for v in range(9):
            for i in range(n):
                w[LM + v, i] = row[v, m0 + i]
        if taking < having:
            for i in range(n):
                j = choice[k, m0 + i]
                if j >= 0:
                    for v in range(9):
                        w[LM + v, i] = slab[addresses[candidates[k, j]], v, m0 + i]
    return first >= 0


@kernel(inline='always')
def expect(w: Array, observed: Observed, k: int) -> None:  # pragma: no cover - compiled
    """Set expected observation k, innovation and S = Σ + R in the vehicle frame."""
    z, R = observed.z, observed.R
    z0, z1, z2 = z[k, 0], z[k, 1], z[k, 2]
    r0, r1, r2, r3, r4, r5 = R[k, 0], R[k, 1], R[k, 2], R[k, 3], R[k, 4], R[k, 5]
    for i in range(BLOCK):
        c, s = w[COS, i], w[SIN, i]
        dx, dy = w[LM, i] - w[PX, i], w[LM + 1, i] - w[PY, i]
        zx, zy = c * dx + s * dy, c * dy - s * dx
        w[ZX, i], w[ZY, i] = zx, zy
        w[VX, i], w[VY, i], w[VZ, i] = z0 - zx, z1 - zy, z2 - w[LM + 2, i]
        xx, xy, xz = w[LM + 3, i], w[LM + 4, i], w[LM + 5, i]
        yy, yz = w[LM + 6, i], w[LM + 7, i]
        cc, cs, ss = c * c, c * s, s * s
        w[S, i] = cc * xx + 2.0 * cs * xy + ss * yy + r0
        w[S + 1, i] = cs * (yy - xx) + (cc - ss) * xy + r1
        w[S + 2, i] = c * xz + s * yz + r2
        w[S + 3, i] = ss * xx - 2.0 * cs * xy + cc * yy + r3
        w[S + 4, i] = c * yz - s * xz + r4
        w[S + 5, i] = w[LM + 8, i] + r5


@kernel(inline='always')
def mahalanobis_squared(
    w: Array, hxx: float, hxy: float, hyy: float, i: int
) -> tuple[float, float]:  # pragma: no cover - compiled
    """Return νᵀ (S + h)⁻¹ ν and |S + h| of column i; h is added to the x, y part of S."""
    xx, xy, xz = w[S, i] + hxx, w[S + 1, i] + hxy, w[S + 2, i]
    yy, yz, zz = w[S + 3, i] + hyy, w[S + 4, i], w[S + 5, i]
    a, b, d = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    determinant = xx * a + xy * b + xz * d
    vx, vy, vz = w[VX, i], w[VY, i], w[VZ, i]
    square = (
        a * vx * vx
        + (xx * zz - xz * xz) * vy * vy
        + (xx * yy - xy * xy) * vz * vz
        + 2.0 * (b * vx * vy + d * vx * vz + (xy * xz - xx * yz) * vy * vz)
    )
    return square / determinant, determinant


@kernel(inline='always')
def invert(w: Array) -> None:  # pragma: no cover - compiled
    """Set W = S⁻¹ and |S|."""
    for i in range(BLOCK):
        xx, xy, xz = w[S, i], w[S + 1, i], w[S + 2, i]
        yy, yz, zz = w[S + 3, i], w[S + 4, i], w[S + 5, i]
        a, b, d = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
        determinant = xx * a + xy * b + xz * d
        r = 1.0 / determinant
        w[DET, i] = determinant
        w[W, i], w[W + 1, i], w[W + 2, i] = r * a, r * b, r * d
        w[W + 3, i] = r * (xx * zz - xz * xz)
        w[W + 4, i] = r * (xy * xz - xx * yz)
        w[W + 5, i] = r * (xx * yy - xy * xy)
