"""Search for loops that data association misses.

A vehicle that returns to a place with more drift than its covariance covers may map the place a
second time: its observations then agree with the landmarks that it has just inserted. Therefore
they are also compared with all landmarks other than its recent ones. As for a vehicle of unknown
start, several searches must agree on the pose, from updates at different places.
"""

import numpy as np
from numpy.typing import NDArray

from explore_slam.geometry import Array, Pose2
from explore_slam.slam.association.state import CandidateSet
from explore_slam.slam.checkpoint import State, part, under
from explore_slam.slam.config import RelocalizationConfig
from explore_slam.slam.landmarks.landmark_map import LandmarkMap
from explore_slam.slam.relocalization.landmark_join import LandmarkJoin
from explore_slam.slam.relocalization.relocalizer import RelocalizedPose
from explore_slam.slam.storage.row_format import Places

# Chosen by hand; `test_landmark_loops` shows what a change does.
# m driven: landmarks inserted since then are in sight or just behind the vehicle. The same as for
# anchors (`closure_minimum_distance`).
_RECENT_DISTANCE = 10.0
_SPACING = 1.0  # m driven between two searches, since each compares with the whole map
# Part of the observed landmarks that must be recent: where most are old, the loop is closed.
_RECENT_FRACTION = 0.5


class LandmarkLoops:
    """Matches of one vehicle with landmarks other than its recent ones, and the search by them."""

    def __init__(self, config: RelocalizationConfig) -> None:
        self._join = LandmarkJoin(config)
        # distance driven (m) and id of the next landmark, at updates from _RECENT_DISTANCE ago on
        self._marks = [(0.0, 0)]
        self._searched = 0.0  # distance driven (m) at the last search

    def predict(self, increment: Pose2) -> None:
        """Propagate the vehicle by an odometry increment."""
        self._join.predict(increment)

    def reset(self) -> None:
        """Discard all matches: the vehicle was given another pose."""
        self._join.reset()

    def is_due(self, observed: Places, next_id: int) -> bool:
        """Return whether to search after an update.

        observed (K,): ids of the landmarks that the update associated or inserted, or -1; next_id:
        of the landmark that is inserted next.
        """
        driven = self._join.matches.distance
        self._marks.append((driven, next_id))
        while self._marks[1][0] <= driven - _RECENT_DISTANCE:
            del self._marks[0]
        known = observed[observed >= 0]
        recent = np.count_nonzero(known >= self.first_recent)
        mostly_recent = recent >= _RECENT_FRACTION * len(known)
        if driven - self._searched < _SPACING or not mostly_recent:
            return False
        self._searched = driven
        return True

    @property
    def first_recent(self) -> int:
        """Landmarks of this vehicle from this id on are recent."""
        return self._marks[0][1]

    @property
    def distance_driven(self) -> float:
        """Distance (m) that the vehicle has driven."""
        return self._join.matches.distance

    def is_recent(self, landmarks: LandmarkMap, number: int) -> NDArray[np.bool_]:
        """Return (n,) which entries of the map this vehicle, by number, has inserted recently."""
        ids, owners = landmarks.ids[: landmarks.size], landmarks.owners[: landmarks.size]
        found: NDArray[np.bool_] = (ids >= self.first_recent) & (owners == number)
        return found

    def add(self, found: CandidateSet) -> Places:
        """Add the observations of an update; return the ids of similar landmarks to all matches.

        found: with candidates that are not recent landmarks.
        """
        R = found.measured.R
        deviations = np.sqrt(0.5 * (R[:, 0] + R[:, 3]))
        similar = np.where(found.is_distinctive[:, None], found.similar_ids, -1)
        self._join.add(found.observed.z, deviations, similar)
        return self._join.similar_ids()

    def search(
        self, positions: dict[int, Array], current: Pose2, random: np.random.Generator
    ) -> RelocalizedPose | None:
        """Return the pose of the vehicle once enough searches agree; see LandmarkJoin.search."""
        return self._join.search(positions, current, random)

    def state_dict(self) -> State:
        """Return matches, searches and the distances at which landmarks were inserted."""
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
