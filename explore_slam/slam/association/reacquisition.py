"""Lone matches: associations with landmarks that a vehicle returns to, but too few to be believed.

Descriptors of different places can be alike, and a wide gate finds such a look-alike for one
observation in a hundred (0.8 % of 4,500 associations in the simulated office, without laser).
Among dozens of right ones it does no harm. But where a vehicle has lost sight of what it mapped, a
single one would decide the pose, the landmarks inserted next would agree with it, and nothing
would contradict it any more. Landmarks that a vehicle has not observed just before are therefore
associated only when several are at once. As in RANSAC, two can determine a pose, and a third must
agree with it.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from explore_slam.geometry import Array
from explore_slam.slam.association.state import MAJORITY, CandidateSet

_MINIMUM_REACQUIRED = 3
# of the observations of an update: twice the fraction that is associated wrongly
_MINIMUM_FRACTION = 0.02


def without_lone_matches(
    found: CandidateSet, support: Array, recent: NDArray[np.bool_], same: float
) -> CandidateSet | None:
    """Return the candidates without landmarks that are reacquired, if these are too few.

    support (K, J): part of the particles' weight that chose each candidate; recent (L,): landmarks
    that the vehicle observed just before. A landmark whose descriptor is within the distance
    `same` of the observed one is told by it alone, as by a bar code, and stays a candidate.

    Observations of which most of the weight chose one that is left out do not become landmarks
    either: these would be duplicates if the match was right. None: nothing is to be left out.
    """
    exists = found.candidates >= 0
    returning = exists & ~recent[found.candidates]
    reacquired = (support * returning).sum(axis=1) > MAJORITY
    needed = max(_MINIMUM_REACQUIRED, _MINIMUM_FRACTION * len(found))
    lone = returning & (found.distances > same)
    if np.count_nonzero(reacquired) >= needed or not lone.any():
        return None
    withheld = (support * lone).sum(axis=1) > MAJORITY
    return replace(
        found,
        candidates=np.where(lone, -1, found.candidates),
        similar_ids=np.where(withheld[:, None], -1, found.similar_ids),
        is_distinctive=found.is_distinctive & ~withheld,
        withheld=withheld,
    )
