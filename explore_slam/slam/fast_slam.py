"""The belief of one team: a joint particle filter over all vehicles and one landmark map."""

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Self

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import InterRobotObservation, LandmarkObservations
from explore_slam.errors import SlamError
from explore_slam.geometry import Array, Pose2, compose, wrap_angles
from explore_slam.slam import belief_state, checkpoint, checks
from explore_slam.slam.association.candidates import Sighted, look_up
from explore_slam.slam.config import FastSlamConfig
from explore_slam.slam.landmarks.landmark_map import LandmarkMap, Landmarks, make_index
from explore_slam.slam.particles.group import Group, Groups
from explore_slam.slam.particles.motion import PendingMotion, rotated
from explore_slam.slam.particles.path_store import PathStore
from explore_slam.slam.particles.resampling import (
    mean_and_covariance,
    stratified_normals,
    systematic_ancestors,
)
from explore_slam.slam.relocalization import Recovery
from explore_slam.slam.storage.ancestry import Genealogy, Index
from explore_slam.slam.summary import UpdateSummary
from explore_slam.slam.update import engines
from explore_slam.slam.update.engines import Proposal
from explore_slam.slam.update.inter_robot import sight
from explore_slam.slam.update.map_management import MapKeeper, support


class FastSlam(checkpoint.Checkpointed):
    """One joint Rao-Blackwellized particle filter for several vehicles (sections III and IV).

    Every particle holds a pose of every vehicle and one landmark map; vehicles that have nothing
    in common yet have particles apart from each other (`group`). Motion is told with `predict`,
    what is seen with `update`; all randomness comes from the seed.
    A call that is refused (SlamError) leaves the state as it was.
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
        particles = self.config.particles
        self._numbers = {name: number for number, name in enumerate(self.vehicles)}
        self._poses = np.repeat(np.array(starts, np.float64)[:, None, :], particles, axis=1)
        self._pending = [PendingMotion() for _ in starts]
        self._moved = [False] * len(starts)
        self._stamps = [-math.inf] * len(starts)
        self._random = np.random.default_rng(seed)
        self.groups = Groups(len(starts), particles, joint=self.config.engine == 'paper')
        self._contributed: set[int] = set()
        self.map = LandmarkMap(particles, make_index(self.config.association))
        self.path = PathStore(particles)
        self._keeper = MapKeeper(self.map, self.config)
        self._recovery = [Recovery(self.config.relocalization) for _ in starts]

    # -- motion ---------------------------------------------------------------------------------

    def predict(self, vehicle: str, increment: Pose2, covariance: Array | None = None) -> None:
        """Tell a motion of a vehicle: increment in its own frame, covariance (3, 3) of it there.

        Without covariance the noise of the settings is taken. Motions are compounded and cost
        next to nothing until the next update; zero covariance means exact.
        """
        number = self._number(vehicle)
        step = checks.check_pose('increment', increment)
        if covariance is None:
            noise = self.config.odometry_noise.covariance(step)
        else:
            noise = checks.check_motion_covariance('covariance', covariance)
        self._pending[number].append(step, noise, self.config.linearizable_heading)
        self._recovery[number].move(step)
        self._moved[number] = True

    def set_pose(self, vehicle: str, pose: Pose2, covariance: Array) -> None:
        """Move a vehicle to a pose given by the user, covariance (3, 3) in the map frame."""
        number = self._number(vehicle)
        place = checks.check_pose('pose', pose)
        spread = checks.check_motion_covariance('covariance', covariance)
        self._poses[number] = np.asarray(place)
        self._pending[number] = PendingMotion.of(rotated(spread, place.theta))
        self._recovery[number].forget()
        self._moved[number] = True

    def restart_clock(self, vehicle: str) -> None:
        """Take stamps before the last one from now on: the clock of the vehicle jumped back."""
        self._stamps[self._number(vehicle)] = -np.inf

    # -- observation ----------------------------------------------------------------------------

    def update(self, vehicle: str, observations: LandmarkObservations) -> UpdateSummary:
        """Take in what a vehicle sees at present; the first update needs a predict before it.

        Raises SlamError, without any change, for no or too many observations, covariances that
        are not positive definite, descriptors that are not of unit length, an unknown vehicle,
        a stamp before the last one, and an update before the first predict.
        """
        number = self._number(vehicle)
        checks.check_observations(observations, self.config.association.maximum_observations)
        last = self._stamps[number]
        checks.check_turn(vehicle, observations.stamp, last, moved=self._moved[number])
        if self.config.engine == 'paper' and number in self._contributed:
            self._resample_round()
        estimate, reach = self.estimate(vehicle), self._recovery[number].reach
        sighted = look_up(self.map, observations, self.config.association, *estimate, reach)
        with self._refusing(f'update({vehicle!r}) at stamp {observations.stamp}'):
            poses, P = self._settled(number)
            poses = self._meet(number, sighted, poses, P)
            group = self.groups.of(number)
            sighted.stage(self.map.rows, group.home)
            normals = stratified_normals(self._random, self.config.particles, 3)
            proposal = engines.propose_poses(
                sighted, self.map.rows, poses, P, normals, group.log_weights, self.config
            )
        self._stamps[number] = observations.stamp
        group.weigh(proposal.log_weights)
        effective = group.effective()
        support_of = support(sighted.choice, group.weights(), sighted.candidates.shape[1])
        resampled = self._follow_the_fit(group, sighted, proposal)
        poses = proposal.sampled(normals)
        self._place(number, poses)
        engines.update_matched(
            sighted, self.map.rows.present_data, poses, self.config.filter_threads
        )
        best = self.best_particle(vehicle)
        matches = sighted.matches(best, self.map.ids)
        inserted, removed = self._keeper.write(number, sighted, poses, support_of, best)
        if self.config.engine == 'paper':
            resampled = self._end_round(number)
        lost, relocated = self._recover(number, sighted, support_of.sum(axis=1) > 0.5)
        return UpdateSummary(
            stamp=observations.stamp,
            vehicle=vehicle,
            observed=len(observations),
            matched=int(np.count_nonzero((sighted.alike >= 0).any(axis=1))),
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

    def _meet(self, number: int, sighted: Sighted, poses: Array, P: Array) -> Array:
        """Join the groups whose landmarks a vehicle at predicted poses (M, 3) may see.

        Returns the predicted poses of the new group's particles.
        """
        group, homes = self.groups.of(number), self.map.rows.homes(sighted.items)
        others = [other for other in self.groups.on(set(homes)) if other is not group]
        if not others:
            return poses
        rows = self.map.rows.read(sighted.items)
        theirs = [np.array([home in other.genealogies for home in homes]) for other in others]

        def likelihood(orders: Sequence[Index]) -> Array:
            paired = engines.paired(sighted, rows, theirs, orders, poses, P, self.config)
            return paired.log_weights

        return poses[self.groups.join(group, others, likelihood, self._poses, self._random)]

    def _follow_the_fit(self, group: Group, sighted: Sighted, proposal: Proposal) -> bool:
        """Resample if it is due, before poses are sampled: descendants then differ at once."""
        if self.config.engine == 'paper' or not self._is_due(group):
            return False
        sighted.revert(self.map.rows)
        ancestors = self._resample(group, group.weights())
        sighted.follow(ancestors, self.map.rows)
        proposal.follow(ancestors)
        return True

    def update_inter_robot(self, vehicle: str, sightings: Sequence[InterRobotObservation]) -> None:
        """Take in where a vehicle sees other vehicles of the team, whose motion is told up to now.

        Without effect where the setting inter_robot_observations is off.
        """
        number = self._number(vehicle)
        others = [self._number(sighting.vehicle) for sighting in sightings]
        for sighting in sightings:
            checks.check_sighting(vehicle, sighting)
        if not self.config.inter_robot_observations:
            return
        for other, sighting in zip(others, sightings, strict=True):
            with self._refusing(f'sighting of {sighting.vehicle!r} at stamp {sighting.stamp}'):
                self._sight(number, other, sighting)

    def _sight(self, number: int, other: int, sighting: InterRobotObservation) -> None:
        motion, still = self._pending[other], np.zeros((self.config.particles, 3))
        seer, seer_P = self._settled(number)
        seen = compose(self._poses[other], np.asarray(motion.mean))

        def taken_in(seer: Array, seen: Array, normals: Array) -> tuple[Array, Array]:
            return sight(
                seer, seer_P, seen, motion.end_covariance(), sighting, self.config, normals,
                self.groups.of(number).weights(),
            )  # fmt: skip

        def likelihood(orders: Sequence[Index]) -> Array:
            return taken_in(seer.copy(), seen[orders[0]], still)[0]

        group, theirs = self.groups.of(number), self.groups.of(other)
        if theirs is not group:
            seer = seer[self.groups.join(group, [theirs], likelihood, self._poses, self._random)]
            seen = compose(self._poses[other], np.asarray(motion.mean))
            group = self.groups.of(number)
        normals = stratified_normals(self._random, self.config.particles, 3)
        log_weights, left = taken_in(seer, seen, normals)
        group.weigh(log_weights)
        self._place(number, seer)
        self._place(other, seen)
        self._pending[other] = PendingMotion.of(left)
        if self.config.engine == 'fastslam2' and self._is_due(group):
            self._resample(group, group.weights())

    @contextmanager
    def _refusing(self, what: str) -> Iterator[None]:
        """Refuse a call whose numbers run out of range, and take its random numbers back."""
        random = self._random.bit_generator.state
        try:
            yield
        except FloatingPointError as error:
            self._random.bit_generator.state = random
            raise SlamError(
                f'{what}: covariances of motion and observations are out of proportion'
            ) from error

    def _settled(self, number: int) -> tuple[Array, Array]:
        """Return predicted poses (M, 3) and their covariance (3, 3) in the vehicle frame."""
        return self._pending[number].move(
            self._poses[number].copy(), self.config.linearizable_heading, self._random
        )

    def _place(self, number: int, poses: Array) -> None:
        """Set the poses (M, 3) of a vehicle; its motion so far is in them."""
        poses[:, 2] = wrap_angles(poses[:, 2])
        self._poses[number] = poses
        self._pending[number] = PendingMotion()

    def _recover(
        self, number: int, sighted: Sighted, agreed: NDArray[np.bool_]
    ) -> tuple[bool, bool]:
        """Note what was matched; relocate the vehicle if it is lost and can be found."""
        recovery = self._recovery[number]
        deviations = np.sqrt(0.5 * (sighted.R[:, 0] + sighted.R[:, 3]))
        alike = np.where(sighted.telling[:, None], sighted.alike, -1)
        recovery.note(sighted.z, deviations, alike, agreed)
        wanted = self.config.relocalization.relocalization and self.config.engine == 'fastslam2'
        if not wanted or not recovery.lost:
            return recovery.lost, False
        positions = self.map.places(recovery.matched_ids(), self._best_particles())
        found = recovery.search(positions, self.best_pose(self.vehicles[number]), self._random)
        if found is None:
            return True, False
        spread = np.array([found.position_deviation] * 2 + [found.heading_deviation])
        self.set_pose(self.vehicles[number], found.pose, np.diag(spread**2))
        return True, True

    # -- resampling -----------------------------------------------------------------------------

    def _is_due(self, group: Group) -> bool:
        return group.effective() < self.config.resampling_threshold * self.config.particles

    def _end_round(self, number: int) -> bool:
        """Engine paper: resample when all vehicles have weighed the particles."""
        self._contributed.add(number)
        if len(self._contributed) < len(self.vehicles):
            return False
        self._resample_round()
        return True

    def _resample_round(self) -> None:
        """Engine paper: all vehicles have weighed the particles, w = Π w(i) (Eq. 7)."""
        self._contributed.clear()
        (group,) = self.groups.all
        group.score = np.zeros(self.config.particles)
        group.score[int(np.argmax(group.log_weights))] = 1.0
        self._resample(group, group.weights())

    def resample_now(self, weights: Array | None = None) -> None:
        """Resample by the present weights, or by given normalized weights (M,)."""
        for group in self.groups.all:
            self._resample(group, group.weights() if weights is None else weights)

    def _resample(self, group: Group, weights: Array) -> Index:
        ancestors = systematic_ancestors(weights, float(self._random.random()))
        self._poses[group.vehicles] = self._poses[group.vehicles][:, ancestors]
        group.descend(ancestors)
        return ancestors

    # -- estimates ------------------------------------------------------------------------------

    def best_particle(self, vehicle: str | None = None) -> int:
        """Return the particle that is taken for the truth, for a vehicle (else for the first).

        Engine paper: the one of largest weight. Engine fastslam2: the one whose whole lineage
        is likeliest, so that the best path does not jump without need.
        """
        group = self._group(vehicle)
        if self.config.engine == 'paper' and self._contributed:
            return int(np.argmax(group.log_weights))
        return group.best()

    def _best_particles(self) -> dict[Genealogy, int]:
        if self.config.engine == 'paper':
            return dict.fromkeys(self.groups.all[0].genealogies, self.best_particle())
        return self.groups.best_particles()

    def estimate(self, vehicle: str) -> tuple[Pose2, Array]:
        """Return mean and covariance (3, 3) of a pose in the map, motion told so far included."""
        number = self._number(vehicle)
        pending = self._pending[number]
        poses = compose(self._poses[number], np.asarray(pending.mean))
        weights = self.groups.of(number).weights()
        mean, spread = mean_and_covariance(poses, weights)
        spread += rotated(pending.end_covariance(), -mean.theta)
        return mean, 0.5 * (spread + spread.T)

    def best_pose(self, vehicle: str) -> Pose2:
        """Return the pose of a vehicle in the best particle, motion told so far included."""
        number = self._number(vehicle)
        pose = Pose2.from_array(self._poses[number, self.best_particle(vehicle)])
        return pose.compose(self._pending[number].mean)

    def particle_poses(self, vehicle: str) -> Array:
        """Return the poses (M, 3) of a vehicle in all particles, motion told so far included."""
        number = self._number(vehicle)
        return compose(self._poses[number], np.asarray(self._pending[number].mean))

    def weights(self, vehicle: str | None = None) -> Array:
        """Return the normalized weights (M,) of the particles of a vehicle (else of the first)."""
        return self._group(vehicle).weights()

    def effective_particles(self) -> float:
        """Return the effective sample size, 1 … M: the least of all groups of vehicles."""
        return min(group.effective() for group in self.groups.all)

    def landmarks(self) -> Landmarks:
        """Return the landmarks of the best particle."""
        return self.map.of_particle(self._best_particles())

    # -- path -----------------------------------------------------------------------------------

    def add_keyframe(self, vehicle: str, stamp: float) -> int:
        """Append the present pose of a vehicle (in all particles) to the path.

        Returns its number, counted 0, 1, 2 … over all vehicles.
        """
        number = self._number(vehicle)
        if not math.isfinite(stamp):
            raise SlamError(f'add_keyframe({vehicle!r}): stamp is {stamp}, expected seconds')
        home = self.groups.of(number).home
        return self.path.append(number, stamp, self.particle_poses(vehicle), home)

    def best_path(self) -> Array:
        """Return the poses (K, 3) of all keyframes along the lineage of the best particle.

        While the lineage goes on, poses returned before come again bit by bit.
        """
        return self.path.of_particle(self._best_particles())

    def trajectory(self, vehicle: str) -> tuple[Array, Array]:
        """Return stamps (T,) and poses (T, 3) of the keyframes of a vehicle, best lineage."""
        chosen = self.path.of_vehicle(self._number(vehicle))
        return np.array(self.path.stamps)[chosen], self.best_path()[chosen]

    # -- state ----------------------------------------------------------------------------------

    def state_dict(self) -> checkpoint.State:
        """See Checkpointed."""
        return belief_state.state_of(self)

    @classmethod
    def from_state(cls, state: checkpoint.State) -> Self:
        """See Checkpointed."""
        return belief_state.restored(cls, state)

    def _group(self, vehicle: str | None) -> Group:
        return self.groups.of(0 if vehicle is None else self._number(vehicle))

    def _number(self, vehicle: str) -> int:
        try:
            return self._numbers[vehicle]
        except (KeyError, TypeError):
            raise SlamError(
                f'there is no vehicle {vehicle!r}, expected one of {list(self.vehicles)}'
            ) from None
