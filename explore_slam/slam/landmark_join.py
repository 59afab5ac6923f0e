"""Search for a vehicle of unknown start by the landmarks that it has in common with the map.

Each search finds a pose by RANSAC over the recent matches, as for a lost vehicle. Since a false
join spoils two maps, several searches must agree on where the frame of the vehicle lies: from
updates at different places, so that they do not rest on the same few landmarks.
"""

import math

import numpy as np

from explore_slam.geometry import Array, Pose2
from explore_slam.slam.checkpoint import State, part, under
from explore_slam.slam.config import RelocalizationConfig
from explore_slam.slam.relocalization import Relocalized, Relocalizer
from explore_slam.slam.storage.row_format import Places

_AGREEMENTS = 3  # searches that must agree, the newest one included
_APART = 0.5  # m driven between two of them
_FORGOTTEN = 15.0  # m driven after which a search no longer counts
# What two right searches may differ by: their deviations, and the drift over the distance between.
_POSITION, _HEADING = 0.3, 0.1  # m, rad


class LandmarkJoin:
    """The matches of one vehicle with landmarks of the map, and where they have placed it.

    frames: way (m) and pose of the vehicle's frame in the map (x, y, theta), as found so far.
    """

    def __init__(self, config: RelocalizationConfig) -> None:
        self.matches = Relocalizer(config)
        self.frames: list[Array] = []

    def predict(self, increment: Pose2) -> None:
        """Propagate the vehicle by an odometry increment."""
        self.matches.predict(increment)

    def reset(self) -> None:
        """Forget all matches and searches: the vehicle has been given another pose."""
        self.matches.reset()
        self.frames = []

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
    ) -> Relocalized | None:
        """Return the pose in the map once enough searches agree on where the frame lies.

        positions: see Relocalizer.search; own: the pose in the vehicle's own frame.
        """
        way = self.matches.distance
        if self.frames and way - self.frames[-1][0] < _APART:
            return None
        found = self.matches.search(positions, own, random)
        if found is None:
            return None
        frame = np.array([way, *found.pose.compose(own.inverse())])
        self.frames = [other for other in self.frames if way - other[0] < _FORGOTTEN]
        agreeing = sum(_agree(frame, other, own) for other in self.frames)
        self.frames.append(frame)
        return found if agreeing + 1 >= _AGREEMENTS else None

    def state_dict(self) -> State:
        """Return matches and frames."""
        frames = np.array(self.frames).reshape(-1, 4)
        return {'frames': frames, **under('matches', self.matches.state_dict())}

    def restore(self, state: State) -> None:
        """Restore what `state_dict` returned."""
        self.frames = list(state['frames'].copy())
        self.matches.restore(part('matches', state))


def _agree(one: Array, other: Array, own: Pose2) -> bool:
    """Tell whether two frames place a vehicle, at its own pose, at the same pose in the map."""
    first = Pose2.from_array(one[1:]).compose(own)
    second = Pose2.from_array(other[1:]).compose(own)
    off = first.between(second)
    return math.hypot(off.x, off.y) < _POSITION and abs(off.theta) < _HEADING
