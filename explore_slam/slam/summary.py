"""The result of an update."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class UpdateSummary:
    """What one update did.

    observed: landmarks observed; with_candidates: of these, with a candidate in the map;
    associated: updated in the best particle; inserted, removed: landmarks; effective_particles:
    before resampling; redrawn: all paths were redrawn from the joint posterior; lost: the matches
    contradict the pose in nearly all particles; relocated: the vehicle was given the pose that
    its matches agree on; closed: that pose was plausible after the drift since, so that its path
    was corrected as well; retracted: an earlier closure that contradicts it was retracted; joined:
    it was in a frame of its own, and its matches located that frame in the map.
    matches (observed,): id of the landmark that the best particle associated with each
    observation, or -1; ids as in the Landmarks of the vehicle. together: the vehicles, this one
    included, whose poses are correlated so far because they have observed landmarks in common or
    each other.
    """

    stamp: float
    vehicle: str
    observed: int
    with_candidates: int
    associated: int
    inserted: int
    removed: int
    effective_particles: float
    resampled: bool
    redrawn: bool
    lost: bool
    relocated: bool
    matches: NDArray[np.int64]
    together: tuple[str, ...]
    joined: bool = False
    closed: bool = False
    retracted: bool = False
