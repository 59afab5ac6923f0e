"""Candidate search: the landmarks that an observation may belong to, by descriptor and position.

Step 2.2 of the paper's algorithm, for all particles at once: descriptors belong to landmarks, and
the particles of one group differ little compared to the search radius.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.data import LandmarkObservations
from explore_slam.geometry import Array, Pose2, to_world
from explore_slam.slam.association.ratio_test import is_distinctive
from explore_slam.slam.association.state import CandidateSet, Observed
from explore_slam.slam.config import AssociationConfig
from explore_slam.slam.descriptors.index import ROUNDING, Distances, Ids
from explore_slam.slam.descriptors.kd_forest import squared_distance
from explore_slam.slam.descriptors.kinds import Vectors
from explore_slam.slam.landmarks.landmark_map import LandmarkMap
from explore_slam.slam.storage.row_format import Places, packed

# Minimum search radius (m). Reference positions of landmarks lag behind their estimates, and the
# particles spread around the mean pose. Chosen by hand; test_candidates shows what it decides.
_MINIMUM_RADIUS = 0.5


class _Nearby(NamedTuple):
    """Landmarks near any observation: places (L, 3) ascending along x, vectors (L, D)."""

    places: Array
    vectors: Vectors


class _Expected(NamedTuple):
    """Observations in the map as seen from the mean pose.

    points (K, 3) m; radius (K,) m of the search around each; vectors (K, D); first (K,): index of
    the first nearby landmark whose x is not below that of the point minus the radius.
    """

    points: Array
    radius: Array
    vectors: Vectors
    first: Ids


@kernel
def _inside(
    reference: Array, ids: Ids, lower: Array, upper: Array
) -> Places:  # pragma: no cover - compiled
    """Return the entries in use whose reference (n, 3) lies within a box."""
    found = np.empty(len(ids), np.int64)
    count = 0
    for n in range(len(ids)):
        if ids[n] < 0 or reference[n, 0] < lower[0] or reference[n, 0] > upper[0]:
            continue
        if reference[n, 1] < lower[1] or reference[n, 1] > upper[1]:
            continue
        if lower[2] <= reference[n, 2] <= upper[2]:
            found[count] = n
            count += 1
    return found[:count].copy()


@kernel
def _compare_near(
    nearby: _Nearby,
    expected: _Expected,
    limit: float,
    most: int,
    found: Ids,
    distances: Distances,
) -> NDArray[np.bool_]:  # pragma: no cover - compiled
    """Fill found and distances (K, C) with the nearest by descriptor within the radius.

    Of equal descriptors the nearer place comes first. Returns (K,) whether there are more than
    `most` landmarks within the radius; they are not compared then.
    """
    places, table = nearby.places, nearby.vectors
    points, radius, vectors = expected.points, expected.radius, expected.vectors
    crowded = np.zeros(len(points), np.bool_)
    last = found.shape[1] - 1
    offsets = np.full(last + 1, np.inf)
    for k in range(len(points)):
        compared = 0
        for n in range(expected.first[k], len(places)):
            dx = places[n, 0] - points[k, 0]
            if dx > radius[k]:
                break
            dy, dz = places[n, 1] - points[k, 1], places[n, 2] - points[k, 2]
            offset = dx * dx + dy * dy + dz * dz
            if offset > radius[k] * radius[k]:
                continue
            compared += 1
            if compared > most:
                crowded[k] = True
                break
            bound = min(np.float32(limit), distances[k, last])
            distance = squared_distance(vectors[k], table[n], bound)
            if distance > bound or (distance == distances[k, last] and offset >= offsets[last]):
                continue
            place = last
            while place > 0 and (
                distances[k, place - 1] > distance
                or (distances[k, place - 1] == distance and offsets[place - 1] > offset)
            ):
                distances[k, place] = distances[k, place - 1]
                offsets[place] = offsets[place - 1]
                found[k, place] = found[k, place - 1]
                place -= 1
            distances[k, place], offsets[place], found[k, place] = distance, offset, n
    return crowded


class _Search:
    """One candidate search: around each expected point (K, 3) m within its radius (K,) m."""

    def __init__(
        self,
        landmarks: LandmarkMap,
        config: AssociationConfig,
        points: Array,
        radius: Array,
        vectors: Vectors,
        hidden: NDArray[np.bool_] | None = None,
    ) -> None:
        self.landmarks = landmarks
        self.hidden = hidden
        self.config = config
        self.points = points
        self.radius = radius
        self.vectors = vectors

    def run(self, beyond: float) -> tuple[Ids, Distances, Places, NDArray[np.bool_]]:
        """Return entries (K, J), distances (K, J), similar_ids and is_distinctive of CandidateSet.

        beyond: distance (m) outside the radius at which a similar landmark is still noted.
        """
        landmarks, wanted = self.landmarks, self.config.candidates_per_observation
        entries, distances, crowded = self._near()
        similar_ids = np.full((len(entries), 3 * wanted), -1, np.int64)
        if not len(landmarks):
            return entries, distances, similar_ids, np.zeros(len(entries), bool)
        distinctive = self._is_distinctive(entries, distances) & ~crowded
        rest = ~distinctive
        if rest.any():
            similar, lengths, near, within = self._anywhere(rest, beyond)
            distinctive[rest] = self._is_distinctive(similar, lengths)
            many = crowded[rest]
            order = np.argsort(~near[many], axis=1, kind='stable')[:, :wanted]
            near_alone = np.where(near[many], similar[many], -1)
            entries[crowded] = np.take_along_axis(near_alone, order, 1)
            distances[crowded] = np.take_along_axis(lengths[many], order, 1)
            similar_ids[rest, wanted:] = np.where(within & ~near, landmarks.ids[similar], -1)
        similar_ids[:, :wanted] = np.where(entries >= 0, landmarks.ids[entries], -1)
        return entries, distances, similar_ids, distinctive

    def _is_distinctive(self, nearest: Ids, distances: Distances) -> NDArray[np.bool_]:
        limit = self.config.maximum_descriptor_distance
        return is_distinctive(
            nearest, distances, self.landmarks.reference, limit, self.landmarks.kind
        )

    def _near(self) -> tuple[Ids, Distances, NDArray[np.bool_]]:
        """Compare with all landmarks within the radius: entries (K, J), nearest first, distances.

        The last result (K,) marks where there are more of them than the forest would compare.
        """
        count = len(self.points)
        wanted = self.config.candidates_per_observation
        found: Ids = np.full((count, wanted), -1, np.int64)
        distances = np.full((count, wanted), np.inf, np.float32)
        lower = (self.points - self.radius[:, None]).min(axis=0)
        upper = (self.points + self.radius[:, None]).max(axis=0)
        size, reference = self.landmarks.size, self.landmarks.reference
        ids = self.landmarks.ids[:size]
        if self.hidden is not None:
            ids = np.where(self.hidden, -1, ids)
        entries = _inside(reference[:size], ids, lower, upper)
        entries = entries[np.argsort(reference[entries, 0], kind='stable')]
        if not len(entries):
            return found, distances, np.zeros(count, bool)
        nearby = _Nearby(reference[entries], self.landmarks.index.vectors(entries))
        first = np.searchsorted(nearby.places[:, 0], self.points[:, 0] - self.radius)
        crowded = _compare_near(
            nearby,
            _Expected(self.points, self.radius, self.vectors, first),
            self.config.maximum_descriptor_distance + ROUNDING,
            self.config.forest_checks,
            found,
            distances,
        )
        return np.where(found >= 0, entries[found], -1), distances, crowded

    def _anywhere(
        self, some: NDArray[np.bool_], beyond: float
    ) -> tuple[Ids, Distances, NDArray[np.bool_], NDArray[np.bool_]]:
        """Search the index for some (K,) observations: entries and distances, both (k, 2 J).

        The other results mark those within the radius, and those up to `beyond` (m) outside it.
        """
        similar, distances = self.landmarks.index.query(
            self.vectors[some],
            self.config.maximum_descriptor_distance,
            2 * self.config.candidates_per_observation,
        )
        if self.hidden is not None:
            similar, distances = _without(self.hidden, similar, distances)
        off = self.landmarks.reference[similar] - self.points[some][:, None, :]
        length = np.sqrt(np.einsum('kji,kji->kj', off, off))
        radius = self.radius[some][:, None]
        found = similar >= 0
        return similar, distances, found & (length <= radius), found & (length <= radius + beyond)


def _without(
    hidden: NDArray[np.bool_], entries: Ids, distances: Distances
) -> tuple[Ids, Distances]:
    """Return entries and distances, both (k, J), nearest first, without those that are hidden."""
    left_out = (entries >= 0) & hidden[entries]
    order = np.argsort(left_out | (entries < 0), axis=1, kind='stable')
    entries = np.take_along_axis(np.where(left_out, -1, entries), order, 1)
    lengths = np.where(left_out, np.float32(np.inf), distances)
    return entries, np.take_along_axis(lengths, order, 1)


def find_candidates(
    landmarks: LandmarkMap,
    observations: LandmarkObservations,
    config: AssociationConfig,
    pose: Pose2,
    covariance: Array,
    beyond: float,
    hidden: NDArray[np.bool_] | None = None,
) -> CandidateSet:
    """Return the landmarks with similar descriptors near where each observation is expected.

    pose and covariance (3, 3): mean of the vehicle's pose in the map, which the search radius
    follows from; beyond (m): how much farther similar landmarks are noted for relocalization.
    hidden: entries of the map that cannot be observed, because they lie in another frame.

    Each observation is compared with every landmark within its radius. If none of them is
    distinctive, or if more of them lie there than the forest would compare, the index over the
    whole map is searched. The cost of an update therefore does not grow with the map as long as
    the vehicle is localized.
    """
    vectors = landmarks.kind.vectors(observations.descriptors)
    z = np.ascontiguousarray(observations.positions, np.float64)
    R = packed(observations.covariances)
    variance = covariance[0, 0] + covariance[1, 1] + (z[:, :2] ** 2).sum(1) * covariance[2, 2]
    variance = variance + R[:, 0] + R[:, 3] + R[:, 5]
    radius = _MINIMUM_RADIUS + config.association_gate * np.sqrt(variance)
    search = _Search(landmarks, config, to_world(pose, z), radius, vectors, hidden)
    numbers, distances, similar_ids, distinctive = search.run(beyond)
    entries, places = np.unique(numbers, return_inverse=True)
    places = places.reshape(numbers.shape)
    if len(entries) and entries[0] < 0:
        entries, places = entries[1:], places - 1
    return CandidateSet(
        measured=Observed(z, R),
        observed=Observed(z, R),
        vectors=vectors,
        entries=entries,
        candidates=np.ascontiguousarray(places, np.int64),
        distances=distances.astype(np.float64),
        similar_ids=similar_ids,
        is_distinctive=distinctive,
        hidden=hidden,
    )
