"""What an update leaves in the landmark map: insertion, evidence, removal."""

import math

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.geometry import Array, Pose2
from explore_slam.slam.association.candidates import Sighted
from explore_slam.slam.association.gating import Choice
from explore_slam.slam.config import FastSlamConfig
from explore_slam.slam.landmarks.landmark_map import LandmarkMap
from explore_slam.slam.update.landmark_update import fill_absent, insert_landmarks

_FEWEST_FOR_MISSES = 8
_BIN = 0.1


@kernel
def support(choice: Choice, weights: Array, candidates: int) -> Array:  # pragma: no cover
    """Return (K, J): weight of the particles that chose each candidate."""
    total = np.zeros((len(choice), candidates))
    for k in range(len(choice)):
        for m in range(len(weights)):
            j = choice[k, m]
            if j >= 0:
                total[k, j] += weights[m]
    return total


@kernel
def _expected(
    reference: Array, ids: NDArray[np.int64], x: float, y: float, theta: float, z: Array
) -> NDArray[np.int64]:  # pragma: no cover - compiled
    """Return items that should be seen: an observation near their direction lies beyond them.

    reference (N, 3) positions in the map; z (K, 3) observed, in the vehicle frame. Directions are
    compared in bins of azimuth and elevation.
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


class MapKeeper:
    """Writes updates to a landmark map, and decides what is inserted and what is forgotten."""

    def __init__(self, landmarks: LandmarkMap, config: FastSlamConfig) -> None:
        self.landmarks = landmarks
        self.config = config
        self.regions: dict[tuple[int, int], int] = {}

    def write(
        self, vehicle: int, sighted: Sighted, poses: Array, support_of: Array, best: int
    ) -> tuple[int, int]:
        """Commit an update of a vehicle at poses (M, 3); return the numbers inserted and removed.

        support_of (K, J) weight of the particles for each candidate; best: the best particle.
        """
        rows = self.landmarks.rows
        agreed = support_of.sum(axis=1) > 0.5
        wanted = self._wanted(vehicle, sighted, agreed, poses[best])
        filled = fill_absent(
            rows.present_data,
            sighted.slots,
            sighted.candidates,
            sighted.z,
            sighted.R,
            poses,
            wanted,
        )
        chosen = np.zeros(len(sighted.items))
        real = sighted.candidates >= 0
        np.add.at(chosen, sighted.candidates[real], support_of[real])
        touched = sighted.taken() | filled
        items, slots = sighted.items[touched], sighted.slots[touched]
        rows.revert(sighted.items[~touched], sighted.slots[~touched], sighted.home)
        rows.commit(items, slots, sighted.home)
        there = rows.present_data[slots, 3, best] > 0.0
        self.landmarks.reference[items[there]] = rows.present_data[slots[there], :3, best]
        seen = sighted.items[chosen > 0.5]
        removed = self._evidence(sighted, agreed, seen, Pose2.from_array(poses[best]))
        return self._insert(vehicle, sighted, poses, wanted), removed

    def _wanted(
        self, vehicle: int, sighted: Sighted, agreed: NDArray[np.bool_], pose: Array
    ) -> NDArray[np.bool_]:
        """Return (K, M): where an observation becomes a new landmark.

        In engine fastslam2 that is where most particles have no landmark for it; and if it is
        like a landmark all the same, only where the other matches show that the pose is right.
        Nothing is inserted where nearly all matches say that the pose is wrong.
        """
        free: NDArray[np.bool_] = sighted.choice < 0
        if self.config.engine == 'fastslam2':
            likes = np.count_nonzero((sighted.alike >= 0).any(axis=1) & sighted.telling)
            agreeing = np.count_nonzero(agreed)
            new = ~agreed
            if agreeing < max(3, 0.5 * np.count_nonzero(sighted.telling)):
                new &= ~sighted.telling
            if likes >= 0.4 * len(agreed) and agreeing < 0.25 * likes:
                new[:] = False
            free &= new[:, None]
        if self.config.insertion_policy == 'unmapped_region':
            free &= self._unmapped(vehicle, sighted.z, pose)[:, None]
        return free

    def _insert(
        self, vehicle: int, sighted: Sighted, poses: Array, wanted: NDArray[np.bool_]
    ) -> int:
        new = np.flatnonzero(wanted.any(axis=1))
        if not len(new):
            return 0
        slots = self.landmarks.rows.new_slots(len(new))
        data = self.landmarks.rows.present_data
        data[slots] = 0.0
        insert_landmarks(data, slots, sighted.z[new], sighted.R[new], wanted[new], poses)
        reference = data[slots, :3, np.argmax(wanted[new], axis=1)]
        self.landmarks.add(slots, sighted.descriptors[new], vehicle, reference, sighted.home)
        for point in reference:
            self.regions.setdefault(self._region(point), vehicle)
        return len(new)

    def _region(self, point: Array) -> tuple[int, int]:
        size = self.config.region_size
        return math.floor(point[0] / size), math.floor(point[1] / size)

    def _unmapped(self, vehicle: int, z: Array, pose: Array) -> NDArray[np.bool_]:
        """Tell for observations z (K, 3) whether no other vehicle has mapped their place first."""
        x, y, theta = pose
        c, s = math.cos(theta), math.sin(theta)
        points = np.stack([x + c * z[:, 0] - s * z[:, 1], y + s * z[:, 0] + c * z[:, 1]], axis=1)
        owners = [self.regions.get(self._region(point), vehicle) for point in points]
        free: NDArray[np.bool_] = np.array(owners) == vehicle
        return free

    def _evidence(
        self, sighted: Sighted, agreed: NDArray[np.bool_], seen: NDArray[np.int64], pose: Pose2
    ) -> int:
        """Raise the evidence of what was seen, lower that of what should have been; remove.

        Misses count only where enough is observed and most matches show that the pose is right.
        """
        landmarks, existence = self.landmarks, self.config.existence
        landmarks.counts[seen] += 1
        gained = landmarks.evidence[seen] + existence.existence_hit
        landmarks.evidence[seen] = np.minimum(gained, existence.existence_limit)
        agreeing = np.count_nonzero(agreed)
        sure = agreeing >= max(3, 0.5 * np.count_nonzero((sighted.alike >= 0).any(axis=1)))
        if self.config.engine == 'paper' or len(sighted.z) < _FEWEST_FOR_MISSES or not sure:
            return 0
        size = landmarks.size
        expected = _expected(landmarks.reference[:size], landmarks.ids[:size], *pose, sighted.z)
        missed = np.setdiff1d(expected, seen, assume_unique=True)
        landmarks.evidence[missed] -= existence.existence_miss
        gone = missed[landmarks.evidence[missed] < 0.0]
        landmarks.remove(gone)
        return len(gone)
