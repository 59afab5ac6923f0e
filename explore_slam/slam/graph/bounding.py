"""Removal of keyframes, so that the size of the graph grows with the area and not with time.

Of each visit of a landmark a few observations are kept, of each vehicle a few visits. Keyframes
whose observations are not among them are dropped. Their observations are discarded rather than
marginalized, so that nothing counts twice and the graph stays sparse; the motions to and from a
dropped keyframe become one. Its pose on the path stays fixed relative to a kept keyframe that
observed the same landmarks.
"""

import numpy as np
from numpy.typing import NDArray

from explore_slam.geometry import Array, between, compose
from explore_slam.slam.graph import chain, checks, se2
from explore_slam.slam.graph.config import GraphConfig
from explore_slam.slam.graph.factors import Integers
from explore_slam.slam.graph.storage import Storage

# Landmarks that newer keyframes must have observed before an older one may go: two of them and
# their bearings fix a pose, a third one where these are nearly in line.
_MINIMUM_LANDMARKS = 3
# Keyframes of a vehicle, at most, that are kept until newer ones have enough observations: where
# a vehicle sees nothing, the graph must not grow without bound. Chosen by hand, far above the
# `graph_recent_observations` of any place with landmarks.
_MAXIMUM_RECENT = 100
# Chosen by hand on patrols of the simulated office (`explore_slam benchmark endurance`), where the
# graph otherwise grows until three visits of every landmark by every vehicle are kept: keyframes
# this near (m, rad) have the same view; one is rich in landmarks if it shows twice those that it
# makes variables. Such a view is known once two visits of it are kept that share as many with it,
# or once other visits have left eight keyframes: a rich texture shows something new each time. The
# latter drops a tenth of those that hold landmarks after 300 s, a quarter of those after 600 s.
_SAME_VIEW = (1.5, 0.8)
_RICH = 2.0
_VIEW_VISITS = 2
_VIEW_KEYFRAMES = 8


def count_visits(storage: Storage, row: int, landmarks: Integers, gap: int) -> Integers:
    """Return (n,) in which visit of its vehicle a keyframe observes landmarks (n,), from 1.

    A visit ends when the vehicle has not observed the landmark for `gap` keyframes.
    """
    vehicle = storage.vehicle_of(row)
    now = int(storage.keyframes['ordinal'][row])
    visits = []
    for number in landmarks.tolist():
        last, count = storage.visits.get((number, vehicle), (-gap - 1, 0))
        count += now - last > gap
        storage.visits[number, vehicle] = (max(now, last), count)
        visits.append(count)
    return np.array(visits, np.int64)


def retire_older(storage: Storage, vehicle: int, config: GraphConfig) -> None:
    """Decide which keyframes of a vehicle that are no longer among its newest ones may go.

    The current pose must not lose its support: a keyframe with observations is retired only when
    newer ones have enough of their own.
    """
    keyframes, table = storage.keyframes, storage.observations
    own = np.flatnonzero(~keyframes['retired'] & (keyframes['vehicle'] == vehicle))
    older = own[: -config.graph_recent_keyframes]
    if not len(older):
        return
    # the rows of keyframes do not ascend: a vehicle at rest observes from its newest one again
    frames, owners = table['keyframe'], table['landmark']
    seen = (owners >= 0) & (frames >= older[0]) & (keyframes['vehicle'][frames] == vehicle)
    frames, owners = frames[seen], owners[seen]
    counts = np.bincount(frames, minlength=own[-1] + 1)[own]
    newer = counts.sum() - np.cumsum(counts)
    # from the first one that has to wait on, all have to: there is even less after them
    may_wait = config.graph_recent_observations > 0 and len(own) <= _MAXIMUM_RECENT
    waits = False
    for row, count, later in zip(older.tolist(), counts, newer, strict=False):
        if count and may_wait and not waits:
            waits = (
                later < config.graph_recent_observations
                or len(np.unique(owners[frames > row])) < _MINIMUM_LANDMARKS
            )
        if not (count and waits):
            _retire(storage, row, config)


