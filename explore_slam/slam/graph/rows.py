"""Landmarks given the path: rows of the filter made of the stored observations."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.geometry import Array
from explore_slam.slam.graph.factors import Integers


class StoredObservations(NamedTuple):
    """Observations of landmarks, grouped by landmark (compressed sparse rows)."""

    first: Integers  # (L + 1,) first observation of each landmark
    keyframes: Integers  # (n,) numbers
    z: Array  # (n, 3) positions in the vehicle frame (m)
    W: Array  # (n, 6) information xx xy xz yy yz zz, scaled by weight and robust weight

    def located(self, keyframes: NDArray[np.int64]) -> Integers:
        """Return (n,) the row of each observation's keyframe in an ascending list of numbers."""
        return np.searchsorted(keyframes, self.keyframes).astype(np.int64)


@kernel
def fuse_rows(
    first: Integers,
    node: Integers,
    z: Array,
    W: Array,
    poses: Array,
    out: Array,
    begin: int,
    end: int,
) -> None:
    """Write to out (L, 9, M) the landmarks that each path and the observations determine.

    N(l | Xᵐ, z) as a product of Gaussians: Λ = Σ R W Rᵀ, l = Λ⁻¹ Σ R W Rᵀ (t + R z), with
    poses (N, 3, M) of which node (n,) is the one an observation was made from. Values of a row
    are x, y, z and the covariance xx xy xz yy yz zz. Only particles begin … end are written, so
    that threads may share them.
    """
    cosines, sines = np.empty((len(poses), end - begin)), np.empty((len(poses), end - begin))
    for n in range(len(poses)):
        for m in range(end - begin):
            angle = poses[n, 2, begin + m]
            cosines[n, m], sines[n, m] = math.cos(angle), math.sin(angle)
    A, b = np.empty((6, end - begin)), np.empty((3, end - begin))
    for k in range(len(first) - 1):
        A[:] = 0.0
        b[:] = 0.0
        for o in range(first[k], first[k + 1]):
            pose, c, s = poses[node[o]], cosines[node[o]], sines[node[o]]
            zx, zy, zz = z[o, 0], z[o, 1], z[o, 2]
            wxx, wxy, wxz, wyy, wyz, wzz = W[o, 0], W[o, 1], W[o, 2], W[o, 3], W[o, 4], W[o, 5]
            for m in range(end - begin):
                cc, ss, cs = c[m] * c[m], s[m] * s[m], c[m] * s[m]
                x = pose[0, begin + m] + c[m] * zx - s[m] * zy
                y = pose[1, begin + m] + s[m] * zx + c[m] * zy
                vxx = cc * wxx - 2.0 * cs * wxy + ss * wyy
                vxy = cs * (wxx - wyy) + (cc - ss) * wxy
                vyy = ss * wxx + 2.0 * cs * wxy + cc * wyy
                vxz, vyz = c[m] * wxz - s[m] * wyz, s[m] * wxz + c[m] * wyz
                A[0, m] += vxx
                A[1, m] += vxy
                A[2, m] += vxz
                A[3, m] += vyy
                A[4, m] += vyz
                A[5, m] += wzz
                b[0, m] += vxx * x + vxy * y + vxz * zz
                b[1, m] += vxy * x + vyy * y + vyz * zz
                b[2, m] += vxz * x + vyz * y + wzz * zz
        for m in range(end - begin):
            xx, xy, xz, yy, yz, zz = A[0, m], A[1, m], A[2, m], A[3, m], A[4, m], A[5, m]
            p, q, r = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
            scale = 1.0 / (xx * p + xy * q + xz * r)
            sxx, sxy, sxz = scale * p, scale * q, scale * r
            syy, syz = scale * (xx * zz - xz * xz), scale * (xy * xz - xx * yz)
            szz = scale * (xx * yy - xy * xy)
            row = out[k]
            row[0, begin + m] = sxx * b[0, m] + sxy * b[1, m] + sxz * b[2, m]
            row[1, begin + m] = sxy * b[0, m] + syy * b[1, m] + syz * b[2, m]
            row[2, begin + m] = sxz * b[0, m] + syz * b[1, m] + szz * b[2, m]
            row[3, begin + m], row[4, begin + m], row[5, begin + m] = sxx, sxy, sxz
            row[6, begin + m], row[7, begin + m], row[8, begin + m] = syy, syz, szz
