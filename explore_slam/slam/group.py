"""Vehicles whose beliefs hang together, and their particles.

While two vehicles have seen no landmark in common and not each other, nothing that one of them
sees says anything about the other: the joint posterior is the product of two, and each is held by
particles of its own. What one vehicle sees then does not thin out the particles of the other.
With the first thing in common the groups become one: particles are paired at random, which is a
sample of the product. Landmarks and keyframes stay where they are; they hang on the genealogies
of the groups, which go on together.
"""

import math
from collections.abc import Callable

import numpy as np

from explore_slam.geometry import Array
from explore_slam.slam.genealogy import Genealogy, Index
from explore_slam.slam.resampling import effective_particles, normalized
from explore_slam.slam.row_store import RowStore


class Group:
    """The particles of vehicles (numbers): weights, and what descends from whom.

    New rows hang on the first of the genealogies; the others are of groups that have joined.
    """

    def __init__(self, vehicles: list[int], particles: int) -> None:
        self.vehicles = vehicles
        self.log_weights = np.full(particles, -math.log(particles))
        self.score = np.zeros(particles)
        self.genealogies = [Genealogy(particles)]

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

    def partners(self, other: 'Group', random: np.random.Generator) -> Index:
        """Draw (M,) which particle of the other group goes with each of this one.

        The best go together, so that the lineage taken for the truth stays the same.
        """
        order = random.permutation(len(self.score)).astype(np.int32)
        here, there = self.best(), int(np.flatnonzero(order == other.best())[0])
        order[[here, there]] = order[[there, here]]
        return order

    def joined(self, other: 'Group', order: Index) -> 'Group':
        """Return one group of both; the genealogies of the other are put in order (M,)."""
        for genealogy in other.genealogies:
            genealogy.permute(order)
        group = Group(sorted(self.vehicles + other.vehicles), len(order))
        group.log_weights, _ = normalized(self.log_weights + other.log_weights[order])
        group.score = self.score + other.score[order]
        group.genealogies = [*self.genealogies, *other.genealogies]
        return group


class Groups:
    """All groups; every vehicle is in one of them."""

    def __init__(self, groups: list[Group]) -> None:
        self.all = groups

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
        self, first: Group, others: list[Group], poses: Array, random: np.random.Generator
    ) -> Callable[[], None]:
        """Make one group of the first and others; returns how to take it back.

        The poses (V, M, 3) of all vehicles are put in the new order in place.
        """
        before, poses_before = list(self.all), poses.copy()
        orders: list[tuple[Group, Index]] = []
        for other in others:
            order = first.partners(other, random)
            orders.append((other, order))
            poses[other.vehicles] = poses[other.vehicles][:, order]
            joined = first.joined(other, order)
            self.all = [joined if group is first else group for group in self.all]
            self.all.remove(other)
            first = joined

        def take_back() -> None:
            for other, order in orders:
                for genealogy in other.genealogies:
                    genealogy.permute(np.argsort(order).astype(np.int32))
            self.all, poses[:] = before, poses_before

        return take_back
