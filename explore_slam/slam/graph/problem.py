"""One least-squares problem, independent of the graph's growth: collected from it, taken over."""

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.geometry import Array, between, compose, to_world
from explore_slam.slam.graph import bounding
from explore_slam.slam.graph.config import GraphConfig
from explore_slam.slam.graph.factors import (
    CALIBRATION,
    CAUCHY,
    HUBER,
    OBSERVATION,
    RELATIVE_POSE,
    Factors,
    Integers,
    robust_weights,
)
from explore_slam.slam.graph.rows import fuse_rows
from explore_slam.slam.graph.storage import Storage

FULL = [0, 1, 2, 1, 3, 4, 2, 4, 5]  # a packed symmetric matrix, row by row


class Problem(NamedTuple):
    """Nodes and factors of vehicles that are tied together; no array is shared with the graph.

    Nodes are, in this order, the poses of the keyframes, the ends of chains that carry the motion
    of keyframes with white error, landmarks, and calibrations.
    """

    vehicles: tuple[int, ...]
    versions: tuple[int, ...]  # of the vehicles in the graph when the problem was collected
    keyframes: Integers  # (K,) numbers
    chains: Integers  # (C,) numbers of the keyframes that have a chain node of their own
    landmarks: Integers  # (L,) ids
    start: Array  # (K + C + L + V, 3) estimate from which to iterate
    factors: Factors
    measurements: Integers  # (Q,) numbers, in the graph, of the Q factors before the last O
    observations: Integers  # (O,) serial numbers of the last O factors
    calibrated: tuple[int, ...]  # vehicles with a calibration
    made_robust: tuple[int, ...] = ()  # factors that the graph still has without robust kernel

    @property
    def poses(self) -> int:
        """Number of nodes that are poses."""
        return len(self.keyframes) + len(self.chains)

    @property
    def first_calibration(self) -> int:
        """Node of the first calibration."""
        return len(self.start) - len(self.calibrated)

    def without_factors(self) -> 'Problem':
        """Return the problem without what only solving it needs, which is most of its memory."""
        none = Factors._make(column[:0].copy() for column in self.factors)
        return self._replace(factors=none, observations=self.observations[:0].copy())

    def with_robust(self, numbers: Sequence[int], scale: float) -> 'Problem':
        """Return the problem with a Cauchy kernel of a scale on factors that had no kernel."""
        end = len(self.factors.kind) - len(self.observations)
        rows = end - len(self.measurements) + np.flatnonzero(np.isin(self.measurements, numbers))
        robust, scales = self.factors.robust.copy(), self.factors.scale.copy()
        robust[rows], scales[rows] = CAUCHY, scale
        factors = self.factors._replace(robust=robust, scale=scales)
        return self._replace(factors=factors, made_robust=tuple(numbers))


def chosen_landmarks(
    keyframe: Integers,
    landmark: Integers,
    minimum: int,
    per_keyframe: int,
    before: Integers,
) -> NDArray[np.bool_]:
    """Return (L,) the landmarks that become variables.

    These are observed often enough, and are among the most observed of at least one keyframe, or
    of those that it shares with the observing keyframe before it: where a vehicle turns to
    something new, what many keyframes observe on either side has nothing in common.
    keyframe, landmark: (O,) rows of all observations. before: of each keyframe row, that of the
    observing keyframe before it, −1 for none.
    """
    counts = np.bincount(landmark)
    often = counts >= minimum
    candidates = np.flatnonzero(often[landmark])
    if not len(candidates) or np.bincount(keyframe[candidates]).max() <= per_keyframe:
        return often
    frame, seen = keyframe[candidates], landmark[candidates]
    # by keyframe, then the most observed first, then by row
    rank_of = np.empty(len(counts), np.int64)
    rank_of[np.lexsort((np.arange(len(counts)), -counts))] = np.arange(len(counts))
    chosen = np.zeros(len(counts), np.bool_)

    def choose(frame: Integers, seen: Integers) -> None:
        order = np.argsort(frame * len(counts) + rank_of[seen])
        frame = frame[order]
        rank = np.arange(len(frame)) - np.searchsorted(frame, frame)
        chosen[seen[order[rank < per_keyframe]]] = True

    choose(frame, seen)
    shared = (before[frame] >= 0) & np.isin(
        before[frame] * len(counts) + seen, frame * len(counts) + seen
    )
    choose(frame[shared], seen[shared])
    return chosen