def _retire(storage: Storage, row: int, config: GraphConfig) -> None:
    keyframes = storage.keyframes
    keyframes['retired'][row] = True
    keyframes['holds_landmarks'][row] = _is_needed(storage, row, config)
    if not keyframes['holds_landmarks'][row]:
        keyframes['reference'][row] = _reference_of(storage, row)
        storage.drop_observations(storage.observations['keyframe'] == row)
        drop_if_free(storage, row)


def _is_needed(storage: Storage, row: int, config: GraphConfig) -> bool:
    """Return whether too little is kept of the landmarks that a keyframe observes.

    Too little of a landmark is kept if few observations of the present visit are, and few visits
    before it have any that are. Only the landmarks count that this keyframe makes variables. It is
    not needed either if it observes as many of which at most one visit is missing: these fix its
    pose, and what a rich texture shows anew at every visit would let the graph grow without bound.
    """
    table, vehicle = storage.observations, storage.keyframes['vehicle']
    counts = storage.landmarks['observation_count']
    owners, frames = table['landmark'], table['keyframe']
    own = np.flatnonzero((owners >= 0) & (frames == row))
    own = own[counts[owners[own]] >= config.graph_minimum_observations]
    visit_of = np.full(len(storage.landmarks) + 1, -1)  # the last entry is that of row −1
    visit_of[owners[own]] = table['visit'][own]
    shared = (visit_of[owners] >= 0) & (frames < row)
    rich = _RICH * config.graph_observations_per_keyframe
    if len(own) >= rich and _is_known_view(storage, row, owners[shared], frames[shared], config):
        return False
    kept = shared & (vehicle[frames] == vehicle[row])
    landmarks, visits = owners[kept], table['visit'][kept]
    now = visits == visit_of[landmarks]
    this_visit = np.bincount(landmarks[now], minlength=len(visit_of))
    earlier = np.unique(np.stack([landmarks, visits], axis=1)[~now], axis=0)
    earlier_visits = np.bincount(earlier[:, 0], minlength=len(visit_of))
    # Keyframes of the present visit fill up missing ones only as long as it is not beyond the
    # number of those kept: what is hardly ever seen would let the graph grow with every lap.
    mostly = earlier_visits >= max(config.graph_visits - 1, 1)
    if mostly[owners[own]].sum() >= config.graph_observations_per_keyframe:
        return False
    known = (earlier_visits >= config.graph_visits) | (mostly & (visit_of > config.graph_visits))
    few = (this_visit < config.graph_visit_observations) & ~known
    most = own[np.argsort(-counts[owners[own]], kind='stable')]
    most = most[: config.graph_observations_per_keyframe]
    return int(few[owners[most]].sum()) > config.graph_needed_fraction * len(most)


def _is_known_view(
    storage: Storage, row: int, landmarks: Integers, frames: Integers, config: GraphConfig
) -> bool:
    """Return whether other visits have kept enough of a view that is rich in landmarks.

    landmarks, frames (n,): the observations, from earlier keyframes, of the landmarks that it
    shows. Without a few of them from other visits, its pose might be another one.
    """
    vehicle, ordinal = storage.keyframes['vehicle'], storage.keyframes['ordinal']
    others = _are_of_other_visits(storage, row, frames, config)
    shared = len(np.unique(landmarks[others]))
    if shared < _MINIMUM_LANDMARKS:
        return False
    if shared >= _RICH * config.graph_observations_per_keyframe:
        rows = np.unique(frames[others])
        rows = rows[_are_near(storage, row, rows)]
        visits = sum(
            1 + int((np.diff(ordinal[rows[vehicle[rows] == one]]) > config.graph_visit_gap).sum())
            for one in np.unique(vehicle[rows])
        )
        if visits >= _VIEW_VISITS:
            return True
    rows = np.arange(row)
    rows = rows[_are_of_other_visits(storage, row, rows, config)]
    return int(_are_near(storage, row, rows).sum()) >= _VIEW_KEYFRAMES


def _are_of_other_visits(
    storage: Storage, row: int, frames: Integers, config: GraphConfig
) -> NDArray[np.bool_]:
    """Return (n,) which of some keyframes hold landmarks and belong to another visit than one."""
    keyframes = storage.keyframes
    vehicle, ordinal = keyframes['vehicle'], keyframes['ordinal']
    is_past = ordinal[row] - ordinal[frames] > config.graph_visit_gap
    found: NDArray[np.bool_] = keyframes['holds_landmarks'][frames] & (
        (vehicle[frames] != vehicle[row]) | is_past
    )
    return found


