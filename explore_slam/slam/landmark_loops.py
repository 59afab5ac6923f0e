"""Search for loops of a vehicle that does not notice, by what it sees, that it is lost.

A vehicle that comes back to a place with more drift than it is aware of may map the place a second
time: what it observes then agrees with what it has just inserted. Therefore its observations are
also compared with all landmarks but those that it has inserted lately. As for a vehicle of unknown
start, several searches must agree on where it is, from updates at different places.
"""

import numpy as np
from numpy.typing import NDArray

from explore_slam.geometry import Array, Pose2
from explore_slam.slam.association.state import CandidateSet
from explore_slam.slam.checkpoint import State, part, under
from explore_slam.slam.config import RelocalizationConfig
from explore_slam.slam.landmark_join import LandmarkJoin
from explore_slam.slam.landmarks.landmark_map import LandmarkMap
from explore_slam.slam.relocalization import Relocalized
from explore_slam.slam.storage.row_format import Places

# m driven: landmarks that a vehicle has inserted since then are in sight or just behind it. As of
# anchors (`closure_minimum_distance`).
_RECENT = 10.0
_SPACING = 1.0  # m driven between two searches, which compare with the whole map
# Part of the landmarks observed that must be recent: elsewhere no loop is open.
_MOSTLY = 0.5


class LandmarkLoops:
    """What one vehicle observes of landmarks that are not its latest, and where that places it."""

    def __init__(self, config: RelocalizationConfig) -> None:
        self._join = LandmarkJoin(config)
        # distance driven (m) and id of the next landmark, at updates from _RECENT ago on
        self._marks = [(0.0, 0)]
        self._searched = 0.0  # distance driven (m) at the last search

    def predict(self, increment: Pose2) -> None:
        """Propagate the vehicle by an odometry increment."""
        self._join.predict(increment)

    def reset(self) -> None:
        """Forget what was matched: the vehicle has been given another pose."""
        self._join.reset()

    def is_due(self, observed: Places, next_id: int) -> bool:
        """Return whether to search after an update; next_id: of the next landmark.

        observed (K,): ids of the landmarks that the update made of its observations, or -1.
        """
        driven = self._join.matches.distance
        self._marks.append((driven, next_id))
        while self._marks[1][0] <= driven - _RECENT:
            del self._marks[0]
        known = observed[observed >= 0]
        mostly_recent = np.count_nonzero(known >= self._first_recent) >= _MOSTLY * len(known)
        if driven - self._searched < _SPACING or not mostly_recent:
            return False
        self._searched = driven
        return True

    @property
    def _first_recent(self) -> int:
        return self._marks[0][1]

    def latest(self, landmarks: LandmarkMap, number: int) -> NDArray[np.bool_]:
        """Return which entries of the map the vehicle, of this number, has inserted lately."""
        ids, owners = landmarks.ids[: landmarks.size], landmarks.owners[: landmarks.size]
        found: NDArray[np.bool_] = (ids >= self._first_recent) & (owners == number)
        return found

    def add(self, found: CandidateSet) -> Places:
        """Add the observations of an update; return the ids of landmarks similar to recent ones.

        found: with candidates that are not the latest landmarks.
        """
        R = found.measured.R
        deviations = np.sqrt(0.5 * (R[:, 0] + R[:, 3]))
        similar = np.where(found.is_distinctive[:, None], found.similar_ids, -1)
        self._join.add(found.observed.z, deviations, similar)
        return self._join.similar_ids()

    def search(
        self, positions: dict[int, Array], current: Pose2, random: np.random.Generator
    ) -> Relocalized | None:
        """Return where the vehicle is once enough searches agree; see LandmarkJoin.search."""
        return self._join.search(positions, current, random)

    def state_dict(self) -> State:
        """Return matches, searches and when landmarks were inserted."""
        return {
            'marks': np.array(self._marks),
            'searched': np.array(self._searched),
            **under('join', self._join.state_dict()),
        }

    def restore(self, state: State) -> None:
        """Restore what `state_dict` returned."""
        self._marks = [(driven, int(uid)) for driven, uid in state['marks'].tolist()]
        self._searched = float(state['searched'])
        self._join.restore(part('join', state))
