"""What both engines share: the proposal of an update, and the interface to the filter."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from explore_slam.geometry import Array
from explore_slam.slam.association.state import AssociationState
from explore_slam.slam.checkpoint import State
from explore_slam.slam.particles.group import Group
from explore_slam.slam.particles.resampling import effective_particles, normalized
from explore_slam.slam.storage.ancestry import Index
from explore_slam.slam.update.proposal import Proposals, sample_proposals


@dataclass
class PoseProposal:
    """Predicted poses (M, 3), and the Gaussians of their errors given the observations."""

    poses: Array
    given: Proposals

    @classmethod
    def at(cls, poses: Array) -> Self:
        """Return the certain proposal of the poses (M, 3), with equal likelihoods."""
        count = len(poses)
        return cls(poses, Proposals(np.zeros((count, 3)), np.zeros((count, 6)), np.zeros(count)))

    @property
    def log_likelihoods(self) -> Array:
        """The log-likelihoods (M,) of the observations."""
        return self.given.log_likelihoods

    def is_finite(self) -> bool:
        """Return whether no number has overflowed."""
        return all(bool(np.isfinite(part).all()) for part in (self.poses, *self.given))

    def checked(self) -> Self:
        """Return the proposal; FloatingPointError if a number has overflowed."""
        if not self.is_finite():
            raise FloatingPointError('a proposal is not finite')
        return self

    def effective_particles(self, log_weights: Array) -> float:
        """Return the effective sample size that the observations leave of the weights (M,)."""
        return effective_particles(normalized(log_weights + self.log_likelihoods)[1])

    def follow(self, ancestors: Index) -> None:
        """Take over the Gaussians of the ancestors (M,)."""
        self.poses = self.poses[ancestors]
        self.given = Proposals(*(part[ancestors] for part in self.given))

    def sample(self, normals: Array) -> Array:
        """Return sampled poses (M, 3), made of standard normals (M, 3)."""
        sample_proposals(self.given.means, self.given.covariances, normals, self.poses)
        return self.poses


class Engine(Protocol):
    """How an update weighs particles and maintains the map: see fastslam2_engine, paper_engine."""

    #: All vehicles are in one group from the beginning.
    joint: bool
    #: Paths are drawn anew from the joint posterior.
    redraws: bool
    #: A lost vehicle is searched for.
    relocalizes: bool
    #: Landmarks that should be observed and are not lose evidence of existence.
    removes_landmarks: bool

    def propose(
        self, state: AssociationState, poses: Array, P: Array, normals: Array, log_weights: Array
    ) -> PoseProposal:
        """Associate, and return the proposal of predicted poses (M, 3) of covariance P (3, 3).

        normals (M, 3) standard normal; log_weights (M,) before the update.
        """

    def needs_landmark(
        self, state: AssociationState, agreed: NDArray[np.bool_]
    ) -> NDArray[np.bool_]:
        """Return (K, M) where an observation is to become a new landmark.

        agreed (K,): most of the weight associates the observation with a landmark.
        """

    def resamples_before_sampling(self, group: Group) -> bool:
        """Return whether a group must be resampled before poses are sampled."""

    def starts_new_round(self, vehicle: int) -> bool:
        """Return whether an update of a vehicle must wait for the end of the round before it."""

    def completes_round(self, vehicle: int, vehicles: Sequence[str]) -> bool:
        """Note the update of a vehicle; return whether that completes the round of all."""

    def end_round(self, group: Group) -> None:
        """Begin a new round, right before the group is resampled."""

    def best_particle(self, group: Group) -> int:
        """Return the particle that is taken as the estimate."""

    def state_dict(self) -> State:
        """Return the state of the round."""

    def restore(self, state: State) -> None:
        """Restore the state of the round."""
