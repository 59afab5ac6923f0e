"""Which landmarks an observation may be: by descriptor, and by where it is seen."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.data import LandmarkObservations
from explore_slam.geometry import Array, Pose2, to_world
from explore_slam.slam.association.gating import Choice
from explore_slam.slam.config import AssociationConfig
from explore_slam.slam.descriptors.index import ROUNDING, Descriptors, Ids
from explore_slam.slam.descriptors.kd_forest import squared_distance
from explore_slam.slam.landmarks.landmark_map import LandmarkMap
from explore_slam.slam.storage.ancestry import Genealogy, Index
from explore_slam.slam.storage.row_store import Items, RowStore

# squared descriptor distances: as good as the same; and how far below the next one (0.8²)
_IDENTICAL = 0.02
_DISTINCT = 0.64
_SAME_PLACE = 0.5
_LEAST_RADIUS = 0.5
UPPER = (np.array([0, 0, 0, 1, 1, 2]), np.array([0, 1, 2, 1, 2, 2]))

Lengths = NDArray[np.float32]


@dataclass
class Sighted:
    """One update in work: observations, the landmarks they may be, and who chose what.

    z (K, 3), R (K, 6); alike (K, A): ids of the landmarks within reach that each is like, or -1;
    telling (K,): its descriptor tells which landmark it is; items (L,) candidates' landmarks;
    candidates (K, J) places in items or -1, distances (K, J) of descriptors.
    Once staged for a home: slots (L,) of their rows; choice (K, M) candidate taken or -1;
    quality (K, M) d²; influence (K, M) weight w.
    """

    z: Array
    R: Array
    descriptors: Descriptors
    alike: Items
    telling: NDArray[np.bool_]
    items: Items
    candidates: Items
    distances: Array
    home: Genealogy = field(init=False)
    slots: Items = field(init=False)
    choice: Choice = field(init=False)
    quality: Array = field(init=False)
    influence: Array = field(init=False)

    def stage(self, rows: RowStore, home: Genealogy) -> None:
        """Stage the rows of the candidates, and make room for the choices of all particles."""
        self.home, self.slots = home, rows.stage(self.items, home)
        self.prepare(rows.particles)

    def prepare(self, particles: int) -> None:
        """Make room for the choices of all particles."""
        count = len(self.z)
        self.choice = np.full((count, particles), -1, np.int16)
        self.quality = np.full((count, particles), np.inf)
        self.influence = np.ones((count, particles))

    def revert(self, rows: RowStore) -> None:
        """Give the staged rows back."""
        rows.revert(self.items, self.slots, self.home)

    def follow(self, ancestors: Index, rows: RowStore) -> None:
        """Take over what the ancestors (M,) of the particles chose; stage the rows again.

        The rows must have been reverted before the resampling.
        """
        self.slots = rows.stage(self.items, self.home)
        self.choice = np.ascontiguousarray(self.choice[:, ancestors])
        self.quality = np.ascontiguousarray(self.quality[:, ancestors])
        self.influence = np.ascontiguousarray(self.influence[:, ancestors])

    def taken(self) -> NDArray[np.bool_]:
        """Return (L,) which of the landmarks some particle took an observation for."""
        taken = np.zeros(len(self.items), bool)
        for j in range(self.candidates.shape[1]):
            some = (self.choice == j).any(axis=1)
            taken[self.candidates[some, j]] = True
        return taken

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


def tells(like: Ids, distances: Lengths, reference: Array, limit: float) -> NDArray[np.bool_]:
    """Tell (K,) for which observations the descriptor says which of the landmarks compared it is.

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


@kernel
def _inside(
    reference: Array, ids: Items, lower: Array, upper: Array
) -> Items:  # pragma: no cover - compiled
    """Return the items in use within a box."""
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
    places: Array,
    table: Descriptors,
    points: Array,
    radius: Array,
    descriptors: Descriptors,
    first: Ids,
    limit: float,
    most: int,
    found: Ids,
    distances: Lengths,
) -> NDArray[np.bool_]:  # pragma: no cover - compiled
    """Fill found (K, C) with the nearest by descriptor of the places within the radius (K,).

    places (L, 3) ascend along x, table (L, 128) are their descriptors; first (K,): the first
    place not left of the radius. Of equal descriptors the nearer place comes first. Returns (K,)
    whether there are more than most.
    """
    crowded = np.zeros(len(points), np.bool_)
    last = found.shape[1] - 1
    offsets = np.full(last + 1, np.inf)
    for k in range(len(points)):
        compared = 0
        for n in range(first[k], len(places)):
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
            distance = squared_distance(descriptors[k], table[n], bound)
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


