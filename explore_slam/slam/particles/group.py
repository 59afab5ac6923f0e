"""Vehicles whose beliefs hang together, and their particles.

While two vehicles have seen no landmark in common and not each other, nothing that one of them
sees says anything about the other: the joint posterior is the product of two, and each is held by
particles of its own. What one vehicle sees then does not thin out the particles of the other.
With the first thing in common the groups become one: many random pairs of particles are tried,
samples of the product, and those that explain what is seen are kept. Landmarks and keyframes stay
where they are; they hang on the genealogies of the groups, which go on together.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np

from explore_slam.geometry import Array
from explore_slam.slam.particles.resampling import (
    effective_particles,
    normalized,
    systematic_ancestors,
)
from explore_slam.slam.storage.ancestry import Genealogy, Index
from explore_slam.slam.storage.row_store import RowStore

PAIRINGS = 16  # times as many pairs are tried as there are particles where groups join


class Group:
    """The particles of vehicles (numbers): weights, and what descends from whom.

    New rows hang on the first of the genealogies; the others are of groups that have joined.
    """

    def __init__(
        self, vehicles: list[int], particles: int, genealogies: list[Genealogy] | None = None
    ) -> None:
        self.vehicles = vehicles
        self.log_weights = np.full(particles, -math.log(particles))
        self.score = np.zeros(particles)
        self.genealogies = genealogies or [Genealogy(particles)]

    @property
    def home(self) -> Genealogy:
        """The genealogy that new rows hang on."""
        return self.genealogies[0]

    def weights(self) -> Array:
        """Return the normalized weights (M,)."""
        return np.exp(self.log_weights)

    def effective(self) -> float:
        """Return the effective sample size, 1 … M."""
        return effective_particles(self.weights())

    def weigh(self, log_weights: Array) -> None:
        """Multiply the weights by likelihoods, given as logarithms (M,)."""
        shifted = log_weights - log_weights.max()
        self.score = self.score + shifted
        self.score -= self.score.max()
        self.log_weights, _ = normalized(self.log_weights + shifted)

    def best(self) -> int:
        """Return the particle whose whole lineage is likeliest, which seldom changes."""
        return int(np.argmax(self.score))

    def descend(self, ancestors: Index) -> None:
        """Replace the particles by descendants, equal in weight, of ancestors (M,)."""
        self.score = self.score[ancestors]
        self.log_weights = np.full(len(ancestors), -math.log(len(ancestors)))
        for genealogy in self.genealogies:
            for layout in genealogy.resample(ancestors):
                owner = layout.owner
                assert isinstance(owner, RowStore)
                owner.compact(layout)
        self.genealogies[1:] = [item for item in self.genealogies[1:] if not item.is_empty()]


class Groups:
    """All groups; every vehicle is in one of them, at first in its own unless they are joint."""

    def __init__(self, vehicles: int, particles: int, *, joint: bool) -> None:
        numbers = range(vehicles)
        groups = [list(numbers)] if joint else [[number] for number in numbers]
        self.all = [Group(members, particles) for members in groups]

    def of(self, vehicle: int) -> Group:
        """Return the group of a vehicle (number)."""
        return next(group for group in self.all if vehicle in group.vehicles)

    def on(self, homes: set[Genealogy]) -> list[Group]:
        """Return the groups that these genealogies belong to."""
        return [group for group in self.all if not homes.isdisjoint(group.genealogies)]

    def best_particles(self) -> dict[Genealogy, int]:
        """Return the best particle of the group that each genealogy belongs to."""
        return {home: group.best() for group in self.all for home in group.genealogies}

    def join(
        self,
        first: Group,
        others: list[Group],
        likelihood: Callable[[Sequence[Index]], Array],
        poses: Array,
        random: np.random.Generator,
    ) -> Index:
        """Make one group of several whose vehicles have met; return ancestors (M,) in the first.

        likelihood gives the logarithms (M,) of how likely what is seen now is, if the first's
        particles go with the particles (M,) of each other group that it is told. The new group
        is drawn from some random pairs by that likelihood, and weighs it out again: what is seen
        is still to be told. The poses (V, M, 3) of all vehicles follow in place.
        """
        particles = len(first.score)
        orders = np.array(
            [[random.permutation(particles) for _ in others] for _ in range(PAIRINGS)], np.int32
        )
        seen = np.array([likelihood(list(order)) for order in orders])
        log_weights = seen + first.log_weights
        for number, other in enumerate(others):
            log_weights += other.log_weights[orders[:, number]]
        _, weights = normalized(log_weights.T.ravel())
        chosen = systematic_ancestors(weights, float(random.random()), particles)
        ancestors, pairing = np.divmod(chosen, np.int32(PAIRINGS))
        parts = [first, *others]
        for number, part in enumerate(parts):
            mine = orders[pairing, number - 1, ancestors] if number else ancestors
            poses[part.vehicles] = poses[part.vehicles][:, mine]
            part.descend(mine)
        joined = Group(
            sorted(vehicle for part in parts for vehicle in part.vehicles),
            particles,
            [genealogy for part in parts for genealogy in part.genealogies],
        )
        joined.score = np.sum([part.score for part in parts], axis=0)
        joined.log_weights, _ = normalized(-seen[pairing, ancestors])
        apart = [group for group in self.all if group not in parts]
        self.all = sorted([joined, *apart], key=lambda group: group.vehicles[0])
        return ancestors