def planar(W: Array) -> Array:
    """Return packed information matrices (n, 6) with height and position made independent.

    The marginal distributions of both stay: Schur complements of the height and of the plane.
    """
    xx, xy, xz, yy, yz, zz = W.T
    flat = np.zeros_like(W)
    flat[:, 0] = xx - xz * xz / zz
    flat[:, 1] = xy - xz * yz / zz
    flat[:, 3] = yy - yz * yz / zz
    flat[:, 5] = zz - (yy * xz * xz - 2.0 * xy * xz * yz + xx * yz * yz) / (xx * yy - xy * xy)
    return flat


def collect(storage: Storage, vehicles: tuple[int, ...], config: GraphConfig) -> Problem:
    """Collect the live keyframes of some vehicles and everything measured from them."""
    keyframes = storage.keyframes
    rows = np.flatnonzero(keyframes['live'] & np.isin(keyframes['vehicle'], vehicles))
    node = np.full(len(keyframes) + 1, -1)  # of each row of a keyframe; the last entry is row −1
    node[rows] = np.arange(len(rows))
    chained = rows[keyframes['has_white'][rows]]
    chain_node = node.copy()
    chain_node[chained] = len(rows) + np.arange(len(chained))
    poses = np.concatenate([keyframes['pose'][rows], keyframes['chain'][chained]])
    numbers, positions, seen, factors = _observations(storage, node, len(poses), config)
    calibrated = tuple(v for v in vehicles if v in storage.calibrations)
    calibrations = [storage.calibrations[v] for v in calibrated]
    first = len(poses) + len(positions)
    measured = np.flatnonzero(node[storage.factors['b']] >= 0)
    parts = [
        _motions(storage, rows, chain_node, {v: first + n for n, v in enumerate(calibrated)}),
        Factors.of(
            CALIBRATION,
            np.full(len(calibrated), -1),
            first + np.arange(len(calibrated)),
            np.zeros((len(calibrated), 3)),
            np.array([np.diag(c.deviations**-2.0) for c in calibrations]).reshape(-1, 3, 3),
        ),
        _white_errors(storage, chained, node, chain_node),
        _measurements(storage, measured, node),
    ]
    return Problem(
        vehicles,
        storage.versions_of(vehicles),
        keyframes['number'][rows],
        keyframes['number'][chained],
        numbers,
        np.concatenate([poses, positions, *(c.mean[None] for c in calibrations)]),
        Factors.joined(*parts, factors),
        storage.factors['number'][measured],
        seen,
        calibrated,
    )


def _motions(
    storage: Storage, rows: Integers, chain_node: Integers, calibration_node: dict[int, int]
) -> Factors:
    keyframes = storage.keyframes
    moved = rows[keyframes['previous_live'][rows] >= 0]
    sensitivity = keyframes['motion_sensitivity'][moved]
    nodes = [calibration_node.get(v, -1) for v in keyframes['vehicle'][moved].tolist()]
    depends = sensitivity.any(axis=(1, 2))
    return Factors.of(
        RELATIVE_POSE,
        chain_node[keyframes['previous_live'][moved]],
        chain_node[moved],
        keyframes['motion'][moved],
        keyframes['motion_information'][moved],
        c=np.where(depends, np.array(nodes, np.int64), -1),
        C=sensitivity,
    )


def _white_errors(
    storage: Storage, chained: Integers, node: Integers, chain_node: Integers
) -> Factors:
    return Factors.of(
        RELATIVE_POSE,
        node[chained],
        chain_node[chained],
        np.zeros((len(chained), 3)),
        storage.keyframes['white_information'][chained],
    )


def _measurements(storage: Storage, rows: Integers, node: Integers) -> Factors:
    found = Factors.of_rows(storage.factors, rows)
    return found._replace(a=node[found.a], b=node[found.b])


def _observations(
    storage: Storage, node: Integers, poses: int, config: GraphConfig
) -> tuple[Integers, Array, Integers, Factors]:
    """Return ids and positions of the landmarks that are variables, and their observations."""
    table, landmarks = storage.observations, storage.landmarks
    own = np.flatnonzero((table['landmark'] >= 0) & (node[table['keyframe']] >= 0))
    frame, landmark = table['keyframe'][own], table['landmark'][own]
    chosen = chosen_landmarks(
        frame,
        landmark,
        config.graph_minimum_observations,
        config.graph_observations_per_keyframe,
        _observing_before(storage, frame),
    )
    used = chosen[landmark]
    own, frame, landmark = own[used], node[frame[used]], landmark[used]
    chosen_rows = np.flatnonzero(chosen)
    place = np.cumsum(chosen) - 1
    W, z = table['W'][own], table['z'][own]
    if not config.graph_landmark_heights:
        W = planar(W)
    total = np.bincount(frame, table['weight'][own])
    share = np.minimum(1.0, config.graph_independent_observations / total[frame])
    factors = Factors.of(
        OBSERVATION,
        frame,
        poses + place[landmark],
        z,
        (W * share[:, None])[:, FULL],
        HUBER,
        config.graph_outlier_threshold,
    )
    positions = landmarks['position'][chosen_rows]
    fresh = ~landmarks['placed'][chosen_rows]
    if fresh.any():
        positions[fresh] = _first_positions(storage, own, place[landmark], len(chosen_rows))[fresh]
    return landmarks['number'][chosen_rows], positions, table['number'][own], factors


