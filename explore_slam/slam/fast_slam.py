"""The filter of one team: FastSLAM over the poses of all vehicles and one landmark map."""

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Self

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import InterRobotObservation, LandmarkObservations
from explore_slam.errors import SlamError
from explore_slam.geometry import Array, Pose2, compose, wrap_angles
from explore_slam.settings import values_of, with_values
from explore_slam.slam import checks
from explore_slam.slam.association.candidates import find_candidates
from explore_slam.slam.association.state import MAJORITY, AssociationState, CandidateSet
from explore_slam.slam.checkpoint import Checkpointed, State, part, text_array, text_value, under
from explore_slam.slam.config import FastSlamConfig
from explore_slam.slam.descriptors.kinds import kind_named
from explore_slam.slam.landmarks.landmark_map import LandmarkMap, Landmarks, make_index
from explore_slam.slam.particles.group import Group, Groups
from explore_slam.slam.particles.motion import PendingMotion, rotated
from explore_slam.slam.particles.path_store import PathStore
from explore_slam.slam.particles.resampling import (
    mean_and_covariance,
    stratified_normals,
    systematic_ancestors,
)
from explore_slam.slam.relocalization import Relocalizer
from explore_slam.slam.storage.ancestry import AncestryTree, Index
from explore_slam.slam.summary import UpdateSummary
from explore_slam.slam.update.engine import PoseProposal
from explore_slam.slam.update.engines import make_engine
from explore_slam.slam.update.fastslam2_engine import pair_likelihoods
from explore_slam.slam.update.inter_robot import condition_on_observation
from explore_slam.slam.update.landmark_update import update_associated
from explore_slam.slam.update.map_management import MapManager


