"""Map management: insertion of landmarks, evidence of existence, removal."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.geometry import Array, Pose2, to_world
from explore_slam.slam.association.state import MAJORITY, AssociationState, Observed
from explore_slam.slam.checkpoint import State
from explore_slam.slam.config import FastSlamConfig
from explore_slam.slam.landmarks.landmark_map import LandmarkMap
from explore_slam.slam.storage.row_format import COVARIANCE, Places
from explore_slam.slam.update.engine import Engine
from explore_slam.slam.update.landmark_update import fill_absent, insert_landmarks

# Chosen by hand; test_map_management shows what they decide.
# Misses count only if this many observations show where the view is free, and if most of the
# observations with similar landmarks (at least so many) are associated: then the pose is right.
_MINIMUM_OBSERVATIONS = 8
_CONFIRMING = 3
_CONFIRMING_FRACTION = 0.5
# Bin of azimuth and elevation (rad) in which views are compared: about the spacing of features of
# an image with some hundred of them.
_BIN = 0.1
# Evidence gained by a landmark that is associated; what a miss costs is relative to it.
_EVIDENCE_OF_MATCH = 1.0


@kernel
def _expected(
    reference: Array, ids: Places, x: float, y: float, theta: float, z: Array
) -> Places:  # pragma: no cover - compiled
    """Return entries that should be observed: an observation near their direction lies farther.

    reference (n, 3) positions in the map; z (K, 3) observed, in the frame of the vehicle at x, y,
    theta. Directions are compared in bins of azimuth and elevation.
    """
    K = len(z)
    azimuth, elevation, distance = np.empty(K), np.empty(K), np.empty(K)
    nearest = np.inf
    for k in range(K):
        flat = math.hypot(z[k, 0], z[k, 1])
        azimuth[k], elevation[k] = math.atan2(z[k, 1], z[k, 0]), math.atan2(z[k, 2], flat)
        distance[k] = math.hypot(flat, z[k, 2])
        nearest = min(nearest, distance[k])
    a0, e0 = azimuth.min(), elevation.min()
    columns = int((azimuth.max() - a0) / _BIN) + 1
    rows = int((elevation.max() - e0) / _BIN) + 1
    depth = np.zeros((rows, columns))
    for k in range(K):
        row, column = int((elevation[k] - e0) / _BIN), int((azimuth[k] - a0) / _BIN)
        depth[row, column] = max(depth[row, column], distance[k])
    farthest = depth.max()
    c, s = math.cos(theta), math.sin(theta)
    found = []
    for n in range(len(ids)):
        dx, dy, dz = reference[n, 0] - x, reference[n, 1] - y, reference[n, 2]
        if ids[n] < 0 or dx * dx + dy * dy > farthest * farthest:
            continue
        zx, zy = c * dx + s * dy, c * dy - s * dx
        flat = math.hypot(zx, zy)
        length = math.hypot(flat, dz)
        across, up = math.atan2(zy, zx) - a0, math.atan2(dz, flat) - e0
        if across < 0.0 or up < 0.0 or length < nearest:
            continue
        row, column = int(up / _BIN), int(across / _BIN)
        if row < rows and column < columns and length <= depth[row, column]:
            found.append(n)
    return np.array(found, np.int64)


@kernel
def _in_cells(
    reference: Array, ids: Places, counts: Places, size: float, cells: Places
) -> tuple[Places, Places]:  # pragma: no cover - compiled
    """Return (C,) how many landmarks that were matched lie in cells, and the cells (n,) of others.

    reference (n, 3), ids (n,) and counts (n,) of all entries; cells (C, 3): sorted, without
    repetition. The second result is the cell of each entry that was never matched, or -1.
    """
    matched, others = np.zeros(len(cells), np.int64), np.full(len(ids), -1)
    for n in range(len(ids)):
        if ids[n] < 0:
            continue
        x = math.floor(reference[n, 0] / size)
        y = math.floor(reference[n, 1] / size)
        z = math.floor(reference[n, 2] / size)
        low, high = 0, len(cells)
        while low < high:
            middle = (low + high) // 2
            cell = cells[middle]
            if cell[0] < x or (cell[0] == x and (cell[1] < y or (cell[1] == y and cell[2] < z))):
                low = middle + 1
            else:
                high = middle
        if low < len(cells) and cells[low, 0] == x and cells[low, 1] == y and cells[low, 2] == z:
            if counts[n] > 1:
                matched[low] += 1
            else:
                others[n] = low
    return matched, others


class Committed(NamedTuple):
    """What an update left in the map.

    ids (K,): the landmark of each observation, which most of the weight associates with it or
    which was inserted for it, or -1. inserted: number of landmarks; removed: ids.
    """

    ids: Places
    inserted: int
    removed: Places


def _ranks(groups: Places) -> Places:
    """Return (n,) how many before each element are in the same group; groups (n,)."""
    order = np.argsort(groups, kind='stable')
    ordered = groups[order]
    ranks = np.empty(len(groups), np.int64)
    ranks[order] = np.arange(len(groups)) - np.searchsorted(ordered, ordered)
    return ranks


class MapManager:
    """Writes updates to the landmark map; decides what is inserted and what is removed."""

    def __init__(self, landmarks: LandmarkMap, engine: Engine, config: FastSlamConfig) -> None:
        self.landmarks = landmarks
        self.engine = engine
        self.config = config
        self.regions: dict[tuple[int, int], int] = {}

    def commit(
        self, vehicle: int, state: AssociationState, poses: Array, support: Array, best: int
    ) -> Committed:
        """Commit an update of a vehicle at poses (M, 3).

        support (K, J): weight of the particles that chose each candidate; best: the best particle.
        """
        found, store = state.found, self.landmarks.rows
        agreed = support.sum(axis=1) > MAJORITY
        wanted = self.engine.needs_landmark(state, agreed)
        if self.config.insertion_policy == 'unmapped_region':
            wanted &= self._is_unmapped(vehicle, found.observed.z, poses[best])[:, None]
        filled = fill_absent(state.rows(), found.observed, poses, wanted)
        total = np.zeros(len(found.entries))
        real = found.candidates >= 0
        np.add.at(total, found.candidates[real], support[real])
        changed = state.is_chosen() | filled
        entries, addresses = found.entries[changed], state.addresses[changed]
        store.discard(found.entries[~changed], state.addresses[~changed], state.tree)
        store.commit(entries, addresses, state.tree)
        there = store.workspace[addresses, COVARIANCE, best] > 0.0
        self.landmarks.reference[entries[there]] = store.workspace[addresses[there], :3, best]
        observed = found.entries[total > MAJORITY]
        removed = self._update_evidence(state, agreed, observed, Pose2.from_array(poses[best]))
        ids = self._majority(state, support)
        if self.engine.removes_landmarks:
            wanted, replaced = self._with_room(found.observed.z, wanted, poses[best])
            removed = np.concatenate([removed, replaced])
        new = self._insert(vehicle, state, poses, wanted)
        ids[new] = self.landmarks.next_id - len(new) + np.arange(len(new))
        return Committed(ids, len(new), removed)

    def _majority(self, state: AssociationState, support: Array) -> Places:
        """Return (K,) the id of the landmark that most of the weight chose, or -1."""
        ids = np.full(len(state.found), -1, np.int64)
        if not support.size or not len(state.found.entries):
            return ids
        most = support.argmax(axis=1)[:, None]
        chosen = np.take_along_axis(support, most, 1)[:, 0] > MAJORITY
        places = np.take_along_axis(state.found.candidates, most, 1)[:, 0]
        ids[chosen] = self.landmarks.ids[state.found.entries[places[chosen]]]
        return ids

    def _insert(
        self, vehicle: int, state: AssociationState, poses: Array, wanted: NDArray[np.bool_]
    ) -> Places:
        """Insert the wanted (K, M) observations; return (n,) which became landmarks."""
        new = np.flatnonzero(wanted.any(axis=1))
        if not len(new):
            return new
        observed = state.found.observed
        addresses = self.landmarks.rows.allocate(len(new))
        workspace = self.landmarks.rows.workspace
        workspace[addresses] = 0.0
        chosen = Observed(observed.z[new], observed.R[new])
        insert_landmarks(workspace, addresses, chosen, wanted[new], poses)
        reference = workspace[addresses, :3, np.argmax(wanted[new], axis=1)]
        vectors = state.found.vectors[new]
        self.landmarks.add(addresses, vectors, vehicle, reference, state.tree)
        for point in reference:
            self.regions.setdefault(self._region(point), vehicle)
        return new

    def _with_room(
        self, z: Array, wanted: NDArray[np.bool_], pose: Array
    ) -> tuple[NDArray[np.bool_], Places]:
        """Keep the landmarks of one place few: limit insertion, and remove what is replaced.

        z (K, 3) observed from a pose (3,); wanted (K, M). Landmarks that were matched stay; the
        places of a cell that they leave go to the newest of the others. Returns `wanted` without
        the landmarks that find no place, and the ids (n,) of the landmarks removed.
        """
        new = np.flatnonzero(wanted.any(axis=1))
        if not len(new):
            return wanted, np.empty(0, np.int64)
        landmarks, limit = self.landmarks, self.config.existence.landmarks_per_cell
        edge = self.config.existence.landmark_cell
        points = np.concatenate([to_world(pose, z[new, :2]), z[new, 2:]], axis=1)
        cells, cell = np.unique(
            np.floor(points / edge).astype(np.int64), axis=0, return_inverse=True
        )
        size = landmarks.size
        matched, others = _in_cells(
            landmarks.reference[:size], landmarks.ids[:size], landmarks.counts[:size], edge, cells
        )
        room = np.maximum(limit - matched, 0)
        inserted = _ranks(cell) < room[cell]
        wanted[new[~inserted]] = False
        room -= np.bincount(cell[inserted], minlength=len(cells))
        never = np.flatnonzero(others >= 0)
        never = never[np.argsort(-landmarks.ids[never])]
        gone = never[_ranks(others[never]) >= room[others[never]]]
        ids = landmarks.ids[gone]
        landmarks.remove(gone)
        return wanted, ids

    def _region(self, point: Array) -> tuple[int, int]:
        size = self.config.region_size
        return math.floor(point[0] / size), math.floor(point[1] / size)

    def _is_unmapped(self, vehicle: int, z: Array, pose: Array) -> NDArray[np.bool_]:
        """Return (K,) whether no other vehicle was the first to map the place of z (K, 3)."""
        x, y, theta = pose
        c, s = math.cos(theta), math.sin(theta)
        points = np.stack([x + c * z[:, 0] - s * z[:, 1], y + s * z[:, 0] + c * z[:, 1]], axis=1)
        owners = [self.regions.get(self._region(point), vehicle) for point in points]
        free: NDArray[np.bool_] = np.array(owners) == vehicle
        return free

    def _update_evidence(
        self,
        state: AssociationState,
        agreed: NDArray[np.bool_],
        observed: Places,
        pose: Pose2,
    ) -> Places:
        """Raise the evidence of observed entries, lower that of missed ones, and remove landmarks.

        Returns the ids of the landmarks removed.
        """
        landmarks, existence, found = self.landmarks, self.config.existence, state.found
        landmarks.counts[observed] += 1
        gained = landmarks.evidence[observed] + _EVIDENCE_OF_MATCH
        landmarks.evidence[observed] = np.minimum(gained, existence.existence_limit)
        similar = np.count_nonzero(found.has_similar())
        confirmed = np.count_nonzero(agreed) >= max(_CONFIRMING, _CONFIRMING_FRACTION * similar)
        if (
            not self.engine.removes_landmarks
            or len(found) < _MINIMUM_OBSERVATIONS
            or not confirmed
        ):
            return np.empty(0, np.int64)
        size = landmarks.size
        known = landmarks.ids[:size]
        if found.hidden is not None:
            known = np.where(found.hidden, -1, known)
        expected = _expected(landmarks.reference[:size], known, *pose, found.observed.z)
        missed = np.setdiff1d(expected, observed, assume_unique=True)
        landmarks.evidence[missed] -= existence.existence_miss
        gone = missed[landmarks.evidence[missed] < 0.0]
        ids = landmarks.ids[gone]
        landmarks.remove(gone)
        return ids

    def state_dict(self) -> State:
        """Return the regions and who mapped them first."""
        rows = [[x, y, owner] for (x, y), owner in self.regions.items()]
        return {'regions': np.array(rows, np.int64).reshape(-1, 3)}

    def restore(self, state: State) -> None:
        """Restore the regions."""
        self.regions = {(x, y): owner for x, y, owner in state['regions'].tolist()}
