"""Lone matches: associations with landmarks that a vehicle returns to, but too few to be believed.

Descriptors of different places can be alike, and a wide gate finds such a look-alike for one
observation in a hundred (0.8 % of 4,500 associations in the simulated office, without laser).
Among dozens of right ones it does no harm. But where a vehicle has lost sight of what it mapped, a
single one would decide the pose, the landmarks inserted next would agree with it, and nothing
would contradict it any more. Landmarks that a vehicle has not observed just before are therefore
associated only when several of the same visit are at once. As in RANSAC, two can determine a pose,
and a third must agree with it. Those of a later visit do not confirm them: their own errors are
those of the pose.
"""

from dataclasses import replace

import numpy as np

from explore_slam.geometry import Array
from explore_slam.slam.association.state import MAJORITY, CandidateSet

_MINIMUM_REACQUIRED = 3
# of the observations of an update: twice the fraction that is associated wrongly
_MINIMUM_FRACTION = 0.02
_NEVER = 1e9  # in place of an infinite age


def without_lone_matches(
    found: CandidateSet, support: Array, ages: Array, same: float
) -> CandidateSet | None:
    """Return the candidates without landmarks that are reacquired, if these are too few.

    support (K, J): part of the particles' weight that chose each candidate; ages (L,): motion
    since the vehicle observed each landmark, in units of what takes one out of its view, infinite
    if it never did. Landmarks of an age of 1 or less are in view; others belong to one visit if no
    two successive ages are more than 1 apart. A landmark whose descriptor is within the distance
    `same` of the observed one is told by it alone, as by a bar code, and stays a candidate.

    Observations of which most of the weight chose one that is left out do not become landmarks
    either: these would be duplicates if the match was right. None: nothing is to be left out.
    """
    exists = found.candidates >= 0
    age = np.where(exists, np.minimum(ages, _NEVER)[found.candidates], 0.0)
    returning = age > 1.0
    lone = returning & (found.distances > same)
    if not support[lone].any():  # without one that a particle has chosen the proposal is the same
        return None
    needed = max(_MINIMUM_REACQUIRED, _MINIMUM_FRACTION * len(found))
    confirmed = _confirmed_ages(np.sort(age[returning & (support > MAJORITY)]), needed)
    if len(confirmed):
        place = np.searchsorted(confirmed, age).clip(0, len(confirmed) - 1)
        nearest = np.minimum(
            np.abs(confirmed[place] - age), np.abs(confirmed[np.maximum(place - 1, 0)] - age)
        )
        lone &= nearest > 1.0
        if not support[lone].any():
            return None
    withheld = (support * lone).sum(axis=1) > MAJORITY
    return replace(
        found,
        candidates=np.where(lone, -1, found.candidates),
        similar_ids=np.where(withheld[:, None], -1, found.similar_ids),
        is_distinctive=found.is_distinctive & ~withheld,
        withheld=withheld,
    )


def _confirmed_ages(ages: Array, needed: float) -> Array:
    """Return those of ascending ages (n,) that are of visits with enough landmarks."""
    visits = np.split(ages, np.flatnonzero(np.diff(ages) > 1.0) + 1)
    return np.concatenate([np.empty(0), *(visit for visit in visits if len(visit) >= needed)])