class FastSlam(Checkpointed):
    """One Rao-Blackwellized particle filter for several vehicles (paper, sections III and IV).

    Each particle holds the poses of all vehicles and one landmark map. Vehicles whose maps do not
    overlap yet are filtered in separate groups; groups merge when one of their vehicles observes a
    landmark of the other. Results depend only on the inputs and the seed.
    A call that raises SlamError leaves the filter unchanged.
    """

    def __init__(
        self, start_poses: Mapping[str, Pose2], config: FastSlamConfig | None = None, seed: int = 0
    ) -> None:
        if not start_poses:
            raise SlamError('start_poses is empty, expected one vehicle or more')
        self.config = config if config is not None else FastSlamConfig()
        starts = [
            checks.check_pose(f'start pose of {name!r}', pose)
            for name, pose in start_poses.items()
        ]
        self.vehicles = tuple(start_poses)
        particles, association = self.config.particles, self.config.association
        self._numbers = {name: number for number, name in enumerate(self.vehicles)}
        self._poses = np.repeat(np.array(starts, np.float64)[:, None, :], particles, axis=1)
        self._pending = [PendingMotion() for _ in starts]
        self._predicted = [False] * len(starts)
        self._stamps = [-math.inf] * len(starts)
        self._random = np.random.default_rng(seed)
        self._engine = make_engine(self.config)
        self.groups = Groups(len(starts), particles, joint=self._engine.joint)
        kind = kind_named(association.descriptor_kind)
        self.map = LandmarkMap(particles, kind, make_index(association))
        self.path = PathStore(particles)
        self._manager = MapManager(self.map, self._engine, self.config)
        self._relocalizers = [Relocalizer(self.config.relocalization) for _ in starts]

    # -- motion ---------------------------------------------------------------------------------

    def predict(self, vehicle: str, increment: Pose2, covariance: Array | None = None) -> None:
        """Propagate a vehicle by an odometry increment.

        Increments accumulate and are applied at the next update, so that calls are cheap.

        increment: motion since the last call, in the vehicle frame (m, m, rad).
        covariance: (3, 3) of the increment (m², rad²). Default: the configured odometry noise.
        Zero: exact.
        """
        number = self._number(vehicle)
        step = checks.check_pose('increment', increment)
        if covariance is None:
            noise = self.config.odometry_noise.covariance(step)
        else:
            noise = checks.check_motion_covariance('covariance', covariance)
        self._pending[number].append(step, noise, self.config.linearizable_heading)
        self._relocalizers[number].predict(step)
        self._predicted[number] = True

    def set_pose(self, vehicle: str, pose: Pose2, covariance: Array) -> None:
        """Give a vehicle a known pose; covariance (3, 3) in the map frame (m², rad²)."""
        number = self._number(vehicle)
        known = checks.check_pose('pose', pose)
        spread = checks.check_motion_covariance('covariance', covariance)
        self._poses[number] = np.asarray(known)
        self._pending[number] = PendingMotion.of(rotated(spread, known.theta))
        self._relocalizers[number].reset()
        self._predicted[number] = True

    def restart_clock(self, vehicle: str) -> None:
        """Reset the vehicle's clock: its next update may have any stamp."""
        self._stamps[self._number(vehicle)] = -np.inf

    # -- update ---------------------------------------------------------------------------------

    def update(self, vehicle: str, observations: LandmarkObservations) -> UpdateSummary:
        """Update with landmark observations of a vehicle at its current pose.

        The numbers of the steps are those of the paper's algorithm. Engine paper samples poses
        (2.1) before the association and resamples (5) at the end, once all vehicles have updated;
        engine fastslam2 resamples and samples after it, from the proposal given the observations.

        Raises SlamError for no or too many observations, covariances that are not positive
        definite, descriptors of another kind, an unknown vehicle, a stamp before the last one, and
        an update before the first predict.
        """
        number = self._number(vehicle)
        self._check(number, observations)
        if self._engine.starts_new_round(number):
            self._end_round()

        # 2.2 candidate landmarks: similar descriptor, near where the observation is expected
        estimate, reach = self.estimate(vehicle), self._relocalizers[number].reach
        found = find_candidates(self.map, observations, self.config.association, *estimate, reach)
        with self._rejecting(f'update({vehicle!r}) at stamp {observations.stamp}'):
            poses, P = self._propagate(number)
            poses = self._merge_groups(number, found, poses, P)
            group = self.groups.of(number)
            state = AssociationState(found, self.map.rows, group.tree)
            # 2.1 sample (paper), 2.4 gate, 2.5 descriptor; Gaussian proposal of the pose
            # (fastslam2)
            normals = stratified_normals(self._random, self.config.particles, 3)
            proposal = self._propose(state, poses, P, normals, group.log_weights)
        self._stamps[number] = observations.stamp
        # 2.6.2 importance weight
        group.reweight(proposal.log_likelihoods)
        effective, support = group.effective_particles(), state.support(group.weights())
        # 5 resample (fastslam2)
        resampled = self._resample_before_sampling(group, state, proposal)
        # 2.1 sample (fastslam2)
        poses = proposal.sample(normals)
        self._place(number, poses)
        # 2.6.1 update the associated landmarks
        update_associated(state, poses, self.config.filter_threads)
        # 4 best particle
        best = self.best_particle(vehicle)
        matches = state.ids_in(best, self.map.ids)
        # 2.7.1 insert new landmarks; remove those that are not there
        inserted, removed = self._manager.commit(number, state, poses, support, best)
        # 5 resample (paper)
        if self._engine.completes_round(number, self.vehicles):
            self._end_round()
            resampled = True
        agreed = support.sum(axis=1) > MAJORITY
        lost, relocated = self._relocalize(number, found, agreed)
        return UpdateSummary(
            stamp=observations.stamp,
            vehicle=vehicle,
            observed=len(observations),
            matched=int(np.count_nonzero(found.has_similar())),
            associated=int(np.count_nonzero(matches >= 0)),
            inserted=inserted,
            removed=removed,
            effective_particles=effective,
            resampled=resampled,
            lost=lost,
            relocated=relocated,
            matches=matches,
            together=tuple(self.vehicles[member] for member in group.vehicles),
        )

    def _check(self, number: int, observations: LandmarkObservations) -> None:
        most = self.config.association.maximum_observations
        checks.check_observations(observations, self.map.kind, most)
        checks.check_order(
            self.vehicles[number],
            observations.stamp,
            self._stamps[number],
            predicted=self._predicted[number],
        )

    def _propagate(self, number: int) -> tuple[Array, Array]:
        """Return the predicted poses (M, 3) and their covariance (3, 3) in the vehicle frame."""
        return self._pending[number].propagate(
            self._poses[number].copy(), self.config.linearizable_heading, self._random
        )

    def _merge_groups(self, number: int, found: CandidateSet, poses: Array, P: Array) -> Array:
        """Merge this vehicle's group with those whose landmarks it may observe from poses (M, 3).

        Returns the predicted poses of the particles of the merged group.
        """
        group, trees = self.groups.of(number), self.map.rows.trees_of(found.entries)
        others = [other for other in self.groups.with_trees(set(trees)) if other is not group]
        if not others:
            return poses
        blocks = self.map.rows.read(found.entries)
        theirs = [np.array([tree in other.trees for tree in trees]) for other in others]

        def likelihood(orders: Sequence[Index]) -> Array:
            return pair_likelihoods(found, blocks, theirs, orders, poses, P, self.config)

        return poses[self.groups.merge(group, others, likelihood, self._poses, self._random)]

    def _propose(
        self, state: AssociationState, poses: Array, P: Array, normals: Array, log_weights: Array
    ) -> PoseProposal:
        """Return the proposal of the engine; nothing is staged if its numbers overflow."""
        proposal = self._engine.propose(state, poses, P, normals, log_weights)
        if not proposal.is_finite():
            state.discard()
        return proposal.checked()

    def _resample_before_sampling(
        self, group: Group, state: AssociationState, proposal: PoseProposal
    ) -> bool:
        """Resample when the effective sample size is low; return whether that was so.

        This happens before the poses are sampled from the proposal, so that copies of one particle
        get different poses (auxiliary particle filter; Pitt and Shephard, 1999).
        """
        if not self._engine.resamples_before_sampling(group):
            return False
        state.discard()
        ancestors = self._resample(group, group.weights())
        state.follow(ancestors)
        proposal.follow(ancestors)
        return True

    def _place(self, number: int, poses: Array) -> None:
        """Set the poses (M, 3) of a vehicle, which include all of its motion."""
        poses[:, 2] = wrap_angles(poses[:, 2])
        self._poses[number] = poses
        self._pending[number] = PendingMotion()

    def _relocalize(
        self, number: int, found: CandidateSet, agreed: NDArray[np.bool_]
    ) -> tuple[bool, bool]:
        """Note what was matched; return whether the vehicle is lost, and whether it was found."""
        relocalizer, R = self._relocalizers[number], found.observed.R
        deviations = np.sqrt(0.5 * (R[:, 0] + R[:, 3]))
        similar = np.where(found.is_distinctive[:, None], found.similar_ids, -1)
        relocalizer.add(found.observed.z, deviations, similar, agreed)
        wanted = self.config.relocalization.relocalization and self._engine.relocalizes
        if not wanted or not relocalizer.is_lost:
            return relocalizer.is_lost, False
        positions = self.map.positions(relocalizer.similar_ids(), self._best_particles())
        current = self.best_pose(self.vehicles[number])
        pose = relocalizer.search(positions, current, self._random)
        if pose is None:
            return True, False
        spread = np.array([pose.position_deviation] * 2 + [pose.heading_deviation])
        self.set_pose(self.vehicles[number], pose.pose, np.diag(spread**2))
        return True, True

    # -- inter-robot observations ---------------------------------------------------------------

    def update_inter_robot(
        self, vehicle: str, observations: Sequence[InterRobotObservation]
    ) -> None:
        """Update with the positions at which a vehicle measured others of the team.

        The motion of all of them must have been predicted up to now. Without effect if the setting
        inter_robot_observations is off.
        """
        number = self._number(vehicle)
        targets = [self._number(observation.vehicle) for observation in observations]
        for observation in observations:
            checks.check_inter_robot(vehicle, observation)
        if not self.config.inter_robot_observations:
            return
        for target, observation in zip(targets, observations, strict=True):
            what = f'observation of {observation.vehicle!r} at stamp {observation.stamp}'
            with self._rejecting(what):
                self._update_inter_robot(number, target, observation)

    def _update_inter_robot(
        self, number: int, target: int, observation: InterRobotObservation
    ) -> None:
        motion, zeros = self._pending[target], np.zeros((self.config.particles, 3))
        poses, P = self._propagate(number)
        target_poses = compose(self._poses[target], np.asarray(motion.mean))

        def condition(poses: Array, theirs: Array, normals: Array) -> tuple[Array, Array]:
            weights = self.groups.of(number).weights()
            return condition_on_observation(
                (poses, P), (theirs, motion.end_covariance()), observation, self.config, normals,
                weights,
            )  # fmt: skip

        def likelihood(orders: Sequence[Index]) -> Array:
            return condition(poses.copy(), target_poses[orders[0]], zeros)[0]

        group, other = self.groups.of(number), self.groups.of(target)
        if other is not group:
            poses = poses[self.groups.merge(group, [other], likelihood, self._poses, self._random)]
            target_poses = compose(self._poses[target], np.asarray(motion.mean))
            group = self.groups.of(number)
        normals = stratified_normals(self._random, self.config.particles, 3)
        log_likelihoods, remaining = condition(poses, target_poses, normals)
        group.reweight(log_likelihoods)
        self._place(number, poses)
        self._place(target, target_poses)
        self._pending[target] = PendingMotion.of(remaining)
        if self._engine.resamples_before_sampling(group):
            self._resample(group, group.weights())

    @contextmanager
    def _rejecting(self, what: str) -> Iterator[None]:
        """Turn an overflow into a SlamError, and restore the random generator."""
        random = self._random.bit_generator.state
        try:
            yield
        except FloatingPointError as error:
            self._random.bit_generator.state = random
            raise SlamError(
                f'{what}: numbers overflow; the covariances of motion and observations differ by '
                'too many orders of magnitude'
            ) from error

    # -- resampling -----------------------------------------------------------------------------

    def _end_round(self) -> None:
        """Engine paper: resample, because all vehicles have weighted the particles (Eq. 7)."""
        (group,) = self.groups.all
        self._engine.end_round(group)
        self._resample(group, group.weights())

    def resample_now(self, weights: Array | None = None) -> None:
        """Resample all groups by their weights, or by given normalized weights (M,)."""
        for group in self.groups.all:
            self._resample(group, group.weights() if weights is None else weights)

    def _resample(self, group: Group, weights: Array) -> Index:
        ancestors = systematic_ancestors(weights, float(self._random.random()))
        self._poses[group.vehicles] = self._poses[group.vehicles][:, ancestors]
        group.resample(ancestors)
        return ancestors

    # -- estimates ------------------------------------------------------------------------------

    def best_particle(self, vehicle: str | None = None) -> int:
        """Return the particle that is taken as the estimate, of a vehicle (else of the first).

        Engine paper: the one of largest weight (step 4). Engine fastslam2: the one with the most
        likely lineage, so that the best path seldom jumps.
        """
        return self._engine.best_particle(self._group(vehicle))

    def _best_particles(self) -> dict[AncestryTree, int]:
        """Return the best particle of the group that each ancestry tree belongs to."""
        return {
            tree: self._engine.best_particle(group)
            for group in self.groups.all
            for tree in group.trees
        }

    def estimate(self, vehicle: str) -> tuple[Pose2, Array]:
        """Return mean and covariance (3, 3) of a pose in the map, predicted motion included."""
        number = self._number(vehicle)
        pending = self._pending[number]
        poses = compose(self._poses[number], np.asarray(pending.mean))
        weights = self.groups.of(number).weights()
        mean, spread = mean_and_covariance(poses, weights)
        spread += rotated(pending.end_covariance(), -mean.theta)
        return mean, 0.5 * (spread + spread.T)

    def best_pose(self, vehicle: str) -> Pose2:
        """Return the pose of a vehicle in the best particle, predicted motion included."""
        number = self._number(vehicle)
        pose = Pose2.from_array(self._poses[number, self.best_particle(vehicle)])
        return pose.compose(self._pending[number].mean)

    def particle_poses(self, vehicle: str) -> Array:
        """Return the poses (M, 3) of a vehicle in all particles, predicted motion included."""
        number = self._number(vehicle)
        return compose(self._poses[number], np.asarray(self._pending[number].mean))

    def weights(self, vehicle: str | None = None) -> Array:
        """Return the normalized weights (M,) of the particles of a vehicle (else of the first)."""
        return self._group(vehicle).weights()

    def effective_particles(self) -> float:
        """Return the effective sample size, 1 to M: the least of all groups of vehicles."""
        return min(group.effective_particles() for group in self.groups.all)

    def landmarks(self) -> Landmarks:
        """Return the landmarks of the best particle."""
        return self.map.of_particle(self._best_particles())

    # -- path -----------------------------------------------------------------------------------

    def add_keyframe(self, vehicle: str, stamp: float) -> int:
        """Append the current pose of a vehicle, in all particles, to the path.

        Returns its number, counted 0, 1, 2 … over all vehicles.
        """
        number = self._number(vehicle)
        if not math.isfinite(stamp):
            raise SlamError(f'add_keyframe({vehicle!r}): stamp is {stamp}, expected seconds')
        tree = self.groups.of(number).tree
        return self.path.append(number, stamp, self.particle_poses(vehicle), tree)

    def best_path(self) -> Array:
        """Return the poses (K, 3) of all keyframes along the lineage of the best particle.

        As long as the lineage continues, earlier poses are the same bit by bit at every call.
        """
        return self.path.of_particle(self._best_particles())

    def trajectory(self, vehicle: str) -> tuple[Array, Array]:
        """Return stamps (T,) and poses (T, 3) of the keyframes of a vehicle, best lineage."""
        chosen = self.path.of_vehicle(self._number(vehicle))
        return np.array(self.path.stamps)[chosen], self.best_path()[chosen]

    # -- state ----------------------------------------------------------------------------------

    def state_dict(self) -> State:
        """See Checkpointed."""
        about = {
            'settings': values_of(self.config),
            'vehicles': list(self.vehicles),
            'random': self._random.bit_generator.state,
        }
        stores = [self.map.rows, self.path.rows]
        state: State = {
            'about': text_array(about),
            'poses': self._poses,
            'predicted': np.array(self._predicted),
            'stamps': np.array(self._stamps),
            **under('map', self.map.state_dict()),
            **under('path', self.path.state_dict()),
            **under('groups', self.groups.state_dict(stores)),
            **under('engine', self._engine.state_dict()),
            **under('manager', self._manager.state_dict()),
        }
        for number, pending in enumerate(self._pending):
            state |= under(f'motion{number}', pending.state_dict())
        for number, relocalizer in enumerate(self._relocalizers):
            state |= under(f'relocalizer{number}', relocalizer.state_dict())
        return {name: np.array(value) for name, value in state.items()}

    @classmethod
    def from_state(cls, state: State) -> Self:
        """See Checkpointed."""
        try:
            about = text_value(state['about'])
            starts = dict.fromkeys(about['vehicles'], Pose2(0.0, 0.0, 0.0))
            slam = cls(starts, with_values(FastSlamConfig(), about['settings']))
            slam._restore(about['random'], state)
        except (KeyError, ValueError, IndexError, TypeError) as error:
            raise SlamError(f'the saved state of the filter is incomplete: {error!r}') from error
        return slam

    def _restore(self, random: dict[str, object], state: State) -> None:
        self._random.bit_generator.state = random
        self._poses = state['poses'].copy()
        self._predicted = state['predicted'].tolist()
        self._stamps = state['stamps'].tolist()
        self.map.restore(part('map', state))
        self.path.restore(part('path', state))
        self.groups.restore(part('groups', state), [self.map.rows, self.path.rows])
        self._engine.restore(part('engine', state))
        self._manager.restore(part('manager', state))
        for number, pending in enumerate(self._pending):
            pending.restore(part(f'motion{number}', state))
        for number, relocalizer in enumerate(self._relocalizers):
            relocalizer.restore(part(f'relocalizer{number}', state))

    def _group(self, vehicle: str | None) -> Group:
        return self.groups.of(0 if vehicle is None else self._number(vehicle))

    def _number(self, vehicle: str) -> int:
        try:
            return self._numbers[vehicle]
        except (KeyError, TypeError):
            raise SlamError(
                f'there is no vehicle {vehicle!r}, expected one of {list(self.vehicles)}'
            ) from None