def _observing_before(storage: Storage, frames: Integers) -> Integers:
    """Return (K,) the observing keyframe before each of the vehicle, by row; −1 for none.

    frames (O,): rows of the keyframes of all observations.
    """
    before = np.full(len(storage.keyframes), -1)
    observing = np.unique(frames)
    vehicle = storage.keyframes['vehicle'][observing]
    for one in np.unique(vehicle):
        own = observing[vehicle == one]
        before[own[1:]] = own[:-1]
    return before


def _first_positions(storage: Storage, own: Integers, landmark: Integers, count: int) -> Array:
    """Return positions (L, 3) of landmarks given the estimated poses they were observed from."""
    order = np.argsort(landmark, kind='stable')
    own = own[order]
    rows, node = np.unique(storage.observations['keyframe'][own], return_inverse=True)
    out = np.empty((count, 9, 1))
    fuse_rows(
        np.searchsorted(landmark[order], np.arange(count + 1)),
        node.astype(np.int64),
        storage.observations['z'][own],
        storage.observations['W'][own],
        storage.keyframes['pose'][rows][:, :, None],
        out, 0, 1,
    )  # fmt: skip
    return out[:, :3, 0]


def take_over(storage: Storage, problem: Problem, nodes: Array) -> None:
    """Make an optimum (N, 3) of a problem the estimate.

    Keyframes added after the problem was collected move with the vehicle's last one in it; what
    was dropped or removed meanwhile is left out.
    """
    old = storage.keyframes['chain'].copy()
    _move_keyframes(storage, problem, nodes)
    for vehicle, mean in zip(problem.calibrated, nodes[problem.first_calibration :], strict=True):
        storage.calibrations[vehicle] = storage.calibrations[vehicle]._replace(mean=mean.copy())
    bounding.carry_dropped(storage, old)
    landmarks = storage.landmarks
    found = [storage.landmark_rows.get(number, -1) for number in problem.landmarks.tolist()]
    rows = np.array(found, np.int64)
    landmarks['placed'][landmarks_of(storage, problem.vehicles)] = False
    landmarks['position'][rows[rows >= 0]] = nodes[problem.poses : problem.first_calibration][
        rows >= 0
    ]
    landmarks['placed'][rows[rows >= 0]] = True
    weights = robust_weights(problem.factors.last(len(problem.observations)), nodes)
    known, seen = storage.observations['number'], problem.observations
    at = np.searchsorted(known, seen)
    same = known[np.minimum(at, len(known) - 1)] == seen if len(known) else seen < 0
    storage.observations['robust_weight'][at[same]] = weights[same]


def _move_keyframes(storage: Storage, problem: Problem, nodes: Array) -> None:
    keyframes = storage.keyframes
    rows = np.searchsorted(keyframes['number'], problem.keyframes)
    before = keyframes['pose'][rows]
    keyframes['pose'][rows] = keyframes['chain'][rows] = nodes[: len(rows)]
    chained = np.searchsorted(keyframes['number'], problem.chains)
    keyframes['chain'][chained] = nodes[len(rows) : problem.poses]
    vehicle = keyframes['vehicle']
    for number in problem.vehicles:
        last = np.flatnonzero(vehicle[rows] == number)[-1]
        later = rows[last] + 1 + np.flatnonzero(vehicle[rows[last] + 1 :] == number)
        for name in ('pose', 'chain'):
            steps = between(before[last], keyframes[name][later])
            keyframes[name][later] = compose(nodes[last], steps)


def move_landmarks(storage: Storage, vehicles: Collection[int], frame: Array) -> None:
    """Move the landmarks that vehicles observed to where the frame they are in has this pose."""
    rows = landmarks_of(storage, vehicles)
    positions = storage.landmarks['position']
    positions[rows] = to_world(frame, positions[rows])


def landmarks_of(storage: Storage, vehicles: Collection[int]) -> Integers:
    """Return the rows of the landmarks that some vehicles observed, ascending."""
    landmark, keyframe = storage.observations['landmark'], storage.observations['keyframe']
    theirs = np.isin(storage.keyframes['vehicle'], list(vehicles))[keyframe]
    observed = np.zeros(len(storage.landmarks) + 1, np.bool_)  # the last entry is that of row −1
    observed[landmark[theirs]] = True
    return np.flatnonzero(observed[:-1])
