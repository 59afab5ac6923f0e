"""The two engines: what one update does to poses, weights and landmarks of all particles."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import LandmarkObservations
from explore_slam.geometry import Array, Pose2, to_world
from explore_slam.slam.association import Choice, associate
from explore_slam.slam.config import FastSlamConfig
from explore_slam.slam.gaussian import sample_gaussian
from explore_slam.slam.genealogy import Index
from explore_slam.slam.landmark_map import LandmarkMap
from explore_slam.slam.landmark_update import update_landmarks
from explore_slam.slam.parallel import over_particles
from explore_slam.slam.proposal import propose, sample_proposals
from explore_slam.slam.row_store import Items, RowStore

_WORST = -2.0 * np.log(1e-6)
# squared descriptor distances: as good as the same; and how far below the next one (0.8²)
_IDENTICAL = 0.02
_DISTINCT = 0.64
_SAME_PLACE = 0.5
UPPER = (np.array([0, 0, 0, 1, 1, 2]), np.array([0, 1, 2, 1, 2, 2]))


@dataclass
class Sighted:
    """One update in work: observations, the landmarks they may be, and who chose what.

    z (K, 3), R (K, 6); alike (K, A): ids of the landmarks within reach that each is like, or -1;
    telling (K,): its descriptor tells which landmark it is; items (L,) candidates' landmarks, rows
    in slots (L,);
    candidates (K, J) places in items or -1, distances (K, J) of descriptors;
    choice (K, M) candidate taken or -1; quality (K, M) d²; influence (K, M) weight w.
    """

    z: Array
    R: Array
    descriptors: NDArray[np.float32]
    alike: Items
    telling: NDArray[np.bool_]
    items: Items
    slots: Items
    candidates: Items
    distances: Array
    choice: Choice = field(init=False)
    quality: Array = field(init=False)
    influence: Array = field(init=False)

    def prepare(self, particles: int) -> None:
        """Make room for the choices of all particles."""
        count = len(self.z)
        self.choice = np.full((count, particles), -1, np.int16)
        self.quality = np.full((count, particles), np.inf)
        self.influence = np.ones((count, particles))

    def follow(self, ancestors: Index, rows: RowStore) -> None:
        """Take over what the ancestors (M,) of the particles chose; stage the rows again.

        The rows must have been reverted before the resampling.
        """
        self.slots = rows.stage(self.items)
        self.choice = np.ascontiguousarray(self.choice[:, ancestors])
        self.quality = np.ascontiguousarray(self.quality[:, ancestors])
        self.influence = np.ascontiguousarray(self.influence[:, ancestors])

    def matches(self, particle: int, ids: Items) -> Items:
        """Return (K,) the id of the landmark that a particle took each observation for, or -1.

        ids (N,) by item.
        """
        taken = self.choice[:, particle].astype(np.int64)
        places = np.take_along_axis(self.candidates, np.maximum(taken, 0)[:, None], 1)[:, 0]
        found: Items = np.full(len(taken), -1, np.int64)
        real = taken >= 0
        found[real] = ids[self.items[places[real]]]
        return found


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

    def follow(self, ancestors: Index) -> None:
        """Take over the Gaussians of the ancestors (M,)."""
        self.poses = self.poses[ancestors]
        self.centers, self.spreads = self.centers[ancestors], self.spreads[ancestors]

    def sampled(self, normals: Array) -> Array:
        """Return samples (M, 3) by standard normals (M, 3)."""
        sample_proposals(self.centers, self.spreads, normals, 0, len(self.poses), self.poses)
        return self.poses


def tells(
    like: Items, distances: NDArray[np.float32], reference: Array, limit: float
) -> NDArray[np.bool_]:
    """Tell (K,) for which observations the descriptor says which landmark it is, wherever that is.

    That is where the nearest is as good as identical, or far nearer than any at another place.
    like (K, A) landmarks within the limit, nearest first, or -1; distances (K, A) to them.
    Textures repeat: a mere likeness somewhere in the map says little.
    """
    found = like[:, 0] >= 0
    if not found.any():
        return found
    apart = np.linalg.norm(reference[like] - reference[like[:, :1]], axis=2)
    elsewhere = np.where((like >= 0) & (apart > _SAME_PLACE), distances, limit)
    nearest = distances[:, 0]
    told: NDArray[np.bool_] = found & (
        (nearest <= _IDENTICAL) | (nearest <= _DISTINCT * elsewhere.min(axis=1))
    )
    return told


def look_up(
    landmarks: LandmarkMap,
    observations: LandmarkObservations,
    config: FastSlamConfig,
    pose: Pose2,
    covariance: Array,
    reach: float,
) -> Sighted:
    """Find the landmarks whose descriptors match, near where they are seen from the mean pose.

    covariance (3, 3) of that pose widens the search; reach (m) is how much farther a landmark
    may be that the vehicle is like to see where it is lost. Stages the rows of the candidates.
    """
    association = config.association
    descriptors = np.ascontiguousarray(observations.descriptors, np.float32)
    z = np.ascontiguousarray(observations.positions, np.float64)
    R = np.ascontiguousarray(observations.covariances[:, *UPPER], np.float64)
    wanted = association.candidates_per_observation
    limit = association.maximum_descriptor_distance
    like, distances = landmarks.index.query(descriptors, limit, 2 * wanted)
    found = like >= 0
    if found.any():
        off = landmarks.reference[like] - to_world(pose, z)[:, None, :]
        length = np.sqrt(np.einsum('kji,kji->kj', off, off))
        variance = covariance[0, 0] + covariance[1, 1] + (z[:, :2] ** 2).sum(1) * covariance[2, 2]
        variance = variance + R[:, 0] + R[:, 3] + R[:, 5]
        radius = 0.5 + association.association_gate * np.sqrt(variance)
        within = found & (length <= (radius + reach)[:, None])
        near = found & (length <= radius[:, None])
        near &= np.cumsum(near, axis=1) <= wanted
    else:
        within = near = found
    alike = np.where(within, landmarks.ids[like], -1) if found.any() else like
    ids = np.where(near, like, -1)
    items, places = np.unique(ids, return_inverse=True)
    places = places.reshape(ids.shape)
    if len(items) and items[0] < 0:
        items, places = items[1:], places - 1
    sighted = Sighted(
        z=z,
        R=R,
        descriptors=descriptors,
        alike=alike,
        telling=tells(like, distances, landmarks.reference, limit),
        items=items,
        slots=landmarks.rows.stage(items),
        candidates=np.ascontiguousarray(places, np.int64),
        distances=distances.astype(np.float64),
    )
    sighted.prepare(landmarks.rows.genealogy.particles)
    return sighted


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


def paper(
    sighted: Sighted, data: Array, poses: Array, P: Array, normals: Array, config: FastSlamConfig
) -> Proposal:
    """FastSLAM 1.0 as in section III: poses from the motion model, weight by match quality.

    The quality p = exp(-d²/2) is gated at P0. The text does not say what a particle weighs where
    an observation becomes a new landmark: here the quality of the like landmark that it failed
    to match (not less than 1e-6), and P0 where it has none.
    """
    move_by_samples(poses, P, normals)
    least = config.association.minimum_match_quality
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


def update_matched(sighted: Sighted, data: Array, poses: Array, threads: int) -> None:
    """Run the Kalman filters of all matched landmarks."""

    def part(begin: int, end: int) -> None:
        update_landmarks(
            data, sighted.slots, sighted.candidates, sighted.choice, sighted.z, sighted.R,
            sighted.influence, poses, begin, end,
        )  # fmt: skip

    over_particles(part, len(poses), threads)
