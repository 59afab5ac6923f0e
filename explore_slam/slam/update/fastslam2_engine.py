"""The default engine: FastSLAM 2.0 with robust weights."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from explore_slam.geometry import Array
from explore_slam.slam.association.state import (
    Associations,
    AssociationState,
    CandidateRows,
    CandidateSet,
)
from explore_slam.slam.checkpoint import State
from explore_slam.slam.config import FastSlamConfig
from explore_slam.slam.particles.group import Group
from explore_slam.slam.storage.ancestry import Index
from explore_slam.slam.update.engine import PoseProposal
from explore_slam.slam.update.parallel import over_particles
from explore_slam.slam.update.proposal import ProposalInputs, ProposalParameters, propose

# Chosen by hand; `benchmarks/slam_mrclam.py` and `benchmarks/relocalization.py` show what a change
# does to accuracy and to vehicles that are lost.
# Cost of the largest descriptor distance E0 beside d² + ln|S| of a candidate: that of 2 sigma.
_DESCRIPTOR_COST = 4.0
_MINIMUM_DISTANCE = 0.05  # smallest E0 that the cost is scaled by: none may outweigh the position

# New landmarks: an observation with a distinctive descriptor that matches a landmark elsewhere is
# inserted only if others confirm the pose; nothing is inserted if nearly all contradict it.
# A pose is confirmed by at least so many associated observations, and by this fraction of those
# with a distinctive descriptor.
_CONFIRMING = 3
_CONFIRMING_FRACTION = 0.5
# A pose is contradicted if at least the first fraction of the observations have a distinctive
# match, and less than the second fraction of these are associated.
_CONTRADICTING_FRACTION = 0.4
_CONTRADICTED_FRACTION = 0.25


def _parameters(found: CandidateSet, P: Array, config: FastSlamConfig) -> ProposalParameters:
    largest = config.association.maximum_descriptor_distance
    return ProposalParameters(
        gate=config.association.association_gate**2,
        descriptor_weight=_DESCRIPTOR_COST / max(largest, _MINIMUM_DISTANCE),
        t2=config.outlier_threshold * config.outlier_threshold,
        # features of one frame share errors: they count as that many independent ones at most
        information=min(1.0, config.independent_observations / len(found)),
        P=P,
    )


def _propose(
    found: CandidateSet,
    rows: CandidateRows,
    chosen: Associations,
    poses: Array,
    P: Array,
    config: FastSlamConfig,
) -> PoseProposal:
    """Associate, and return the proposal of predicted poses (M, 3) of covariance P (3, 3)."""
    proposal = PoseProposal.at(poses)
    parameters = _parameters(found, P, config)
    inputs = ProposalInputs(rows, found.measured, found.observed, parameters, poses)

    def run(begin: int, end: int) -> None:
        propose(inputs, begin, end, proposal.given, chosen)

    over_particles(run, len(poses), config.filter_threads)
    return proposal


def _propose_on(
    found: CandidateSet, blocks: Array, poses: Array, P: Array, config: FastSlamConfig
) -> PoseProposal:
    """Return the proposal for blocks (L, 9, M) of the candidates that are not staged."""
    chosen = Associations.undecided(len(found), len(poses))
    rows = found.rows_at(blocks, np.arange(len(found.entries)))
    return _propose(found, rows, chosen, poses, P, config)


def pair_likelihoods(
    found: CandidateSet,
    blocks: Array,
    theirs: Sequence[NDArray[np.bool_]],
    orders: Sequence[Index],
    poses: Array,
    P: Array,
    config: FastSlamConfig,
) -> Array:
    """Return log-likelihoods (M,) of observations if some landmarks are those of other particles.

    blocks (L, 9, M) of the candidates; theirs (L,) per other group: its landmarks, which are taken
    from particle order[m] for particle m.
    """
    mixed = blocks.copy()
    for some, order in zip(theirs, orders, strict=True):
        mixed[some] = blocks[some][:, :, order]
    return _propose_on(found, mixed, poses, P, config).checked().log_likelihoods


class FastSlam2Engine:
    """FastSLAM 2.0; see Engine.

    Differences from the paper's algorithm: poses are sampled from the proposal given the
    observations (2.1 after 2.5), candidates are chosen by likelihood as well as by descriptor
    (2.4 and 2.5 in one), weights are likelihoods (2.6.2), and groups are resampled when their
    effective sample size is low (5).
    """

    joint = False
    relocalizes = True
    removes_landmarks = True

    def __init__(self, config: FastSlamConfig) -> None:
        self.config = config
        self.redraws = config.joint_graph

    def propose(
        self, state: AssociationState, poses: Array, P: Array, normals: Array, log_weights: Array
    ) -> PoseProposal:
        """See Engine."""
        del normals, log_weights
        found, config = state.found, self.config
        return _propose(found, state.rows(), state.chosen, poses, P, config)

    def needs_landmark(
        self, state: AssociationState, agreed: NDArray[np.bool_]
    ) -> NDArray[np.bool_]:
        """See Engine: where most particles have no landmark, unless the pose is contradicted."""
        found = state.found
        free: NDArray[np.bool_] = state.chosen.choice < 0
        matched = np.count_nonzero(found.has_similar() & found.is_distinctive)
        agreeing = np.count_nonzero(agreed)
        new = ~agreed if found.withheld is None else ~agreed & ~found.withheld
        distinctive = np.count_nonzero(found.is_distinctive)
        if agreeing < max(_CONFIRMING, _CONFIRMING_FRACTION * distinctive):
            new &= ~found.is_distinctive
        contradicted = agreeing < _CONTRADICTED_FRACTION * matched
        if matched >= _CONTRADICTING_FRACTION * len(agreed) and contradicted:
            new[:] = False
        free &= new[:, None]
        return free

    def resamples_before_sampling(self, group: Group) -> bool:
        """See Engine."""
        least = self.config.resampling_threshold * self.config.particles
        return group.effective_particles() < least

    def starts_new_round(self, vehicle: int) -> bool:
        """See Engine: there are no rounds."""
        del vehicle
        return False

    def completes_round(self, vehicle: int, vehicles: Sequence[str]) -> bool:
        """See Engine: there are no rounds."""
        del vehicle, vehicles
        return False

    def end_round(self, group: Group) -> None:
        """See Engine: there are no rounds."""

    def best_particle(self, group: Group) -> int:
        """See Engine: the one with the most likely lineage, so that the best path is steady."""
        return group.best_particle()

    def state_dict(self) -> State:
        """See Engine: there are no rounds."""
        return {}

    def restore(self, state: State) -> None:
        """See Engine: there are no rounds."""
