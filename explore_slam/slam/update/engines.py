"""The two engines: what one update does to poses, weights and landmarks of all particles."""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from explore_slam.geometry import Array
from explore_slam.slam.association.candidates import Sighted
from explore_slam.slam.association.gating import associate
from explore_slam.slam.config import FastSlamConfig
from explore_slam.slam.particles.resampling import effective_particles, normalized
from explore_slam.slam.storage.ancestry import Index
from explore_slam.slam.storage.row_store import RowStore
from explore_slam.slam.update.gaussian import sample_gaussian
from explore_slam.slam.update.kernel_shrinkage import SHARES, smooth
from explore_slam.slam.update.landmark_update import update_landmarks
from explore_slam.slam.update.parallel import over_particles
from explore_slam.slam.update.proposal import propose, sample_proposals

_TRIED = 200  # particles on which the smoothing of landmarks is tried
_WORST = -2.0 * np.log(1e-6)


@dataclass
class Proposal:
    """Where the particles may be: predicted poses, and the Gaussians of their errors.

    poses (M, 3); centers (M, 3) and spreads (M, 6) in the frames of the poses; log_weights (M,).
    """

    poses: Array
    centers: Array
    spreads: Array
    log_weights: Array

    @classmethod
    def at(cls, poses: Array) -> 'Proposal':
        """Make one that is certain of the poses (M, 3), and weighs all alike."""
        count = len(poses)
        return cls(poses, np.zeros((count, 3)), np.zeros((count, 6)), np.zeros(count))

    def is_finite(self) -> bool:
        """Tell whether all numbers are in range."""
        parts = (self.poses, self.centers, self.spreads, self.log_weights)
        return all(bool(np.isfinite(part).all()) for part in parts)

    def checked(self) -> Self:
        """Return itself; FloatingPointError where a number is out of range."""
        if not self.is_finite():
            raise FloatingPointError('a proposal is not finite')
        return self

    def effective(self, log_weights: Array) -> float:
        """Return the effective sample size that these likelihoods leave of weights (M,)."""
        return effective_particles(normalized(log_weights + self.log_weights)[1])

    def follow(self, ancestors: Index) -> None:
        """Take over the Gaussians of the ancestors (M,)."""
        self.poses = self.poses[ancestors]
        self.centers, self.spreads = self.centers[ancestors], self.spreads[ancestors]

    def sampled(self, normals: Array) -> Array:
        """Return samples (M, 3) by standard normals (M, 3)."""
        sample_proposals(self.centers, self.spreads, normals, 0, len(self.poses), self.poses)
        return self.poses


def fastslam2(
    sighted: Sighted, data: Array, poses: Array, P: Array, config: FastSlamConfig
) -> Proposal:
    """Associate, and fold what is seen into the predicted poses (M, 3) and their likelihoods.

    P (3, 3) is the covariance of the predicted poses in the vehicle frame.
    """
    proposal = Proposal.at(poses)
    gate = config.association.association_gate**2
    likeness = 4.0 / max(config.association.maximum_descriptor_distance, 0.05)
    shared = np.bincount(sighted.candidates[sighted.candidates >= 0], minlength=1) > 1

    # features of one frame err together: they count as that many independent ones at most
    share = min(1.0, config.independent_observations / len(sighted.z))

    def part(begin: int, end: int) -> None:
        propose(
            data, sighted.slots, sighted.candidates, sighted.distances, shared, sighted.z,
            sighted.R, P, gate, likeness, config.outlier_threshold, share, begin, end, poses,
            proposal.centers, proposal.spreads, proposal.log_weights, sighted.choice,
            sighted.influence,
        )  # fmt: skip

    over_particles(part, len(poses), config.filter_threads)
    return proposal


def regularized(
    sighted: Sighted,
    data: Array,
    poses: Array,
    P: Array,
    log_weights: Array,
    config: FastSlamConfig,
) -> Proposal:
    """As `fastslam2`, but smooth the landmarks that are seen where too few particles fit.

    log_weights (M,) of the particles before. The staged rows change unless the numbers of the
    proposal run out of range.
    """
    proposal = fastslam2(sighted, data, poses, P, config)
    least = config.shrinkage_threshold * len(poses)
    if not proposal.is_finite() or proposal.effective(log_weights) >= least:
        return proposal
    part = _share_needed(sighted, data, poses, P, log_weights, config)
    slots = sighted.slots[sighted.taken()]
    before = data[slots]
    smoothed = np.empty_like(before)
    smooth(before, poses, np.exp(log_weights), part, smoothed)
    data[slots] = smoothed
    proposal = fastslam2(sighted, data, poses, P, config)
    if not proposal.is_finite():
        data[slots] = before
    return proposal


