"""Particles in blocks: the scratch array of the kernels, and what several kernels do with it.

The numbers of a block of particles lie in one scratch array, a row per quantity and a column per
particle: the compiler turns loops over columns into vector instructions, and the landmark rows of
a block stay in the cache from the association to the update.
"""

from explore_slam.compiled import kernel
from explore_slam.geometry import Array
from explore_slam.slam.association.gating import Choice, Locals

BLOCK = 64

# Rows of the scratch array.
PX, PY, COS, SIN = 0, 1, 2, 3  # pose at which to linearize
CD, SD, D0, D1, D2 = 4, 5, 6, 7, 8  # cos, sin of its turn, and δ, since the prediction
LM = 9  # landmark mean 9…11, covariance 12…17
ZX, ZY, VX, VY, VZ = 18, 19, 20, 21, 22  # expected x, y; residual
S = 23  # covariance of the residual, 23…28
W = 29  # its inverse, 29…34
DET = 35  # its determinant
SQ = 36  # squared length of the residual
MASK = 37  # 1 where the particle has a landmark for the observation, else 0
ETA = 38  # η, 38…40
LAMBDA = 41  # Λ: 00 01 02 11 12 22, 41…46
COST = 47  # Σ w νᵀ S⁻¹ ν + what is unmatched
PRODUCT, WEIGHTS = 48, 49  # Π |S| / |2R| and Π w, taken to COST before they run out of range
Q = 50  # posterior covariance 00 01 02 11 12 22, 50…55
WEIGHT = 56  # w
BEST, PICK = 57, 58  # least score so far and its candidate
SCRATCH = 59


@kernel(inline='always')
def load(
    w: Array,
    slab: Array,
    slots: Locals,
    candidates: Locals,
    choice: Choice,
    k: int,
    m0: int,
    n: int,
) -> bool:  # pragma: no cover - compiled
    """Load the landmark that each particle has chosen for observation k, and the mask."""
    first, having, taking = -1, 0, 0
    for i in range(n):
        first = max(first, choice[k, m0 + i])
    for i in range(n):
        j = choice[k, m0 + i]
        having += 1 if j >= 0 else 0
        taking += 1 if j == first else 0
        w[MASK, i] = 1.0 if j >= 0 else 0.0
    if first >= 0:
        row = slab[slots[candidates[k, first]]]
        for v in range(9):
            for i in range(n):
                w[LM + v, i] = row[v, m0 + i]
        if taking < having:
            for i in range(n):
                j = choice[k, m0 + i]
                if j >= 0:
                    for v in range(9):
                        w[LM + v, i] = slab[slots[candidates[k, j]], v, m0 + i]
    return first >= 0


@kernel(inline='always')
def expect(w: Array, z: Array, R: Array, k: int) -> None:  # pragma: no cover - compiled
    """Set expected observation, residual and S = Σ + R in the vehicle frame."""
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
def measure(
    w: Array, hxx: float, hxy: float, hyy: float, i: int
) -> tuple[float, float]:  # pragma: no cover - compiled
    """Return νᵀ (S + h)⁻¹ ν and |S + h| of column i, h added to the x, y part of S."""
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
