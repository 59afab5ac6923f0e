"""Engine paper: FastSLAM 1.0 with a common map, sections III and IV of the paper to the letter.

(Montemerlo et al., "FastSLAM: a factored solution to the simultaneous localization and mapping
problem", 2002, is FastSLAM 1.0.) Poses are sampled from the motion model (2.1); candidates are
gated by their association probability (2.4), and the one of smallest descriptor distance is
associated (2.5); the weight is the product of the association probabilities (2.6.2). The particles
are resampled (5) once all vehicles have weighted them, w = Π w(i) (Eq. 7).

The text does not say what a particle weighs if an observation becomes a new landmark. Here it is
the association probability of the candidate that was not gated, at least MINIMUM_PROBABILITY, and
P0 if there is no candidate.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from explore_slam.geometry import Array
from explore_slam.slam.association.gating import associate
from explore_slam.slam.association.state import AssociationState
from explore_slam.slam.checkpoint import State
from explore_slam.slam.config import FastSlamConfig
from explore_slam.slam.particles.group import Group
from explore_slam.slam.update.engine import PoseProposal
from explore_slam.slam.update.gaussian import sample_gaussian

# Keeps one outlier from ruling out a particle: 5.3 sigma.
MINIMUM_PROBABILITY = 1e-6
_LARGEST_SQUARE = -2.0 * np.log(MINIMUM_PROBABILITY)


def sample_motion(poses: Array, P: Array, normals: Array) -> None:
    """Move poses (M, 3) in place by samples of a motion error, P (3, 3) in the vehicle frame."""
    deltas = np.zeros_like(poses)
    for m in range(len(poses)):
        sample_gaussian(P, normals[m], deltas[m])
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    poses[:, 0] += c * deltas[:, 0] - s * deltas[:, 1]
    poses[:, 1] += s * deltas[:, 0] + c * deltas[:, 1]
    poses[:, 2] += deltas[:, 2]


class PaperEngine:
    """The paper's algorithm; see Engine. weighted: vehicles that have done so in this round."""

    joint = True
    redraws = False
    relocalizes = False
    removes_landmarks = False

    def __init__(self, config: FastSlamConfig) -> None:
        self.config = config
        self.weighted: set[int] = set()

    def propose(
        self, state: AssociationState, poses: Array, P: Array, normals: Array, log_weights: Array
    ) -> PoseProposal:
        """See Engine."""
        del log_weights
        sample_motion(poses, P, normals)  # 2.1
        least = self.config.association.minimum_association_probability
        gate = -2.0 * np.log(least) if least > 0.0 else np.inf
        associate(state.rows(), state.found.observed, poses, gate, state.chosen)  # 2.2, 2.4, 2.5
        d2 = state.chosen.mahalanobis_squared
        squares = np.where(np.isinf(d2), min(gate, _LARGEST_SQUARE), d2)
        proposal = PoseProposal.at(poses)
        log_weight = proposal.log_likelihoods
        log_weight -= 0.5 * np.minimum(squares, _LARGEST_SQUARE).sum(axis=0)  # 2.6.2
        return proposal

    def needs_landmark(
        self, state: AssociationState, agreed: NDArray[np.bool_]
    ) -> NDArray[np.bool_]:
        """See Engine: in every particle that did not associate the observation (2.7.1)."""
        del agreed
        free: NDArray[np.bool_] = state.chosen.choice < 0
        return free

    def resamples_before_sampling(self, group: Group) -> bool:
        """See Engine: resampling is the last step."""
        del group
        return False

    def starts_new_round(self, vehicle: int) -> bool:
        """See Engine: a vehicle that updates twice does not wait for the others."""
        return vehicle in self.weighted

    def completes_round(self, vehicle: int, vehicles: Sequence[str]) -> bool:
        """See Engine."""
        self.weighted.add(vehicle)
        return len(self.weighted) == len(vehicles)

    def end_round(self, group: Group) -> None:
        """See Engine: the best particle of the round remains it until the next update."""
        self.weighted.clear()
        group.score = np.zeros(self.config.particles)
        group.score[int(np.argmax(group.log_weights))] = 1.0

    def best_particle(self, group: Group) -> int:
        """See Engine: the one of largest weight (4)."""
        return int(np.argmax(group.log_weights)) if self.weighted else group.best_particle()

    def state_dict(self) -> State:
        """See Engine."""
        return {'weighted': np.array(sorted(self.weighted), np.int64)}

    def restore(self, state: State) -> None:
        """See Engine."""
        self.weighted = set(state['weighted'].tolist())