def _share_needed(
    sighted: Sighted,
    data: Array,
    poses: Array,
    P: Array,
    log_weights: Array,
    config: FastSlamConfig,
) -> float:
    """Return the least of SHARES that leaves enough of the particles, tried on some of them."""
    some = slice(None, None, max(1, len(poses) // _TRIED))
    poses, log_weights = poses[some].copy(), log_weights[some]
    _, weights = normalized(log_weights)
    rows, taken = np.ascontiguousarray(data[sighted.slots, :, some]), sighted.taken()
    before, smoothed = rows[taken], np.empty_like(rows[taken])
    for part in SHARES[:-1]:
        smooth(before, poses, weights, part, smoothed)
        rows[taken] = smoothed
        proposal = _unstaged(copy(sighted), rows, poses, P, config)
        effective = proposal.effective(log_weights) if proposal.is_finite() else 0.0
        if effective >= config.shrinkage_threshold * len(poses):
            return part
    return SHARES[-1]


def _unstaged(
    sighted: Sighted, rows: Array, poses: Array, P: Array, config: FastSlamConfig
) -> Proposal:
    """Return what `fastslam2` does for rows (L, 9, M) of the candidates that are not staged."""
    sighted.slots = np.arange(len(sighted.items))
    sighted.prepare(len(poses))
    return fastslam2(sighted, rows, poses, P, config)


def paired(
    sighted: Sighted,
    rows: Array,
    theirs: Sequence[NDArray[np.bool_]],
    orders: Sequence[Index],
    poses: Array,
    P: Array,
    config: FastSlamConfig,
) -> Proposal:
    """Return what `fastslam2` finds if some landmarks are those of other particles.

    rows (L, 9, M) of the candidates, not staged; where theirs (L,) tells so, the landmark of
    particle order[m] is that of particle m.
    """
    mixed = rows.copy()
    for some, order in zip(theirs, orders, strict=True):
        mixed[some] = rows[some][:, :, order]
    return _unstaged(sighted, mixed, poses, P, config).checked()


def paper(
    sighted: Sighted, data: Array, poses: Array, P: Array, normals: Array, config: FastSlamConfig
) -> Proposal:
    """FastSLAM 1.0 as in section III: poses from the motion model, weight by match quality.

    The quality p = exp(-d²/2) is gated at P0. The text does not say what a particle weighs where
    an observation becomes a new landmark: here the quality of the like landmark that it failed
    to match (not less than 1e-6), and P0 where it has none.
    """
    move_by_samples(poses, P, normals)
    least = config.association.minimum_association_probability
    gate = -2.0 * np.log(least) if least > 0.0 else np.inf
    associate(
        data, sighted.slots, sighted.candidates, sighted.distances, sighted.z, sighted.R,
        poses, gate, sighted.choice, sighted.quality,
    )  # fmt: skip
    squares = np.where(np.isinf(sighted.quality), min(gate, _WORST), sighted.quality)
    squares = np.minimum(squares, _WORST)
    proposal = Proposal.at(poses)
    proposal.log_weights -= 0.5 * squares.sum(axis=0)
    return proposal


def move_by_samples(poses: Array, P: Array, normals: Array) -> None:
    """Move poses (M, 3) in place by samples of a motion error, P (3, 3) in the vehicle frame."""
    deltas = np.zeros_like(poses)
    for m in range(len(poses)):
        sample_gaussian(P, normals[m], deltas[m])
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    poses[:, 0] += c * deltas[:, 0] - s * deltas[:, 1]
    poses[:, 1] += s * deltas[:, 0] + c * deltas[:, 1]
    poses[:, 2] += deltas[:, 2]


def propose_poses(
    sighted: Sighted,
    rows: RowStore,
    poses: Array,
    P: Array,
    normals: Array,
    log_weights: Array,
    config: FastSlamConfig,
) -> Proposal:
    """Run the engine of the settings on staged rows; normals (M, 3) are for engine paper only.

    Gives the rows back, and raises FloatingPointError, where a number is out of range.
    """
    if config.engine == 'paper':
        proposal = paper(sighted, rows.present_data, poses, P, normals, config)
    else:
        proposal = regularized(sighted, rows.present_data, poses, P, log_weights, config)
    if not proposal.is_finite():
        sighted.revert(rows)
    return proposal.checked()


def update_matched(sighted: Sighted, data: Array, poses: Array, threads: int) -> None:
    """Run the Kalman filters of all matched landmarks."""

    def part(begin: int, end: int) -> None:
        update_landmarks(
            data, sighted.slots, sighted.candidates, sighted.choice, sighted.z, sighted.R,
            sighted.influence, poses, begin, end,
        )  # fmt: skip

    over_particles(part, len(poses), threads)
