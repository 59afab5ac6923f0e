"""One interface for common and dedicated maps: a joint filter, or a filter per vehicle."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Self

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import InterRobotObservation, LandmarkObservations
from explore_slam.errors import SlamError
from explore_slam.geometry import Array, Pose2
from explore_slam.slam.checkpoint import Checkpointed, State, part, under
from explore_slam.slam.config import FastSlamConfig
from explore_slam.slam.fast_slam import FastSlam
from explore_slam.slam.landmarks.landmark_map import Landmarks
from explore_slam.slam.posterior.joint_posterior import RelativePose
from explore_slam.slam.posterior.tag_constraints import TagConstraints
from explore_slam.slam.storage.row_format import Places
from explore_slam.slam.summary import UpdateSummary


class TeamBelief(Checkpointed):
    """The interface of FastSlam; with `maps: dedicated`, one filter and map per vehicle."""

    def __init__(
        self,
        start_poses: Mapping[str, Pose2 | None],
        config: FastSlamConfig | None = None,
        seed: int = 0,
    ) -> None:
        self.config = config if config is not None else FastSlamConfig()
        self.vehicles = tuple(start_poses)
        unknown = [name for name, pose in start_poses.items() if pose is None]
        if unknown and self.config.maps != 'common':
            raise SlamError(f'the start poses of {unknown} are unknown, which needs maps: common')
        if self.config.maps == 'common':
            self.filters = [FastSlam(start_poses, self.config, seed)]
            self._filter_of = dict.fromkeys(self.vehicles, 0)
        else:
            self.filters = [
                FastSlam({name: pose}, self.config, seed + number)
                for number, (name, pose) in enumerate(start_poses.items())
            ]
            self._filter_of = {name: number for number, name in enumerate(self.vehicles)}
        self._keyframes: list[int] = []  # the filter of each keyframe
        self._own_numbers: list[int] = []  # the number of each keyframe in its filter

    def filter_of(self, vehicle: str) -> FastSlam:
        """Return the filter that holds a vehicle."""
        try:
            return self.filters[self._filter_of[vehicle]]
        except (KeyError, TypeError):
            raise SlamError(
                f'there is no vehicle {vehicle!r}, expected one of {list(self.vehicles)}'
            ) from None

    def predict(
        self,
        vehicle: str,
        increment: Pose2,
        covariance: Array | None = None,
        white: Array | None = None,
    ) -> None:
        """See FastSlam.predict."""
        self.filter_of(vehicle).predict(vehicle, increment, covariance, white)

    def update(self, vehicle: str, observations: LandmarkObservations) -> UpdateSummary:
        """See FastSlam.update."""
        return self.filter_of(vehicle).update(vehicle, observations)

    def update_inter_robot(
        self, vehicle: str, observations: Sequence[InterRobotObservation]
    ) -> None:
        """See FastSlam.update_inter_robot; SlamError with dedicated maps."""
        if len(self.filters) > 1:
            raise SlamError('update_inter_robot needs maps: common, this team has maps: dedicated')
        self.filters[0].update_inter_robot(vehicle, observations)

    def set_pose(self, vehicle: str, pose: Pose2, covariance: Array) -> None:
        """See FastSlam.set_pose."""
        self.filter_of(vehicle).set_pose(vehicle, pose, covariance)

    def displace(self, vehicle: str, covariance: Array) -> None:
        """See FastSlam.displace."""
        self.filter_of(vehicle).displace(vehicle, covariance)

    def restart_clock(self, vehicle: str) -> None:
        """See FastSlam.restart_clock."""
        self.filter_of(vehicle).restart_clock(vehicle)

    def estimate(self, vehicle: str) -> tuple[Pose2, Array]:
        """See FastSlam.estimate."""
        return self.filter_of(vehicle).estimate(vehicle)

    def motion(
        self, vehicle: str, steps: Iterable[tuple[Pose2, Array | None]]
    ) -> tuple[Pose2, Array]:
        """See FastSlam.motion."""
        return self.filter_of(vehicle).motion(vehicle, steps)

    def odometry_calibration(self, vehicle: str) -> tuple[Array, Array]:
        """See FastSlam.odometry_calibration."""
        return self.filter_of(vehicle).odometry_calibration(vehicle)

    def best_pose(self, vehicle: str) -> Pose2:
        """See FastSlam.best_pose."""
        return self.filter_of(vehicle).best_pose(vehicle)

    def particle_poses(self, vehicle: str) -> Array:
        """See FastSlam.particle_poses."""
        return self.filter_of(vehicle).particle_poses(vehicle)

    def best_particle(self, vehicle: str | None = None) -> int:
        """See FastSlam.best_particle."""
        name = self.vehicles[0] if vehicle is None else vehicle
        return self.filter_of(name).best_particle(name)

    def effective_particles(self) -> float:
        """Return the effective sample size, 1 to M: the smallest of all filters."""
        return min(item.effective_particles() for item in self.filters)

    def landmarks(self, vehicle: str | None = None) -> Landmarks:
        """Return the landmarks of the best particles: of one vehicle's map, or of all maps.

        The ids of several maps together are `id in its map × number of maps + number of the map`,
        so that they are unique.
        """
        if vehicle is not None or len(self.filters) == 1:
            name = self.vehicles[0] if vehicle is None else vehicle
            return self.filter_of(name).landmarks()
        parts = [item.landmarks() for item in self.filters]
        count = len(self.filters)
        return Landmarks(
            np.concatenate([part.ids * count + i for i, part in enumerate(parts)]),
            np.concatenate([part.means for part in parts]),
            np.concatenate([part.covariances for part in parts]),
            np.concatenate([part.descriptors for part in parts]),
            np.concatenate([part.counts for part in parts]),
            np.concatenate([part.owners + i for i, part in enumerate(parts)]),
        )

    def add_keyframe(self, vehicle: str, stamp: float) -> int:
        """See FastSlam.add_keyframe; numbers run over all vehicles, with dedicated maps too."""
        self._own_numbers.append(self.filter_of(vehicle).add_keyframe(vehicle, stamp))
        self._keyframes.append(self._filter_of[vehicle])
        return len(self._keyframes) - 1

    def best_path(self) -> Array:
        """See FastSlam.best_path."""
        if len(self.filters) == 1:
            return self.filters[0].best_path()
        path = np.empty((len(self._keyframes), 3))
        owners = np.array(self._keyframes, np.int64)
        for number, item in enumerate(self.filters):
            path[owners == number] = item.best_path()
        return path

    def trajectory(self, vehicle: str) -> tuple[Array, Array]:
        """See FastSlam.trajectory."""
        return self.filter_of(vehicle).trajectory(vehicle)

    # -- tags -----------------------------------------------------------------------------------

    @property
    def uses_tags(self) -> bool:
        """Whether tags can be part of the map: a common one with a joint graph."""
        return len(self.filters) == 1 and self.filters[0].joint is not None

    @property
    def tags(self) -> TagConstraints:
        """Tags in the map; SlamError with dedicated maps."""
        if len(self.filters) > 1:
            raise SlamError('tags need maps: common, this team has maps: dedicated')
        return self.filters[0].tags

    # -- loop closures --------------------------------------------------------------------------

    @property
    def closes_loops(self) -> bool:
        """Whether closures can be recorded."""
        return self.filters[0].joint is not None

    def in_one_map_with(self, vehicle: str) -> list[int]:
        """Return the numbers of the vehicles, in their order, whose frame is that of a vehicle."""
        mine = self.filter_of(vehicle)
        return [
            n
            for n, name in enumerate(self.vehicles)
            if self.filter_of(name) is mine and self.are_in_one_frame(vehicle, name)
        ]

    def are_in_one_frame(self, one: str, other: str) -> bool:
        """See FastSlam.are_in_one_frame; the frames of dedicated maps are the same."""
        return one == other or (self.is_in_map(one) and self.is_in_map(other))

    def is_in_map(self, vehicle: str) -> bool:
        """See FastSlam.is_in_map."""
        return self.filter_of(vehicle).is_in_map(vehicle)

    def graph_keyframes(self) -> int:
        """Return how many keyframes are variables of the joint graphs; 0 without these."""
        graphs = [item.joint.graph for item in self.filters if item.joint is not None]
        return sum(len(graph.live_keyframes()) for graph in graphs)

    def keyframes_of(self, vehicle: str) -> Places:
        """Return the numbers of a vehicle's keyframes, ascending."""
        number = self._filter_of[vehicle]
        own = self.filter_of(vehicle).keyframes_of(vehicle)
        return np.flatnonzero(np.array(self._keyframes, np.int64) == number)[own]

    def stamp_of(self, keyframe: int) -> float:
        """Return the stamp (s) of a keyframe."""
        number, own = self._own(keyframe)
        return self.filters[number].path.stamps[own]

    def keyframes_in_map(self) -> NDArray[np.bool_]:
        """See FastSlam.keyframes_in_map; with dedicated maps, all are."""
        if len(self.filters) == 1:
            return self.filters[0].keyframes_in_map()
        return np.ones(len(self._keyframes), np.bool_)

    def join(self, vehicle: str, frame: Pose2, closures: Sequence[RelativePose]) -> list[int]:
        """See FastSlam.join, which dedicated maps never need."""
        return self.filter_of(vehicle).join(vehicle, frame, closures)

    def pin(self, keyframe: int) -> None:
        """See FastSlam.pin."""
        number, own = self._own(keyframe)
        self.filters[number].pin(own)

    def unpin(self, keyframe: int) -> None:
        """See FastSlam.unpin."""
        number, own = self._own(keyframe)
        self.filters[number].unpin(own)

    def close_loops(self, closures: Sequence[RelativePose]) -> list[int]:
        """See FastSlam.close_loops; all keyframes must be of one map."""
        filters = {self._own(k)[0] for c in closures for k in (c.reference, c.keyframe)}
        if len(filters) != 1:
            raise SlamError(f'closures are of the maps {sorted(filters)}, expected those of one')
        (number,) = filters
        own = [
            closure._replace(
                reference=self._own(closure.reference)[1], keyframe=self._own(closure.keyframe)[1]
            )
            for closure in closures
        ]
        count = len(self.filters)
        return [n * count + number for n in self.filters[number].close_loops(own)]

    def retract_closure(self, number: int) -> None:
        """See FastSlam.retract_closure."""
        factor, owner = divmod(number, len(self.filters))
        self.filters[owner].retract_closure(factor)

    def drop_closure(self, number: int) -> None:
        """See FastSlam.drop_closure."""
        factor, owner = divmod(number, len(self.filters))
        self.filters[owner].drop_closure(factor)

    def closure_distances(self) -> dict[int, float]:
        """See FastSlam.closure_distances."""
        count = len(self.filters)
        return {
            factor * count + owner: distance
            for owner, item in enumerate(self.filters)
            for factor, distance in item.closure_distances().items()
        }

    def relative_covariance(
        self, reference: int, keyframes: Places, *, keep: bool = True
    ) -> Array:
        """See FastSlam.relative_covariance; all keyframes must be of one map."""
        number, own = self._own(reference)
        others = np.array([self._own(keyframe)[1] for keyframe in keyframes.tolist()], np.int64)
        return self.filters[number].relative_covariance(own, others, keep=keep)

    @property
    def redraws(self) -> int:
        """How often paths were drawn, in all filters."""
        return sum(item.redraws for item in self.filters)

    def _own(self, keyframe: int) -> tuple[int, int]:
        """Return the filter of a keyframe, and its number there."""
        if not 0 <= keyframe < len(self._keyframes):
            raise SlamError(f'keyframe is {keyframe}, expected 0 … {len(self._keyframes) - 1}')
        return self._keyframes[keyframe], self._own_numbers[keyframe]

    # -- state ----------------------------------------------------------------------------------

    def state_dict(self) -> State:
        """See Checkpointed."""
        state: State = {
            'keyframes': np.array(self._keyframes, np.int64),
            'filters': np.array(len(self.filters)),
        }
        for number, item in enumerate(self.filters):
            state |= under(f'filter{number}', item.state_dict())
        return state

    @classmethod
    def from_state(cls, state: State) -> Self:
        """See Checkpointed."""
        if 'filters' not in state or 'keyframes' not in state:
            raise SlamError(
                'the saved state of the team is incomplete: filters or keyframes are missing'
            )
        filters = [
            FastSlam.from_state(part(f'filter{number}', state))
            for number in range(int(state['filters']))
        ]
        belief = cls.__new__(cls)
        belief.config = filters[0].config
        belief.filters = filters
        belief.vehicles = tuple(name for item in filters for name in item.vehicles)
        belief._filter_of = {
            name: number for number, item in enumerate(filters) for name in item.vehicles
        }
        belief._keyframes = state['keyframes'].tolist()
        seen = [0] * len(filters)
        belief._own_numbers = []
        for owner in belief._keyframes:
            belief._own_numbers.append(seen[owner])
            seen[owner] += 1
        return belief