def _are_near(storage: Storage, row: int, rows: Integers) -> NDArray[np.bool_]:
    """Return (n,) which of some keyframes show about the view of another."""
    poses = storage.keyframes['pose']
    offsets = between(poses[row], poses[rows])
    distance, heading = _SAME_VIEW
    near: NDArray[np.bool_] = np.hypot(*offsets[:, :2].T) < distance
    return near & (np.abs(offsets[:, 2]) < heading)


def _reference_of(storage: Storage, row: int) -> int:
    """Return the row of the kept keyframe with the most landmarks of another; −1: none.

    Of those with as many, the nearest.
    """
    table, keyframes = storage.observations, storage.keyframes
    owners, frames = table['landmark'], table['keyframe']
    shared = np.zeros(len(storage.landmarks) + 1, np.bool_)  # the last entry is that of row −1
    shared[owners[(owners >= 0) & (frames == row)]] = True
    shared[-1] = False
    others = frames[shared[owners] & keyframes['holds_landmarks'][frames]]
    others = others[others != row]
    if not len(others):
        return -1
    counts = np.bincount(others)
    most = np.flatnonzero(counts == counts.max())
    offsets = keyframes['chain'][most, :2] - keyframes['chain'][row, :2]
    return int(most[np.argmin(np.hypot(*offsets.T))])


def drop_if_free(storage: Storage, row: int) -> None:
    """Drop a keyframe that is retired, holds no landmarks and is neither pinned nor measured.

    The first one of a vehicle, at which its path begins, stays; so do those where it was placed
    anew, and the last ones before.
    """
    keyframes, factors = storage.keyframes, storage.factors
    if (
        keyframes['previous_live'][row] < 0
        or not keyframes['retired'][row]
        or not keyframes['live'][row]
        or keyframes['holds_landmarks'][row]
        or keyframes['pins'][row] > 0
        or ((factors['a'] == row) | (factors['b'] == row)).any()
    ):
        return
    following = np.flatnonzero(keyframes['live'] & (keyframes['previous_live'] == row))
    if not len(following):
        return
    after = int(following[0])
    calibration = storage.calibration_of(row)
    first, second = (
        keyframes['motion'][end] + keyframes['motion_sensitivity'][end] @ calibration
        for end in (row, after)
    )
    mean, covariance = se2.compound(
        first,
        keyframes['motion_covariance'][row],
        second,
        keyframes['motion_covariance'][after],
    )
    F, G = se2.jacobians(first, mean)
    sensitivity = F @ keyframes['motion_sensitivity'][row]
    sensitivity += G @ keyframes['motion_sensitivity'][after]
    keyframes['motion'][after] = mean - sensitivity @ calibration
    keyframes['motion_sensitivity'][after] = sensitivity
    keyframes['motion_covariance'][after] = covariance
    keyframes['motion_information'][after] = checks.information('motion', covariance)
    keyframes['previous_live'][after] = keyframes['previous_live'][row]
    keyframes['live'][row] = False
    storage.touch([row])


def carry_dropped(storage: Storage, old: Array) -> None:
    """Move the keyframes that were dropped along with those that are live.

    old (K, 3): where the motions of all keyframes ended before the live ones were moved. What was
    observed stays relative to its reference; the rest is interpolated between these by the
    measured motion, which the calibration may have changed.
    """
    keyframes = storage.keyframes
    if keyframes['live'].all():
        return
    chains = keyframes['chain'].copy()
    rows = np.arange(len(chains))
    motions = chain.Chain(
        keyframes['previous'],
        keyframes['live'],
        keyframes['reference'],
        storage.calibrated_increments(rows),
        keyframes['covariance'],
    )
    chain.carry_dropped(motions, old, checks.EXACT_DEVIATION**2, chains)
    dropped = ~keyframes['live']
    # what was known of its white error when a keyframe was dropped stays known
    white = between(old[dropped], keyframes['pose'][dropped])
    keyframes['chain'][dropped] = chains[dropped]
    keyframes['pose'][dropped] = compose(chains[dropped], white)
