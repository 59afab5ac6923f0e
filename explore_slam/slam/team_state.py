"""What the filter of a team knows: particles, landmark map, paths and joint graph."""

import math
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from explore_slam.errors import SlamError
from explore_slam.geometry import IDENTITY, Array, Pose2
from explore_slam.slam import checks
from explore_slam.slam.checkpoint import State, part, under
from explore_slam.slam.config import FastSlamConfig
from explore_slam.slam.descriptors.kinds import kind_named
from explore_slam.slam.landmarks.landmark_map import LandmarkMap, make_index
from explore_slam.slam.particles.group import Group, Groups
from explore_slam.slam.particles.motion import Segment, calibrated
from explore_slam.slam.particles.path_store import PathStore
from explore_slam.slam.particles.resampling import stratified_normals
from explore_slam.slam.particles.vehicle_states import VehicleStates
from explore_slam.slam.posterior.joint_posterior import JointPosterior
from explore_slam.slam.storage.ancestry import AncestryTree, Index
from explore_slam.slam.update.engines import make_engine
from explore_slam.slam.update.observation_correlation import ObservationCorrelation


class TeamState:
    """The stores of one filter, which its parts share. Vehicles are numbers here.

    unlocalized: vehicles in a frame of their own, because their pose in the map is not known yet.
    stamps: of the last updates. has_motion: whether anything was predicted yet.
    """

    def __init__(
        self, start_poses: Mapping[str, Pose2 | None], config: FastSlamConfig, seed: int
    ) -> None:
        self.config = config
        self.vehicles = tuple(start_poses)
        self.unlocalized = {n for n, pose in enumerate(start_poses.values()) if pose is None}
        if len(self.unlocalized) == len(start_poses):
            self.unlocalized.remove(0)
        self.random = np.random.default_rng(seed)
        self.engine = make_engine(config)
        self._check_unknown_starts()
        starts = [IDENTITY if pose is None else pose for pose in start_poses.values()]
        particles, count = config.particles, len(starts)
        self.has_motion = [False] * count
        self.stamps = [-math.inf] * count
        self.particles = VehicleStates(
            starts, particles, config.linearizable_heading, white_errors=self.engine.redraws
        )
        self.groups = Groups(count, particles, joint=self.engine.joint)
        association = config.association
        kind = kind_named(association.descriptor_kind)
        self.map = LandmarkMap(particles, kind, make_index(association))
        self.path = PathStore(particles)
        self.correlation = ObservationCorrelation(count, config.correlation)
        self.joint = JointPosterior(starts, config) if self.engine.redraws else None
        if self.joint is not None:
            for group in self.groups.all:
                group.samples = [self.joint.first_samples()]
            if config.calibration.odometry_calibration:
                for calibrations in self.particles.calibrations:
                    normals = stratified_normals(self.random, particles, 3)
                    calibrations[:] = normals * config.calibration.deviations()

    def _check_unknown_starts(self) -> None:
        if not self.unlocalized:
            return
        needed = ''
        if not self.engine.redraws:
            needed = 'the setting joint_graph and engine fastslam2'
        elif self.config.insertion_policy == 'unmapped_region':
            needed = 'an insertion_policy that does not divide the map between vehicles'
        if needed:
            names = [self.vehicles[number] for number in sorted(self.unlocalized)]
            raise SlamError(f'the start poses of {names} are unknown, which needs {needed}')

    def required_joint(self) -> JointPosterior:
        """Return the joint posterior; SlamError if the filter has none."""
        if self.joint is None:
            raise SlamError(
                'redraws and closures need the setting joint_graph and engine fastslam2'
            )
        return self.joint

    def estimate(self, number: int) -> tuple[Pose2, Array]:
        """Return mean and covariance (3, 3) of a pose in the map, predicted motion included."""
        return self.particles.estimate(number, self.groups.of(number).weights())

    def calibration(self, number: int) -> tuple[Array, Array]:
        """Return mean (3,) and covariance (3, 3) of a vehicle's odometry calibration."""
        return self.particles.calibration(number, self.groups.of(number).weights())

    def step_of(self, number: int, increment: Pose2, covariance: Array | None) -> Segment:
        """Return an increment as a motion, corrected by the calibration if it is of wheels.

        covariance (3, 3); None: that of wheel odometry.
        """
        if covariance is not None:
            noise = checks.check_motion_covariance('covariance', covariance)
            return Segment.empty()._replace(mean=increment, covariance=noise)
        noise = self.config.odometry_noise.covariance(increment)
        if self.joint is None or not self.config.calibration.odometry_calibration:
            return Segment.empty()._replace(mean=increment, covariance=noise)
        calibration = self.joint.calibrations[number]
        corrected, sensitivity = calibrated(increment, calibration)
        return Segment(corrected, noise, sensitivity, sensitivity @ calibration)

    def motion(
        self, number: int, steps: Iterable[tuple[Pose2, Array | None]]
    ) -> tuple[Pose2, Array]:
        """Return mean and covariance (3, 3) of a motion, in the frame of the vehicle before it."""
        total = Segment.empty()
        for increment, noise in steps:
            total = total.extended(self.step_of(number, increment, noise))
        mean, spread = self.calibration(number)
        covariance = total.covariance + total.sensitivity @ spread @ total.sensitivity.T
        return Pose2.from_array(total.moves(mean[None])[0]), covariance

    def resample(self, group: Group, weights: Array | None = None) -> Index:
        """Resample a group by its or other normalized weights (M,); return the ancestors (M,)."""
        chosen = group.weights() if weights is None else weights
        return self.particles.resample(group, chosen, self.random)

    def best_particle(self, number: int) -> int:
        """Return the particle that is taken as the estimate of a vehicle."""
        return self.engine.best_particle(self.groups.of(number))

    def best_particles(self) -> dict[AncestryTree, int]:
        """Return the best particle of the group that each ancestry tree belongs to."""
        return {
            tree: self.engine.best_particle(group)
            for group in self.groups.all
            for tree in group.trees
        }

    def best_pose(self, number: int) -> Pose2:
        """Return the mean of samples of the joint posterior, else the best particle's pose."""
        if self.joint is not None:
            return self.estimate(number)[0]
        return Pose2.from_array(self.particles.predicted(number)[self.best_particle(number)])

    def hidden_landmarks(self, number: int) -> NDArray[np.bool_] | None:
        """Return which entries of the map lie in other frames than a vehicle; None: no entry."""
        if not self.unlocalized:
            return None
        owners = self.map.owners[: self.map.size]
        hidden: NDArray[np.bool_] = (
            owners != number
            if number in self.unlocalized
            else np.isin(owners, list(self.unlocalized))
        )
        return hidden

    def state_dict(self) -> State:
        """Return everything but configuration and vehicles."""
        stores = [self.map.rows, self.path.rows]
        state: State = {
            'predicted': np.array(self.has_motion),
            'stamps': np.array(self.stamps),
            **self.particles.state_dict(),
            **under('map', self.map.state_dict()),
            **under('path', self.path.state_dict()),
            **under('groups', self.groups.state_dict(stores)),
            **under('engine', self.engine.state_dict()),
            **under('correlation', self.correlation.state_dict()),
        }
        if self.joint is not None:
            state |= under('joint', self.joint.state_dict())
        return state

    def restore(self, state: State) -> None:
        """Restore what `state_dict` returned, for the same vehicles and settings."""
        self.has_motion = state['predicted'].tolist()
        self.stamps = state['stamps'].tolist()
        self.particles.restore(state)
        self.map.restore(part('map', state))
        self.path.restore(part('path', state))
        self.groups.restore(part('groups', state), [self.map.rows, self.path.rows])
        self.engine.restore(part('engine', state))
        self.correlation.restore(part('correlation', state))
        if self.joint is not None:
            self.joint.restore(part('joint', state))
