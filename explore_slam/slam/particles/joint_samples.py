"""Joint samples of all keyframe poses: what the particles of a group descend from.

The joint graph draws one path per particle. Landmark rows follow from a path and the stored
observations, N(l | Xᵐ, z); they are fused when a landmark is first needed, so that a draw costs
the same however many landmarks there are.
"""

from typing import Self

import numpy as np
from numpy.typing import NDArray

from explore_slam.geometry import Array
from explore_slam.slam.checkpoint import State, part, under
from explore_slam.slam.graph.rows import StoredObservations, fuse_rows
from explore_slam.slam.storage.ancestry import Index
from explore_slam.slam.storage.row_format import ROW_LENGTH, Places


class JointSamples:
    """Sampled paths, the observations stored when they were drawn, and who descends from whom.

    number: identifies the draw. keyframes (N,): numbers in the joint graph, ascending. mean
    (N, 3): the optimum that poses (N, 3, S) were drawn around. ids (L,): landmarks, ascending,
    with their observations. lineage (M,): sample that each present particle descends from.
    """

    def __init__(
        self,
        number: int,
        keyframes: Places,
        mean: Array,
        poses: Array,
        ids: Places,
        observations: StoredObservations,
        lineage: Index,
    ) -> None:
        self.number = number
        self.keyframes = keyframes
        self.mean = mean
        self.poses = poses
        self.ids = ids
        self.observations = observations
        self.lineage = lineage
        self._node = observations.located(keyframes)

    @classmethod
    def of_start(cls, number: int, particles: int) -> Self:
        """Return the samples that all particles are before the first draw: no keyframes."""
        nothing = np.empty(0, np.int64)
        observations = StoredObservations(
            np.zeros(1, np.int64), nothing, np.empty((0, 3)), np.empty((0, 6))
        )
        lineage = np.arange(particles, dtype=np.int32)
        return cls(
            number, nothing, np.empty((0, 3)), np.empty((0, 3, particles)), nothing, observations,
            lineage,
        )  # fmt: skip

    def resample(self, ancestors: Index) -> None:
        """Note that the particles were replaced by copies of ancestors (M,)."""
        self.lineage = self.lineage[ancestors]

    def distinct(self) -> int:
        """Return how many of the samples still have descendants."""
        return len(np.unique(self.lineage))

    def pose_of(self, keyframe: int) -> Array:
        """Return the poses (M, 3) of a keyframe in the present particles."""
        row = int(np.searchsorted(self.keyframes, keyframe))
        poses: Array = self.poses[row][:, self.lineage].T.copy()
        return poses

    def fused(self, ids: Places) -> Array:
        """Return rows (n, 9, M) of landmarks (n,) in the present particles."""
        samples, column = np.unique(self.lineage, return_inverse=True)
        rows = self._fuse(ids, self.poses[:, :, samples])
        fused: Array = rows[:, :, column]
        return fused

    def fused_at_mean(self, ids: Places) -> Array:
        """Return rows (n, 9) of landmarks (n,) given the most likely path."""
        rows: Array = self._fuse(ids, self.mean[:, :, None])[:, :, 0]
        return rows

    def _fuse(self, ids: Places, poses: Array) -> Array:
        places = np.searchsorted(self.ids, ids)
        begin, end = self.observations.first[places], self.observations.first[places + 1]
        counts = end - begin
        first = np.concatenate([[0], np.cumsum(counts)])
        chosen = np.repeat(begin - first[:-1], counts) + np.arange(first[-1])
        used, node = np.unique(self._node[chosen], return_inverse=True)
        rows = np.empty((len(ids), ROW_LENGTH, poses.shape[2]))
        fuse_rows(
            first,
            node.astype(np.int64),
            np.ascontiguousarray(self.observations.z[chosen]),
            np.ascontiguousarray(self.observations.W[chosen]),
            np.ascontiguousarray(poses[used]),
            rows,
            0,
            poses.shape[2],
        )
        return rows

    def state_dict(self) -> State:
        """Return everything."""
        return {
            'number': np.array(self.number),
            'keyframes': self.keyframes,
            'mean': self.mean,
            'poses': self.poses,
            'ids': self.ids,
            'lineage': self.lineage,
            **under('observations', self.observations._asdict()),
        }

    @classmethod
    def from_state(cls, state: State) -> Self:
        """Return samples as saved."""
        arrays = {name: state[name].copy() for name in ('keyframes', 'mean', 'poses', 'ids')}
        observations = part('observations', state)
        return cls(
            int(state['number']),
            observations=StoredObservations(
                *(observations[name].copy() for name in StoredObservations._fields)
            ),
            lineage=state['lineage'].copy(),
            **arrays,
        )


def deferred(numbers: NDArray[np.int64], entries: Places) -> dict[int, Places]:
    """Return, per draw, which entries must be fused from it; numbers of draws by entry."""
    mine = entries[numbers[entries] >= 0]
    return {int(n): mine[numbers[mine] == n] for n in np.unique(numbers[mine])}
