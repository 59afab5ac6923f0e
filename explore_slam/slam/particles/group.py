"""Groups of vehicles whose poses are correlated, with the particles of each group.

While two vehicles have not observed a landmark in common nor each other, their posteriors are
independent: the joint posterior is the product of two, and each is represented by particles of its
own. What one vehicle observes then does not deplete the particles of the other. With the first
observation in common the groups are merged: many random pairs of particles, which are samples of
the product, are weighted by that observation, and the new particles are drawn from them. Landmarks
and keyframes stay as they are; they belong to the ancestry trees of the groups, which the merged
group keeps.
"""

import math
from collections.abc import Callable, Sequence
from typing import Self

import numpy as np

from explore_slam.geometry import Array
from explore_slam.slam.checkpoint import State, part, under
from explore_slam.slam.particles.joint_samples import JointSamples
from explore_slam.slam.particles.resampling import (
    effective_particles,
    normalized,
    systematic_ancestors,
)
from explore_slam.slam.storage.ancestry import AncestryTree, Index, LayoutOwner

# Random pairs per particle that are weighted when groups merge: more pairs give better samples and
# a longer update. Chosen by hand; test_group shows that merged groups are consistent with it.
PAIRINGS = 16

# Log-likelihoods (M,) of the current observations if particle m of the first group is paired with
# particle order[m] of each other group.
PairLikelihood = Callable[[Sequence[Index]], Array]


class Group:
    """The particles of some vehicles (numbers): weights and ancestry.

    log_weights (M,) of the normalized weights; score (M,): log-likelihood of the whole lineage of
    each particle, 0 for the best. New rows belong to the first of the trees; the others are those
    of groups that have been merged into this one. samples: the draws from the joint graph that the
    particles descend from, one for each of the merged groups.
    """

    def __init__(
        self, vehicles: list[int], particles: int, trees: list[AncestryTree] | None = None
    ) -> None:
        self.vehicles = vehicles
        self.log_weights = np.full(particles, -math.log(particles))
        self.score = np.zeros(particles)
        self.trees = trees or [AncestryTree(particles)]
        self.samples: list[JointSamples] = []

    @property
    def tree(self) -> AncestryTree:
        """The ancestry tree that new rows belong to."""
        return self.trees[0]

    def weights(self) -> Array:
        """Return the normalized weights (M,)."""
        return np.exp(self.log_weights)

    def effective_particles(self) -> float:
        """Return the effective sample size, 1 to M."""
        return effective_particles(self.weights())

    def reweight(self, log_likelihoods: Array) -> None:
        """Multiply the weights by likelihoods, given as logarithms (M,)."""
        shifted = log_likelihoods - log_likelihoods.max()
        self.score = self.score + shifted
        self.score -= self.score.max()
        self.log_weights, _ = normalized(self.log_weights + shifted)

    def best_particle(self) -> int:
        """Return the particle whose whole lineage is most likely; it seldom changes."""
        return int(np.argmax(self.score))

    def resample(self, ancestors: Index) -> None:
        """Replace the particles by copies, of equal weight, of the ancestors (M,)."""
        self.score = self.score[ancestors]
        self.log_weights = np.full(len(ancestors), -math.log(len(ancestors)))
        for tree in self.trees:
            for layout in tree.resample(ancestors):
                layout.owner.compact(layout)
        for samples in self.samples:
            samples.resample(ancestors)
        self.trees[1:] = [tree for tree in self.trees[1:] if not tree.is_empty()]

    def state_dict(self, stores: Sequence[LayoutOwner]) -> State:
        """Return weights and ancestry; stores: all that keep rows for its trees."""
        state: State = {
            'vehicles': np.array(self.vehicles, np.int64),
            'log_weights': self.log_weights,
            'score': self.score,
            'trees': np.array(len(self.trees)),
            'samples': np.array(len(self.samples)),
        }
        for number, samples in enumerate(self.samples):
            state |= under(f'samples{number}', samples.state_dict())
        for number, tree in enumerate(self.trees):
            state |= under(f'tree{number}', tree.state_dict(stores))
        return state

    @classmethod
    def from_state(cls, state: State, stores: Sequence[LayoutOwner]) -> Self:
        """Return a group as saved; the stores must have been restored before."""
        particles = len(state['score'])
        trees = [AncestryTree(particles) for _ in range(int(state['trees']))]
        group = cls(state['vehicles'].tolist(), particles, trees)
        group.log_weights, group.score = state['log_weights'].copy(), state['score'].copy()
        for number, tree in enumerate(trees):
            tree.restore(part(f'tree{number}', state), stores)
        group.samples = [
            JointSamples.from_state(part(f'samples{number}', state))
            for number in range(int(state['samples']))
        ]
        return group


