"""What an update reports."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class UpdateSummary:
    """What one update did.

    observed: landmarks observed; matched: of these, with a like descriptor in the map;
    associated: updated in the best particle; inserted: new landmarks; removed: forgotten ones;
    effective_particles before a resampling; lost: matches disagree with the pose in nearly all
    particles; relocated: the vehicle has been moved to where its matches say.
    matches (observed,): id of the landmark that the best particle took each observation for, or
    -1; ids as in the Landmarks of the vehicle. together: the vehicles, this one included, that
    have landmarks in common so far, directly or through others.
    """

    stamp: float
    vehicle: str
    observed: int
    matched: int
    associated: int
    inserted: int
    removed: int
    effective_particles: float
    resampled: bool
    lost: bool
    relocated: bool
    matches: NDArray[np.int64]
    together: tuple[str, ...]
