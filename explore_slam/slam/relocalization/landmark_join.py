"""Search for a vehicle of unknown start by the landmarks that it has in common with the map.

Each search finds a pose by RANSAC over the recent matches, as for a lost vehicle. Since a false
join corrupts two maps, several searches must agree on the pose of the vehicle's frame in the map,
from updates at different places, so that they do not rely on the same few landmarks.
"""

import math
from typing import NamedTuple

import numpy as np

from explore_slam.geometry import Array, Pose2
from explore_slam.slam.checkpoint import State, part, under
from explore_slam.slam.config import RelocalizationConfig
from explore_slam.slam.relocalization.relocalizer import RelocalizedPose, Relocalizer
from explore_slam.slam.storage.row_format import Places

# Chosen by hand; test_unknown_starts and test_landmark_loops show what a change does.
_AGREEMENTS = 3  # searches that must agree, the newest one included
_SPACING = 0.5  # m driven between two of them
_MAXIMUM_AGE = 15.0  # m driven after which a search no longer counts
# What two correct searches may differ by: their standard deviations (a few centimetres) and the
# drift over up to _MAXIMUM_AGE.
_POSITION, _HEADING = 0.3, 0.1  # m, rad


class _FoundFrame(NamedTuple):
    """Result of a search: the pose of the vehicle's frame in the map.

    distance_driven (m): by the vehicle until the search.
    """

    distance_driven: float
    pose: Pose2


class LandmarkJoin:
    """The matches of one vehicle with landmarks of the map, and the poses found by them.

    found_frames: results of the recent searches, oldest first.
    """

    def __init__(self, config: RelocalizationConfig) -> None:
        self.matches = Relocalizer(config)
        self.found_frames: list[_FoundFrame] = []

    def predict(self, increment: Pose2) -> None:
        """Propagate the vehicle by an odometry increment."""
        self.matches.predict(increment)

    def reset(self) -> None:
        """Discard all matches and searches: the vehicle was given another pose."""
        self.matches.reset()
        self.found_frames = []

    def add(self, z: Array, deviations: Array, similar_ids: Places) -> None:
        """Add the observations z (K, 3) of an update; similar_ids (K, A): of the map, or -1."""
        self.matches.add(z, deviations, similar_ids, np.zeros(len(z), np.bool_))

    def similar_ids(self) -> Places:
        """Return the ids of the landmarks that recent observations are similar to."""
        if not self.matches.updates:
            return np.empty(0, np.int64)
        return self.matches.similar_ids()

    def search(
        self, positions: dict[int, Array], own: Pose2, random: np.random.Generator
    ) -> RelocalizedPose | None:
        """Return the pose in the map once enough searches agree on the pose of the frame.

        positions: see Relocalizer.search; own: the pose in the vehicle's own frame.
        """
        driven = self.matches.distance
        if self.found_frames and driven - self.found_frames[-1].distance_driven < _SPACING:
            return None
        found = self.matches.search(positions, own, random)
        if found is None:
            return None
        frame = _FoundFrame(driven, found.pose.compose(own.inverse()))
        self.found_frames = [
            other for other in self.found_frames if driven - other.distance_driven < _MAXIMUM_AGE
        ]
        agreeing = sum(_agree(frame.pose, other.pose, own) for other in self.found_frames)
        self.found_frames.append(frame)
        return found if agreeing + 1 >= _AGREEMENTS else None

    def state_dict(self) -> State:
        """Return matches and results of searches."""
        rows = np.array([(frame.distance_driven, *frame.pose) for frame in self.found_frames])
        return {'found_frames': rows.reshape(-1, 4), **under('matches', self.matches.state_dict())}

    def restore(self, state: State) -> None:
        """Restore what `state_dict` returned."""
        self.found_frames = [
            _FoundFrame(driven, Pose2(*pose)) for driven, *pose in state['found_frames'].tolist()
        ]
        self.matches.restore(part('matches', state))


def _agree(one: Pose2, other: Pose2, own: Pose2) -> bool:
    """Return whether two poses of a vehicle's frame imply the same pose in the map.

    own: pose of the vehicle in that frame.
    """
    off = one.compose(own).between(other.compose(own))
    return math.hypot(off.x, off.y) < _POSITION and abs(off.theta) < _HEADING
