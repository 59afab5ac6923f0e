"""Lowe's ratio test on landmarks: which observations have a distinctive descriptor.

A similar descriptor somewhere in the map says little, because textures repeat. A match is
distinctive if its distance is far smaller than that to any landmark at another place (Lowe,
"Distinctive image features from scale-invariant keypoints", 2004, section 7.1).
"""

import numpy as np
from numpy.typing import NDArray

from explore_slam.geometry import Array
from explore_slam.slam.descriptors.index import Distances, Ids
from explore_slam.slam.descriptors.kinds import DescriptorKind

# Landmarks closer together than this (m) are one place: several features of one object.
# Chosen by hand; test_ratio_test shows what it decides.
_SAME_PLACE = 0.5


def is_distinctive(
    nearest: Ids, distances: Distances, reference: Array, limit: float, kind: DescriptorKind
) -> NDArray[np.bool_]:
    """Return (K,) whether the nearest descriptor is distinctive among all those compared.

    nearest (K, A): entries within the limit, nearest first, or -1; distances (K, A) to them;
    reference (n, 3): positions of all entries (m). The distance to a landmark that is not among
    the nearest is at least the limit.
    """
    found = nearest[:, 0] >= 0
    if not found.any():
        return found
    apart = np.linalg.norm(reference[nearest] - reference[nearest[:, :1]], axis=2)
    elsewhere = np.where((nearest >= 0) & (apart > _SAME_PLACE), distances, limit)
    least = distances[:, 0]
    distinctive: NDArray[np.bool_] = found & (
        (least <= kind.same) | (least <= kind.ratio * elsewhere.min(axis=1))
    )
    return distinctive
