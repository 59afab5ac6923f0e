"""The association of one update: what each observation may be, and what each particle chose."""

from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.geometry import Array
from explore_slam.slam.descriptors.kinds import Vectors
from explore_slam.slam.storage.ancestry import AncestryTree, Index
from explore_slam.slam.storage.row_format import Choice, Places
from explore_slam.slam.storage.row_store import RowStore

#: Part of the particles' weight that decides for all of them.
MAJORITY = 0.5


class Observed(NamedTuple):
    """Observations in the vehicle frame: positions z (K, 3) m, packed covariances R (K, 6) m²."""

    z: Array
    R: Array


class CandidateRows(NamedTuple):
    """Where the rows of the candidates lie, as the kernels see it.

    rows (addresses, 9, M); addresses (L,) of the landmarks; candidates (K, J): places in
    addresses, or -1; distances (K, J) of descriptors; shared (L,): candidate of several
    observations.
    """

    rows: Array
    addresses: Places
    candidates: Places
    distances: Array
    shared: NDArray[np.bool_]


class Associations(NamedTuple):
    """What the particles chose, written by the kernels.

    choice (K, M): number of the candidate, or -1; mahalanobis_squared (K, M) d² of it (engine
    paper); robust_weight (K, M) w, 1 for an inlier (engine fastslam2).
    """

    choice: Choice
    mahalanobis_squared: Array
    robust_weight: Array

    @classmethod
    def undecided(cls, observations: int, particles: int) -> Self:
        """Return arrays for K observations and M particles in which nothing is chosen."""
        return cls(
            np.full((observations, particles), -1, np.int16),
            np.full((observations, particles), np.inf),
            np.ones((observations, particles)),
        )

    def resampled(self, ancestors: Index) -> Self:
        """Return what the ancestors (M,) of the particles chose."""
        return type(self)(
            np.ascontiguousarray(self.choice[:, ancestors]),
            np.ascontiguousarray(self.mahalanobis_squared[:, ancestors]),
            np.ascontiguousarray(self.robust_weight[:, ancestors]),
        )


@kernel
def support(choice: Choice, weights: Array, candidates: int) -> Array:  # pragma: no cover
    """Return (K, J): the weight of the particles (M,) that chose each candidate."""
    total = np.zeros((len(choice), candidates))
    for k in range(len(choice)):
        for m in range(len(weights)):
            j = choice[k, m]
            if j >= 0:
                total[k, j] += weights[m]
    return total


@kernel
def mean_robust_weights(chosen: Associations, weights: Array) -> Array:  # pragma: no cover
    """Return (K,): the mean robust weight of each observation over the particles (M,) that use it.

    It is 1 where no particle does.
    """
    means = np.ones(len(chosen.choice))
    for k in range(len(means)):
        total, using = 0.0, 0.0
        for m in range(len(weights)):
            if chosen.choice[k, m] >= 0:
                total += weights[m] * chosen.robust_weight[k, m]
                using += weights[m]
        if using > 0.0:
            means[k] = total / using
    return means


@dataclass(frozen=True)
class CandidateSet:
    """Observations, and the landmarks that each may be by descriptor and place.

    vectors (K, D) of the descriptors; entries (L,): the candidates' landmarks in the map;
    candidates (K, J): places in entries, or -1; distances (K, J) of descriptors;
    similar_ids (K, A): ids of all landmarks within reach with a similar descriptor, or -1;
    is_distinctive (K,): the descriptor passes Lowe's ratio test (see ratio_test);
    hidden: which entries of the whole map are in another frame than the vehicle, None: no entry.
    withheld (K,): not to become landmarks (see reacquisition), None: no observation.

    Covariances of `measured` are those of each observation by itself: with them it is associated.
    Those of `observed` are inflated where observations repeat earlier ones, and update the filter.
    """

    measured: Observed
    observed: Observed
    vectors: Vectors
    entries: Places
    candidates: Places
    distances: Array
    similar_ids: Places
    is_distinctive: NDArray[np.bool_]
    hidden: NDArray[np.bool_] | None = None
    withheld: NDArray[np.bool_] | None = None

    def __len__(self) -> int:
        """Return the number of observations."""
        return len(self.observed.z)

    def has_similar(self) -> NDArray[np.bool_]:
        """Return (K,) whether any landmark within reach has a similar descriptor."""
        similar: NDArray[np.bool_] = (self.similar_ids >= 0).any(axis=1)
        return similar

    def rows_at(self, rows: Array, addresses: Places) -> CandidateRows:
        """Return the view of the kernels on rows (addresses, 9, M) of the candidates."""
        used = self.candidates[self.candidates >= 0]
        shared = np.bincount(used, minlength=1) > 1
        return CandidateRows(rows, addresses, self.candidates, self.distances, shared)


class AssociationState:
    """A candidate set whose rows are staged in the workspace, and the choices of all particles."""

    def __init__(self, found: CandidateSet, store: RowStore, tree: AncestryTree) -> None:
        self.found = found
        self.store = store
        self.tree = tree
        self.addresses = store.stage(found.entries, tree)
        self.chosen = Associations.undecided(len(found), store.particles)

    def rows(self) -> CandidateRows:
        """Return the view of the kernels on the staged rows."""
        return self.found.rows_at(self.store.workspace, self.addresses)

    def restrict(self, found: CandidateSet) -> None:
        """Choose anew among fewer candidates, for the same observations and entries."""
        self.found = found
        self.chosen = Associations.undecided(len(found), self.store.particles)

    def discard(self) -> None:
        """Free the staged rows; nothing of this update has been committed."""
        self.store.discard(self.found.entries, self.addresses, self.tree)

    def follow(self, ancestors: Index) -> None:
        """Take over the choices of the ancestors (M,), and stage the rows again.

        The rows must have been discarded before the resampling.
        """
        self.addresses = self.store.stage(self.found.entries, self.tree)
        self.chosen = self.chosen.resampled(ancestors)

    def is_chosen(self) -> NDArray[np.bool_]:
        """Return (L,) which landmarks were chosen by any particle."""
        return chosen_landmarks(self.found, self.chosen)

    def support(self, weights: Array) -> Array:
        """Return (K, J): the weight of the particles (M,) that chose each candidate."""
        return support(self.chosen.choice, weights, self.found.candidates.shape[1])

    def robust_weights(self, weights: Array) -> Array:
        """Return (K,) the mean robust weight of each observation; weights (M,): of particles."""
        return mean_robust_weights(self.chosen, weights)

    def ids_in(self, particle: int, ids: Places) -> Places:
        """Return (K,) the id of the landmark that a particle chose, or -1; ids (n,) by entry."""
        choice = self.chosen.choice[:, particle].astype(np.int64)
        places = np.take_along_axis(self.found.candidates, np.maximum(choice, 0)[:, None], 1)[:, 0]
        chosen: Places = np.full(len(choice), -1, np.int64)
        real = choice >= 0
        chosen[real] = ids[self.found.entries[places[real]]]
        return chosen


def chosen_landmarks(found: CandidateSet, chosen: Associations) -> NDArray[np.bool_]:
    """Return (L,) which landmarks were chosen by any particle."""
    taken = np.zeros(len(found.entries), bool)
    for j in range(found.candidates.shape[1]):
        some = (chosen.choice == j).any(axis=1)
        taken[found.candidates[some, j]] = True
    return taken