class Groups:
    """All groups. Every vehicle is in one of them: at first in its own, or all in one if joint."""

    def __init__(self, vehicles: int, particles: int, *, joint: bool) -> None:
        numbers = range(vehicles)
        groups = [list(numbers)] if joint else [[number] for number in numbers]
        self.all = [Group(members, particles) for members in groups]

    def of(self, vehicle: int) -> Group:
        """Return the group of a vehicle (number)."""
        return next(group for group in self.all if vehicle in group.vehicles)

    def with_trees(self, trees: set[AncestryTree]) -> list[Group]:
        """Return the groups that any of these ancestry trees belongs to."""
        return [group for group in self.all if not trees.isdisjoint(group.trees)]

    def with_samples(self, number: int) -> tuple[Group, JointSamples]:
        """Return the group whose particles descend from a draw, and the draw."""
        return next(
            (group, samples)
            for group in self.all
            for samples in group.samples
            if samples.number == number
        )

    def replace(self, group: Group) -> None:
        """Replace all groups that share vehicles with a group by it."""
        apart = [other for other in self.all if not set(other.vehicles) & set(group.vehicles)]
        self.all = sorted([group, *apart], key=lambda other: other.vehicles[0])

    def merge(
        self,
        first: Group,
        others: list[Group],
        likelihood: PairLikelihood,
        states: Array,
        random: np.random.Generator,
    ) -> Index:
        """Merge groups into one and return the ancestors (M,) of its particles in the first.

        The particles are drawn from random pairs in proportion to the likelihood of the current
        observations. Their weights are the inverse of it, so that the observations are not used
        twice by the update that follows. The states (V, M, S) of all vehicles are resampled in
        place.
        """
        particles = len(first.score)
        orders = np.array(
            [[random.permutation(particles) for _ in others] for _ in range(PAIRINGS)], np.int32
        )
        likelihoods = np.array([likelihood(list(order)) for order in orders])
        log_weights = likelihoods + first.log_weights
        for number, other in enumerate(others):
            log_weights += other.log_weights[orders[:, number]]
        _, weights = normalized(log_weights.T.ravel())
        chosen = systematic_ancestors(weights, float(random.random()), particles)
        ancestors, pairing = np.divmod(chosen, np.int32(PAIRINGS))
        parts = [first, *others]
        for number, group in enumerate(parts):
            mine = orders[pairing, number - 1, ancestors] if number else ancestors
            states[group.vehicles] = states[group.vehicles][:, mine]
            group.resample(mine)
        merged = Group(
            sorted(vehicle for group in parts for vehicle in group.vehicles),
            particles,
            [tree for group in parts for tree in group.trees],
        )
        merged.samples = [samples for group in parts for samples in group.samples]
        merged.score = np.sum([group.score for group in parts], axis=0)
        merged.log_weights, _ = normalized(-likelihoods[pairing, ancestors])
        apart = [group for group in self.all if group not in parts]
        self.all = sorted([merged, *apart], key=lambda group: group.vehicles[0])
        return ancestors

    def state_dict(self, stores: Sequence[LayoutOwner]) -> State:
        """Return all groups; stores: all that keep rows for their trees."""
        state: State = {'count': np.array(len(self.all))}
        for number, group in enumerate(self.all):
            state |= under(str(number), group.state_dict(stores))
        return state

    def restore(self, state: State, stores: Sequence[LayoutOwner]) -> None:
        """Restore all groups; the stores must have been restored before."""
        self.all = [
            Group.from_state(part(str(number), state), stores)
            for number in range(int(state['count']))
        ]