@dataclass
class _Search:
    """One look-up, and what is known of the observations.

    points (K, 3) where they are seen from the mean pose, radius (K,) m how far off they may be,
    descriptors (K, 128).
    """

    landmarks: LandmarkMap
    config: AssociationConfig
    points: Array
    radius: Array
    descriptors: Descriptors

    def run(self, reach: float) -> tuple[Ids, Lengths, Items, NDArray[np.bool_]]:
        """Return candidates (K, J), their distances, alike and telling as in Sighted."""
        landmarks, wanted = self.landmarks, self.config.candidates_per_observation
        limit = self.config.maximum_descriptor_distance
        items, distances, crowded = self._near()
        alike = np.full((len(items), 3 * wanted), -1, np.int64)
        if not len(landmarks):
            return items, distances, alike, np.zeros(len(items), bool)
        telling = tells(items, distances, landmarks.reference, limit) & ~crowded
        rest = ~telling
        if rest.any():
            like, lengths, near, within = self._anywhere(rest, reach)
            telling[rest] = tells(like, lengths, landmarks.reference, limit)
            many = crowded[rest]
            order = np.argsort(~near[many], axis=1, kind='stable')[:, :wanted]
            near_alone = np.where(near[many], like[many], -1)
            items[crowded] = np.take_along_axis(near_alone, order, 1)
            distances[crowded] = np.take_along_axis(lengths[many], order, 1)
            alike[rest, wanted:] = np.where(within & ~near, landmarks.ids[like], -1)
        alike[:, :wanted] = np.where(items >= 0, landmarks.ids[items], -1)
        return items, distances, alike, telling

    def _near(self) -> tuple[Ids, Lengths, NDArray[np.bool_]]:
        """Compare with all landmarks within the radius: items (K, J), nearest first, distances.

        And (K,) where there are more of them than the forest would compare.
        """
        count = len(self.points)
        wanted = self.config.candidates_per_observation
        found: Ids = np.full((count, wanted), -1, np.int64)
        distances = np.full((count, wanted), np.inf, np.float32)
        lower = (self.points - self.radius[:, None]).min(axis=0)
        upper = (self.points + self.radius[:, None]).max(axis=0)
        size, reference = self.landmarks.size, self.landmarks.reference
        items = _inside(reference[:size], self.landmarks.ids[:size], lower, upper)
        items = items[np.argsort(reference[items, 0], kind='stable')]
        if not len(items):
            return found, distances, np.zeros(count, bool)
        places = reference[items]
        first = np.searchsorted(places[:, 0], self.points[:, 0] - self.radius)
        crowded = _compare_near(
            places, self.landmarks.index.descriptors(items), self.points, self.radius,
            self.descriptors, first, self.config.maximum_descriptor_distance + ROUNDING,
            self.config.forest_checks, found, distances,
        )  # fmt: skip
        return np.where(found >= 0, items[found], -1), distances, crowded

    def _anywhere(
        self, some: NDArray[np.bool_], reach: float
    ) -> tuple[Ids, Lengths, NDArray[np.bool_], NDArray[np.bool_]]:
        """Ask the index for some (K,) observations: items and distances, all (k, 2 J).

        And which of them are near, and which within the radius and the reach (m) beyond it.
        """
        like, distances = self.landmarks.index.query(
            self.descriptors[some],
            self.config.maximum_descriptor_distance,
            2 * self.config.candidates_per_observation,
        )
        off = self.landmarks.reference[like] - self.points[some][:, None, :]
        length = np.sqrt(np.einsum('kji,kji->kj', off, off))
        radius = self.radius[some][:, None]
        found = like >= 0
        return like, distances, found & (length <= radius), found & (length <= radius + reach)


def look_up(
    landmarks: LandmarkMap,
    observations: LandmarkObservations,
    config: AssociationConfig,
    pose: Pose2,
    covariance: Array,
    reach: float,
) -> Sighted:
    """Find the landmarks whose descriptors match, near where they are seen from the mean pose.

    covariance (3, 3) of that pose widens the search; reach (m) is how much farther a landmark
    may be that the vehicle is like to see where it is lost.

    An observation is compared with every landmark near it. Where that does not tell which one it
    is, or where more are near than the forest would compare, the index over the whole map is
    asked: what an update costs does not grow with the map as long as the vehicle knows where it
    is.
    """
    descriptors = np.ascontiguousarray(observations.descriptors, np.float32)
    z = np.ascontiguousarray(observations.positions, np.float64)
    R = np.ascontiguousarray(observations.covariances[:, *UPPER], np.float64)
    variance = covariance[0, 0] + covariance[1, 1] + (z[:, :2] ** 2).sum(1) * covariance[2, 2]
    variance = variance + R[:, 0] + R[:, 3] + R[:, 5]
    radius = _LEAST_RADIUS + config.association_gate * np.sqrt(variance)
    search = _Search(landmarks, config, to_world(pose, z), radius, descriptors)
    items, distances, alike, telling = search.run(reach)
    present, places = np.unique(items, return_inverse=True)
    places = places.reshape(items.shape)
    if len(present) and present[0] < 0:
        present, places = present[1:], places - 1
    return Sighted(
        z=z,
        R=R,
        descriptors=descriptors,
        alike=alike,
        telling=telling,
        items=present,
        candidates=np.ascontiguousarray(places, np.int64),
        distances=distances.astype(np.float64),
    )
