"""The filter of one team: FastSLAM over the poses of all vehicles and one landmark map."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import InterRobotObservation, LandmarkObservations
from explore_slam.errors import SlamError
from explore_slam.geometry import IDENTITY, Array, Pose2, between, compose, rotated, wrap_angles
from explore_slam.settings import values_of, with_values
from explore_slam.slam import checks
from explore_slam.slam.association.candidates import find_candidates
from explore_slam.slam.association.state import MAJORITY, AssociationState, CandidateSet
from explore_slam.slam.checkpoint import Checkpointed, State, part, text_array, text_value, under
from explore_slam.slam.config import FastSlamConfig
from explore_slam.slam.descriptors.kinds import kind_named
from explore_slam.slam.joint_posterior import JointPosterior, Redraw, RelativePose
from explore_slam.slam.landmark_join import LandmarkJoin
from explore_slam.slam.landmarks.landmark_map import LandmarkMap, Landmarks, make_index
from explore_slam.slam.particles.group import Group, Groups
from explore_slam.slam.particles.motion import PendingMotion, Segment, calibrated
from explore_slam.slam.particles.path_store import PathStore
from explore_slam.slam.particles.resampling import (
    mean_and_covariance,
    normalized,
    stratified_normals,
    systematic_ancestors,
)
from explore_slam.slam.relocalization import Relocalized, Relocalizer
from explore_slam.slam.storage.ancestry import AncestryTree, Index
from explore_slam.slam.storage.row_format import COVARIANCE, Places
from explore_slam.slam.summary import UpdateSummary
from explore_slam.slam.update.engine import PoseProposal
from explore_slam.slam.update.engines import make_engine
from explore_slam.slam.update.fastslam2_engine import pair_likelihoods
from explore_slam.slam.update.inter_robot import condition_on_observation
from explore_slam.slam.update.landmark_update import update_associated
from explore_slam.slam.update.map_management import Committed, MapManager
from explore_slam.slam.update.observation_correlation import ObservationCorrelation

# Inter-robot observations whose covariance grows by more than this factor repeat the one before:
# they are left out, since each becomes two keyframes of the joint graph that are never dropped.
_REPETITION = 5.0
# Part of the observations with a distinctive descriptor that may lie outside of all gates before
# the particles are taken as contradicted: outliers are a few percent (MR.CLAM 6, TUM fr1_rpy).
_CONTRADICTED = 0.3


class FastSlam(Checkpointed):
    """One Rao-Blackwellized particle filter for several vehicles (paper, sections III and IV).

    Each particle holds the poses of all vehicles and one landmark map. Vehicles whose maps do not
    overlap yet are filtered in separate groups; groups merge when one of their vehicles observes a
    landmark of the other. A vehicle whose start pose is unknown (None) is filtered in a frame of
    its own, where it starts at the origin, until it joins the map; if all are unknown, the first
    one starts at the origin of the map. Results depend only on the inputs and the seed.
    A call that raises SlamError leaves the filter unchanged.
    """

    def __init__(
        self,
        start_poses: Mapping[str, Pose2 | None],
        config: FastSlamConfig | None = None,
        seed: int = 0,
    ) -> None:
        if not start_poses:
            raise SlamError('start_poses is empty, expected one vehicle or more')
        self.config = config if config is not None else FastSlamConfig()
        starts = [
            checks.check_pose(f'start pose of {name!r}', IDENTITY if pose is None else pose)
            for name, pose in start_poses.items()
        ]
        self.vehicles = tuple(start_poses)
        particles, association = self.config.particles, self.config.association
        self._numbers = {name: number for number, name in enumerate(self.vehicles)}
        # of every vehicle and particle: pose (x, y, theta), calibration of the odometry, and the
        # measured pose at which the next motion begins (mean given the pose)
        self._states = np.zeros((len(starts), particles, 9))
        self._states[:, :, :3] = np.array(starts, np.float64)[:, None, :]
        self._pending = [PendingMotion() for _ in starts]
        # (3, 3) in the vehicle frame, of where the next motion begins given the pose; None: there
        self._chain_covariances: list[Array | None] = [None] * len(starts)
        self._predicted = [False] * len(starts)
        self._stamps = [-math.inf] * len(starts)
        self._random = np.random.default_rng(seed)
        self._engine = make_engine(self.config)
        # vehicles in a frame of their own, because nothing tells yet where they are in the map
        self._apart = {n for n, pose in enumerate(start_poses.values()) if pose is None}
        if len(self._apart) == len(starts):
            self._apart.remove(0)
        self._check_unknown_starts()
        self._finders = {n: LandmarkJoin(self.config.relocalization) for n in sorted(self._apart)}
        self.groups = Groups(len(starts), particles, joint=self._engine.joint)
        kind = kind_named(association.descriptor_kind)
        self.map = LandmarkMap(particles, kind, make_index(association))
        self.path = PathStore(particles)
        self.joint = JointPosterior(starts, self.config) if self._engine.redraws else None
        if self.joint is not None:
            for group in self.groups.all:
                group.samples = [self.joint.first_samples()]
            if self.config.calibration.odometry_calibration:
                for calibrations in self._calibrations:
                    normals = stratified_normals(self._random, particles, 3)
                    calibrations[:] = normals * self.config.calibration.deviations()
        self._correlation = ObservationCorrelation(len(starts), self.config.correlation)
        self._manager = MapManager(self.map, self._engine, self.config)
        self._relocalizers = [Relocalizer(self.config.relocalization) for _ in starts]

    def _check_unknown_starts(self) -> None:
        if not self._apart:
            return
        needed = ''
        if not self._engine.redraws:
            needed = 'the setting joint_graph and engine fastslam2'
        elif self.config.insertion_policy == 'unmapped_region':
            needed = 'an insertion_policy that does not divide the map between vehicles'
        if needed:
            names = [self.vehicles[number] for number in sorted(self._apart)]
            raise SlamError(f'the start poses of {names} are unknown, which needs {needed}')

    # -- motion ---------------------------------------------------------------------------------

    def predict(
        self,
        vehicle: str,
        increment: Pose2,
        covariance: Array | None = None,
        white: Array | None = None,
    ) -> None:
        """Propagate a vehicle by an odometry increment.

        Increments accumulate and are applied at the next update, so that calls are cheap.

        increment: motion since the last call, in the vehicle frame (m, m, rad).
        covariance: (3, 3) of the increment (m², rad²). Default: the configured odometry noise.
        Zero: exact.
        white: (3, 3) of an error of the measured pose at the end of the increment, in the vehicle
        frame there, that the next increment takes back: matching a scan with a map measures each
        pose by itself, so that increments lead from measured pose to measured pose. Default: none.
        """
        number = self._number(vehicle)
        step = self._step(number, checks.check_pose('increment', increment), covariance)
        error = np.zeros((3, 3))
        if white is not None:
            error = checks.check_motion_covariance('white', white)
        if step.is_motion():
            self._leave_pose(number)
            self._pending[number].white = error
        self._pending[number].append(step, self.config.linearizable_heading)
        self._relocalizers[number].predict(step.mean)
        if number in self._apart:
            self._finders[number].predict(step.mean)
        self._correlation.predict(number, step.mean)
        if self.joint is not None:
            self.joint.predict(number, step, error)
        self._predicted[number] = True

    def _leave_pose(self, number: int) -> None:
        """Continue from where the motion begins, if the pose has been updated since."""
        covariance = self._chain_covariances[number]
        if covariance is not None:
            self._poses[number] = self._chains[number]
            self._pending[number] = PendingMotion.of(covariance)
            self._chain_covariances[number] = None

    def _step(self, number: int, increment: Pose2, covariance: Array | None) -> Segment:
        """Return an increment as a motion, corrected by the calibration if it is of wheels."""
        if covariance is not None:
            noise = checks.check_motion_covariance('covariance', covariance)
            return Segment.empty()._replace(mean=increment, covariance=noise)
        noise = self.config.odometry_noise.covariance(increment)
        if self.joint is None or not self.config.calibration.odometry_calibration:
            return Segment.empty()._replace(mean=increment, covariance=noise)
        calibration = self.joint.calibrations[number]
        corrected, sensitivity = calibrated(increment, calibration)
        return Segment(corrected, noise, sensitivity, sensitivity @ calibration)

    def set_pose(self, vehicle: str, pose: Pose2, covariance: Array) -> None:
        """Give a vehicle a known pose; covariance (3, 3) in the map frame (m², rad²).

        A vehicle in a frame of its own joins the map with all that it has mapped.
        """
        number = self._number(vehicle)
        known = checks.check_pose('pose', pose)
        spread = checks.check_motion_covariance('covariance', covariance)
        if number in self._apart:
            self._join_at(number, known, spread)
        else:
            self._restart_at(number, known, spread)

    def displace(self, vehicle: str, covariance: Array) -> None:
        """Note that a vehicle was moved unobserved; covariance (3, 3) of where it is in its frame.

        A vehicle in a frame of its own remains there.
        """
        number = self._number(vehicle)
        spread = checks.check_motion_covariance('covariance', covariance)
        self._restart_at(number, self.estimate(vehicle)[0], spread)

    def _restart_at(self, number: int, pose: Pose2, covariance: Array) -> None:
        """Continue at a pose, covariance (3, 3), that the motion does not lead to."""
        self._poses[number] = np.asarray(pose)
        self._pending[number] = PendingMotion.of(rotated(covariance, pose.theta))
        self._chain_covariances[number] = None
        self._relocalizers[number].reset()
        if self.joint is not None:
            self.joint.restart(number, pose, covariance)
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

        Observations that contradict the particles let these be drawn anew from the joint graph
        first; if their numbers overflow then, they are refused, and the particles stay redrawn.

        Raises SlamError for no or too many observations, covariances that are not positive
        definite, descriptors of another kind, an unknown vehicle, a stamp before the last one, and
        an update before the first predict.
        """
        number = self._number(vehicle)
        self._check(number, observations)
        if self._engine.starts_new_round(number):
            self._end_round()

        what = f'update({vehicle!r}) at stamp {observations.stamp}'
        with self._rejecting(what):
            normals, state, proposal, P = self._associate(number, observations)
        if self._is_contradicted(number, state, proposal):
            redraw = self._draw([number])
            if redraw is not None:
                state.discard()
                self._take(redraw)
                with self._rejecting(what):
                    normals, state, proposal, P = self._associate(number, observations)
        found, group = state.found, self.groups.of(number)
        self._stamps[number] = observations.stamp
        # 2.6.2 importance weight
        group.reweight(proposal.log_likelihoods)
        effective, support = group.effective_particles(), state.support(group.weights())
        # 5 resample (fastslam2)
        resampled = self._resample_before_sampling(group, state, proposal)
        # 2.1 sample (fastslam2)
        predicted = proposal.poses.copy()
        poses = proposal.sample(normals)
        self._place(number, self._without_frame_error(predicted, poses, P), predicted, P)
        # 2.6.1 update the associated landmarks
        update_associated(state, poses, self.config.filter_threads)
        # 4 best particle
        best = self.best_particle(vehicle)
        matches = state.ids_in(best, self.map.ids)
        # 2.7.1 insert new landmarks; remove those that are not there
        committed = self._manager.commit(number, state, poses, support, best)
        self._record(number, state, committed)
        # 5 resample (paper)
        if self._engine.completes_round(number, self.vehicles):
            self._end_round()
            resampled = True
        agreed = support.sum(axis=1) > MAJORITY
        lost, relocated = self._relocalize(number, found, agreed)
        redrawn = self._redraw_if_due(group)
        joined = self._join_by_landmarks(number, observations)
        return UpdateSummary(
            stamp=observations.stamp,
            vehicle=vehicle,
            observed=len(observations),
            matched=int(np.count_nonzero(found.has_similar())),
            associated=int(np.count_nonzero(matches >= 0)),
            inserted=committed.inserted,
            removed=len(committed.removed),
            effective_particles=effective,
            resampled=resampled,
            redrawn=redrawn,
            lost=lost,
            relocated=relocated,
            joined=joined,
            matches=matches,
            together=tuple(self.vehicles[v] for v in self.groups.of(number).vehicles),
        )

    def _associate(
        self, number: int, observations: LandmarkObservations
    ) -> tuple[Array, AssociationState, PoseProposal, Array]:
        """Return standard normals (M, 3), the association, the proposal made of both, and P.

        P (3, 3) is the covariance of the predicted poses.
        """
        if self.joint is not None:
            self.joint.check_motion(number)
        # 2.2 candidate landmarks: similar descriptor, near where the observation is expected
        estimate = self.estimate(self.vehicles[number])
        reach = self._relocalizers[number].reach
        hidden = self._hidden_landmarks(number)
        association = self.config.association
        found = find_candidates(self.map, observations, association, *estimate, reach, hidden)
        found = self._with_correlated_noise(number, observations.stamp, found)
        fused = self.map.fuse(found.entries, self.groups)
        try:
            poses, P = self._propagate(number)
            poses = self._merge_groups(number, found, poses, P)
            group = self.groups.of(number)
            state = AssociationState(found, self.map.rows, group.tree)
            # 2.1 sample (paper), 2.4 gate, 2.5 descriptor; Gaussian proposal of the pose
            # (fastslam2)
            normals = stratified_normals(self._random, self.config.particles, 3)
            error = self.config.frame_error.covariance()
            total = P if error is None else P + error
            proposal = self._propose(state, poses, total, normals, group.log_weights)
        except FloatingPointError:
            for draw, entries in fused.items():
                self.map.defer(entries, draw, self.map.reference[entries])
            raise
        return normals, state, proposal, P

    def _hidden_landmarks(self, number: int) -> NDArray[np.bool_] | None:
        """Return which entries of the map lie in other frames than a vehicle; None: no entry."""
        if not self._apart:
            return None
        owners = self.map.owners[: self.map.size]
        hidden: NDArray[np.bool_] = (
            owners != number if number in self._apart else np.isin(owners, list(self._apart))
        )
        return hidden

    def _with_correlated_noise(
        self, number: int, stamp: float, found: CandidateSet
    ) -> CandidateSet:
        """Return candidates with the covariances that the observations have as repetitions."""
        if not self._engine.redraws or not len(found.entries):
            return found
        nearest = found.candidates[:, 0]
        entries = np.full(len(found), -1, np.int64)
        entries[nearest >= 0] = found.entries[nearest[nearest >= 0]]
        factors = self._correlation.factors(number, stamp, entries, self.map.ids[entries])
        observed = found.observed
        return replace(found, observed=observed._replace(R=observed.R * factors[:, None]))

    def _is_contradicted(
        self, number: int, state: AssociationState, proposal: PoseProposal
    ) -> bool:
        """Return whether observations contradict particles that have a common error.

        Particles of few ancestors share whatever error these had: when a loop is closed, hardly
        any of them fits, or the landmarks lie outside of all gates. Samples of the joint posterior
        contain that error.
        """
        group = self.groups.of(number)
        if self.joint is None or self.joint.is_fresh(group):
            return False
        least = self.config.redraw_effective * self.config.particles
        if proposal.effective_particles(group.log_weights) < least:
            return True
        weights = normalized(group.log_weights + proposal.log_likelihoods)[1]
        associated = state.support(weights).sum(axis=1) > MAJORITY
        distinctive = state.found.is_distinctive
        missed = np.count_nonzero(distinctive & ~associated)
        return bool(missed > _CONTRADICTED * np.count_nonzero(distinctive))

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
            self._poses[number].copy(),
            self._calibrations[number],
            self.config.linearizable_heading,
            self._random,
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

        return poses[self.groups.merge(group, others, likelihood, self._states, self._random)]

    def _without_frame_error(self, predicted: Array, seen_from: Array, P: Array) -> Array:
        """Return samples (M, 3) of the poses of a vehicle whose frame seems seen from others.

        predicted (M, 3) with the covariance P (3, 3); seen_from (M, 3): the same with the common
        error of the frame, sampled given the observations. What these say of the pose, they say
        by way of it: the pose given seen_from is that of two Gaussians added.
        """
        error = self.config.frame_error.covariance()
        if error is None:
            return seen_from
        gain = np.linalg.solve(P + error, P).T
        rest = P - gain @ P
        values, vectors = np.linalg.eigh(0.5 * (rest + rest.T))
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        normals = stratified_normals(self._random, len(predicted), 3)
        return compose(predicted, between(predicted, seen_from) @ gain.T + normals @ root.T)

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

    @property
    def _poses(self) -> Array:
        """Poses (V, M, 3) at the last updates; a view."""
        return self._states[:, :, :3]

    @property
    def _calibrations(self) -> Array:
        """Calibrations (V, M, 3) of the odometry; a view."""
        return self._states[:, :, 3:6]

    @property
    def _chains(self) -> Array:
        """Measured poses (V, M, 3) at which the next motion begins; a view."""
        return self._states[:, :, 6:]

    def _predicted_poses(self, number: int) -> Array:
        """Return the mean predicted pose (M, 3) of a vehicle in each particle."""
        return self._pending[number].apply(self._poses[number], self._calibrations[number])

    def _place(
        self,
        number: int,
        poses: Array,
        predicted: Array,
        P: Array,
        remaining: Array | None = None,
    ) -> None:
        """Set the poses (M, 3) of a vehicle, which include all of its motion.

        predicted (M, 3) with covariance P (3, 3): before the update. remaining (3, 3): covariance
        that the poses still have, in the vehicle frame. Where a white error W is part of P, the
        next motion does not begin at the pose x but at the measured pose c, x = c ⊞ w. Given x, c
        is Gaussian: the conditional of a sum of two.
        """
        W = self._pending[number].white
        left = np.zeros((3, 3)) if remaining is None else remaining
        if self.joint is not None and W.any():
            gain = np.eye(3) - W @ np.linalg.inv(P)
            self._chains[number] = compose(predicted, between(predicted, poses) @ gain.T)
            spread = P - W - gain @ (P - left) @ gain.T
            self._chain_covariances[number] = 0.5 * (spread + spread.T)
        poses[:, 2] = wrap_angles(poses[:, 2])
        self._poses[number] = poses
        self._pending[number] = PendingMotion() if remaining is None else PendingMotion.of(left)

    def _record(self, number: int, state: AssociationState, committed: Committed) -> None:
        """Record an update in the joint graph: the associations of most of the weight."""
        if self.joint is None:
            return
        keyframe = self.joint.keyframe(number, self.estimate(self.vehicles[number])[0])
        self.joint.observe(keyframe, committed.ids, state.found.observed)
        stamp, entries = self._stamps[number], self.map.entries_with(committed.ids)
        self._correlation.add(number, stamp, entries, committed.ids)
        if len(committed.removed):
            self.joint.graph.remove_landmarks(committed.removed)

    def _redraw_if_due(self, group: Group) -> bool:
        """Redraw the paths of a group if it no longer represents the posterior."""
        if self.joint is None or not self.joint.is_due(group):
            return False
        redraw = self._draw(group.vehicles)
        if redraw is None:
            return False
        self._take(redraw)
        return True

    def redraw(self, vehicles: Sequence[int]) -> None:
        """Draw the paths of vehicles (numbers) anew from the posterior of the joint graph.

        All particles then have equal weights and no common ancestors; the rows of their landmarks
        are fused from the stored observations when they are next needed. Landmarks of which no
        observation is stored are removed.
        """
        self._joint()
        redraw = self._draw(vehicles)
        if redraw is None:
            names = [self.vehicles[number] for number in vehicles]
            raise SlamError(f'the joint graph of {names} has no definite optimum')
        self._take(redraw)

    def _draw(self, vehicles: Sequence[int]) -> Redraw | None:
        """Return samples of vehicles and of all that are connected with them.

        None if the graph has no definite optimum, because covariances differ by too many orders of
        magnitude; the particles that there are then go on.
        """
        if self.joint is None:
            return None
        members, found = set[int](), set(vehicles)
        while found != members:
            members = found
            found = {v for n in members for v in self.groups.of(n).vehicles}
            found |= {v for n in members for v in self.joint.graph.tied(n)}
        random = self._random.bit_generator.state
        try:
            return self.joint.redraw(sorted(members), self._random)
        except SlamError:
            self._random.bit_generator.state = random
            return None

    def _take(self, redraw: Redraw) -> None:
        """Replace the particles of some vehicles by samples."""
        old = [self.groups.of(number) for number in redraw.vehicles]
        mine = self.map.entries_of(old)
        known = np.isin(self.map.ids[mine], redraw.ids)
        if self.joint is not None:
            self.joint.graph.remove_landmarks(self.map.ids[mine[~known]])
        self.map.remove(mine[~known])
        kept = mine[known]
        places = np.searchsorted(redraw.ids, self.map.ids[kept])
        self.map.defer(kept, redraw.samples.number, redraw.positions[places])
        group = Group(redraw.vehicles, self.config.particles)
        group.samples = [redraw.samples]
        self.groups.replace(group)
        for number in redraw.vehicles:
            self._poses[number] = redraw.poses[number]
            self._chains[number] = redraw.chains[number]
            self._chain_covariances[number] = np.zeros((3, 3))
            if redraw.moved[number]:
                self._leave_pose(number)
            if number in redraw.calibrations:
                self._calibrations[number] = redraw.calibrations[number]
            self._pending[number] = redraw.pending[number]

    def _relocalize(
        self, number: int, found: CandidateSet, agreed: NDArray[np.bool_]
    ) -> tuple[bool, bool]:
        """Note what was matched; return whether the vehicle is lost, and whether it was found."""
        relocalizer, R = self._relocalizers[number], found.measured.R
        deviations = np.sqrt(0.5 * (R[:, 0] + R[:, 3]))
        similar = np.where(found.is_distinctive[:, None], found.similar_ids, -1)
        relocalizer.add(found.observed.z, deviations, similar, agreed)
        wanted = self.config.relocalization.relocalization and self._engine.relocalizes
        if not wanted or not relocalizer.is_lost:
            return relocalizer.is_lost, False
        positions = self.map.positions(
            relocalizer.similar_ids(), self._best_particles(), self.groups
        )
        current = self.best_pose(self.vehicles[number])
        pose = relocalizer.search(positions, current, self._random)
        if pose is None:
            return True, False
        self._restart(number, pose)
        return True, True

    def _restart(self, number: int, found: Relocalized) -> None:
        """Place a vehicle where it was relocalized, in each particle relative to its own map.

        The particles differ in where they have the landmarks; the common frame of these is no
        better known to the vehicle than to them.
        """
        deviations = np.array([found.position_deviation] * 2 + [found.heading_deviation])
        P = np.diag(deviations**2)
        moves = self._moves_of(self.map.entries_with(found.ids), found.pose)
        poses = compose(np.asarray(found.pose), moves)
        self._poses[number] = poses
        self._pending[number] = PendingMotion.of(P)
        self._relocalizers[number].reset()
        if self.joint is not None:
            mean, spread = mean_and_covariance(poses, self.groups.of(number).weights())
            self.joint.restart(number, mean, spread + rotated(P, -mean.theta))
        self._predicted[number] = True

    def _moves_of(self, entries: Places, pose: Pose2) -> Array:
        """Return how the landmarks of each particle are moved from their mean.

        entries (n,): two landmarks or more. The moves (M, 3) are those of a rigid body, in the
        frame of a pose (least squares, for small angles).
        """
        self.map.fuse(entries, self.groups)
        rows = self.map.rows.read(entries)
        there = rows[:, COVARIANCE] > 0.0
        mean = (rows[:, :2] * there[:, None]).sum(axis=2)
        mean /= np.maximum(there.sum(axis=1), 1)[:, None]
        c, s = math.cos(pose.theta), math.sin(pose.theta)
        axes = np.array([[c, s], [-s, c]])  # rows: the axes of the frame, in the map
        place = (mean - [pose.x, pose.y]) @ axes.T
        off = np.where(there[:, None], rows[:, :2] - mean[:, :, None], 0.0)
        off = np.einsum('ab,nbm->nam', axes, off)
        center, shift = place.mean(axis=0), off.mean(axis=0)
        arm = place - center
        turned = (arm[:, :1] * off[:, 1] - arm[:, 1:] * off[:, 0]).sum(axis=0)
        turned /= max(float((arm**2).sum()), np.finfo(float).tiny)
        x = shift[0] + turned * center[1]
        y = shift[1] - turned * center[0]
        moves: Array = np.stack([x, y, turned], axis=1)
        return moves

    # -- inter-robot observations ---------------------------------------------------------------

    def update_inter_robot(
        self, vehicle: str, observations: Sequence[InterRobotObservation]
    ) -> None:
        """Update with the positions at which a vehicle measured others of the team.

        The motion of all of them must have been predicted up to now. Without effect if the setting
        inter_robot_observations is off, or if the frames of the two are not tied together yet.
        """
        number = self._number(vehicle)
        targets = [self._number(observation.vehicle) for observation in observations]
        for observation in observations:
            checks.check_inter_robot(vehicle, observation)
        if not self.config.inter_robot_observations:
            return
        for target, observation in zip(targets, observations, strict=True):
            if not self.are_in_one_frame(vehicle, self.vehicles[target]):
                continue
            factor = 1.0
            if self.joint is not None:
                factor = self._correlation.factor_between(number, target, observation.stamp)
            if factor > _REPETITION:
                continue
            measured = replace(observation, covariance=factor * observation.covariance)
            what = f'observation of {observation.vehicle!r} at stamp {observation.stamp}'
            with self._rejecting(what):
                self._update_inter_robot(number, target, measured)
            self._correlation.add_between(number, target, observation.stamp)

    def _update_inter_robot(
        self, number: int, target: int, observation: InterRobotObservation
    ) -> None:
        zeros = np.zeros((self.config.particles, 3))
        target_P = self._pending[target].end_covariance()
        poses, P = self._propagate(number)
        target_poses = self._predicted_poses(target)

        def condition(poses: Array, theirs: Array, normals: Array) -> tuple[Array, Array]:
            weights = self.groups.of(number).weights()
            return condition_on_observation(
                (poses, P), (theirs, target_P), observation, self.config, normals, weights
            )

        def likelihood(orders: Sequence[Index]) -> Array:
            return condition(poses.copy(), target_poses[orders[0]], zeros)[0]

        group, other = self.groups.of(number), self.groups.of(target)
        if other is not group:
            states = self._states
            poses = poses[self.groups.merge(group, [other], likelihood, states, self._random)]
            target_poses = self._predicted_poses(target)
            group = self.groups.of(number)
        normals = stratified_normals(self._random, self.config.particles, 3)
        predicted, target_predicted = poses.copy(), target_poses.copy()
        log_likelihoods, remaining = condition(poses, target_poses, normals)
        group.reweight(log_likelihoods)
        self._place(number, poses, predicted, P)
        self._place(target, target_poses, target_predicted, target_P, remaining)
        if self.joint is not None:
            seer, seen = (
                self.joint.keyframe(v, self.estimate(self.vehicles[v])[0])
                for v in (number, target)
            )
            self.joint.observe_vehicle(seer, seen, observation)
        if self._engine.resamples_before_sampling(group):
            self._resample(group, group.weights())
        self._redraw_if_due(group)

    # -- unknown start poses --------------------------------------------------------------------

    def is_in_map(self, vehicle: str) -> bool:
        """Return whether the poses of a vehicle are in the map, not in a frame of its own."""
        return self._number(vehicle) not in self._apart

    def are_in_one_frame(self, one: str, other: str) -> bool:
        """Return whether the poses of two vehicles can be compared."""
        return one == other or (self.is_in_map(one) and self.is_in_map(other))

    def join(self, vehicle: str, frame: Pose2, closures: Sequence[RelativePose]) -> list[int]:
        """Take a vehicle that is in a frame of its own into the map, with all that it has mapped.

        frame: pose of its frame in the map, from which the optimization starts. closures: relative
        poses of its keyframes and those of vehicles in the map, which tie it from now on; see
        `close_loops`.
        """
        number, joint = self._number(vehicle), self._joint()
        if number not in self._apart:
            raise SlamError(f'{vehicle!r} is in the map already')
        at = checks.check_pose('frame', frame)
        ends = [self._node(k) for c in closures for k in (c.reference, c.keyframe)]
        tied = set(joint.graph.vehicles_of(ends).tolist()) if ends else set()
        if number not in tied or tied & (self._apart - {number}) or len(tied) < 2:
            names = [self.vehicles[other] for other in sorted(tied)]
            raise SlamError(f'closures tie {names}, expected {vehicle!r} and vehicles in the map')
        saved = {name: np.array(value) for name, value in joint.state_dict().items()}
        joint.move([number], at)
        self._apart.remove(number)
        try:
            return self.close_loops(closures)
        except SlamError:
            joint.restore(saved)
            self._apart.add(number)
            raise

    def _join_by_landmarks(self, number: int, observations: LandmarkObservations) -> bool:
        """Join a vehicle where the landmarks that it observes lie in the map, if they agree."""
        if number not in self._apart or not self.config.relocalization.relocalization:
            return False
        hidden = self._hidden_landmarks(number)
        estimate, P = self.estimate(self.vehicles[number])
        own = None if hidden is None else ~hidden
        found = find_candidates(
            self.map, observations, self.config.association, estimate, P, math.inf, own
        )
        finder, R = self._finders[number], found.measured.R
        deviations = np.sqrt(0.5 * (R[:, 0] + R[:, 3]))
        similar = np.where(found.is_distinctive[:, None], found.similar_ids, -1)
        finder.add(found.observed.z, deviations, similar)
        positions = self.map.positions(finder.similar_ids(), self._best_particles(), self.groups)
        pose = finder.search(positions, estimate, self._random)
        if pose is None:
            return False
        deviation = np.array([pose.position_deviation] * 2 + [pose.heading_deviation])
        try:
            self._join_at(number, pose.pose, np.diag(deviation**2))
        except SlamError:
            return False
        return True

    def _join_at(self, number: int, pose: Pose2, covariance: Array) -> None:
        """Take a vehicle into the map whose present pose there is known, covariance (3, 3)."""
        joint = self._joint()
        estimate = self.estimate(self.vehicles[number])[0]
        saved = {name: np.array(value) for name, value in joint.state_dict().items()}
        keyframe = joint.keyframe(number, estimate)
        joint.move([number], pose.compose(estimate.inverse()))
        joint.measure_pose(keyframe, pose, covariance)
        redraw = self._draw([number])
        if redraw is None:
            joint.restore(saved)
            raise SlamError(f'at {pose} the joint graph has no definite optimum')
        self._apart.remove(number)
        self._take(redraw)
        self._predicted[number] = True

    # -- loop closures --------------------------------------------------------------------------

    def pin(self, keyframe: int) -> None:
        """Keep a keyframe of `add_keyframe`, so that closures can be measured relative to it."""
        self._joint().pin(self._node(keyframe))

    def unpin(self, keyframe: int) -> None:
        """Take back a `pin`."""
        self._joint().unpin(self._node(keyframe))

    def close_loops(self, closures: Sequence[RelativePose]) -> list[int]:
        """Record relative poses of keyframes; return a number for each, for `reopen_loop`.

        The paths are redrawn at once if the closures move the estimate by more than its deviation
        or the last redraw is some keyframes ago, otherwise with closures to come. Groups of
        vehicles that a closure ties together are merged.
        """
        joint = self._joint()
        measured = [
            closure._replace(
                reference=self._node(closure.reference), keyframe=self._node(closure.keyframe)
            )
            for closure in closures
        ]
        ends = [joint.graph.vehicles_of([c.reference, c.keyframe]).tolist() for c in measured]
        merges = any(self.groups.of(a) is not self.groups.of(b) for a, b in ends)
        factors: list[int] = []
        try:
            factors.extend(joint.close(closure) for closure in measured)
        except SlamError:
            for factor in factors:
                joint.reopen(factor)
            raise
        if merges or joint.is_closure_due(measured):
            redraw = self._draw(sorted({vehicle for pair in ends for vehicle in pair}))
            if redraw is None:
                for factor in factors:
                    joint.reopen(factor)
                raise SlamError('with these closures the joint graph has no definite optimum')
            self._take(redraw)
        return factors

    def reopen_loop(self, number: int) -> None:
        """Take back a closure."""
        self._joint().reopen(number)

    def forget_loop(self, number: int) -> None:
        """Drop a closure of a place that others hold as well; the path stays where it is."""
        self._joint().forget(number)

    def closure_distances(self) -> dict[int, float]:
        """Return the squared Mahalanobis distance of every closure from the path, by number."""
        return self._joint().closure_distances()

    def relative_covariance(self, reference: int, keyframes: Places) -> Array:
        """Return covariances (n, 3, 3) of keyframes' poses in the frame of a reference.

        They are those of the components of the relative poses, in the axes of the reference.
        """
        nodes = np.array(self.path.nodes, np.int64)
        return self._joint().relative_covariance(self._node(reference), nodes[keyframes])

    @property
    def redraws(self) -> int:
        """How often paths were drawn; 0 without a joint graph."""
        return 0 if self.joint is None else self.joint.draws

    def _joint(self) -> JointPosterior:
        if self.joint is None:
            raise SlamError(
                'redraws and closures need the setting joint_graph and engine fastslam2'
            )
        return self.joint

    def _node(self, keyframe: int) -> int:
        """Return the number of a keyframe in the joint graph."""
        if not 0 <= keyframe < len(self.path):
            raise SlamError(f'keyframe is {keyframe}, expected 0 … {len(self.path) - 1}')
        return self.path.nodes[keyframe]

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
        self._states[group.vehicles] = self._states[group.vehicles][:, ancestors]
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
        poses = self._predicted_poses(number)
        weights = self.groups.of(number).weights()
        mean, spread = mean_and_covariance(poses, weights)
        spread += rotated(pending.end_covariance(), -mean.theta)
        return mean, 0.5 * (spread + spread.T)

    def motion(
        self, vehicle: str, steps: Iterable[tuple[Pose2, Array | None]]
    ) -> tuple[Pose2, Array]:
        """Return mean and covariance (3, 3) of a motion that is not predicted yet.

        They are in the frame of the vehicle before it. steps: increments and their covariances as
        for `predict`, so that those of wheel odometry are corrected by the calibration.
        """
        number, total = self._number(vehicle), Segment.empty()
        for increment, covariance in steps:
            total = total.extended(self._step(number, increment, covariance))
        mean, spread = self.odometry_calibration(vehicle)
        covariance = total.covariance + total.sensitivity @ spread @ total.sensitivity.T
        return Pose2.from_array(total.moves(mean[None])[0]), covariance

    def odometry_calibration(self, vehicle: str) -> tuple[Array, Array]:
        """Return mean (3,) and covariance (3, 3) of a vehicle's odometry calibration.

        Its parts are the scale errors of turning and of driving and the heading drift (rad/m) by
        which increments are corrected, see `particles.motion.calibrated`; zero where nothing is
        calibrated.
        """
        number = self._number(vehicle)
        weights, values = self.groups.of(number).weights(), self._calibrations[number]
        mean = weights @ values
        off = values - mean
        return mean, (off * weights[:, None]).T @ off

    def best_pose(self, vehicle: str) -> Pose2:
        """Return the pose of a vehicle that its path ends at, predicted motion included.

        It is the mean if the particles are samples of the joint posterior, else that of the best
        particle.
        """
        number = self._number(vehicle)
        if self.joint is not None:
            return self.estimate(vehicle)[0]
        return Pose2.from_array(self._predicted_poses(number)[self.best_particle(vehicle)])

    def particle_poses(self, vehicle: str) -> Array:
        """Return the poses (M, 3) of a vehicle in all particles, predicted motion included."""
        return self._predicted_poses(self._number(vehicle))

    def weights(self, vehicle: str | None = None) -> Array:
        """Return the normalized weights (M,) of the particles of a vehicle (else of the first)."""
        return self._group(vehicle).weights()

    def effective_particles(self) -> float:
        """Return the effective sample size, 1 to M: the least of all groups of vehicles."""
        return min(group.effective_particles() for group in self.groups.all)

    def landmarks(self) -> Landmarks:
        """Return the landmarks of the best particle that lie in the map."""
        found = self.map.of_particle(self._best_particles(), self.groups)
        return found.only(~np.isin(found.owners, list(self._apart))) if self._apart else found

    # -- path -----------------------------------------------------------------------------------

    def add_keyframe(self, vehicle: str, stamp: float) -> int:
        """Append the current pose of a vehicle, in all particles, to the path.

        Returns its number, counted 0, 1, 2 … over all vehicles.
        """
        number = self._number(vehicle)
        if not math.isfinite(stamp):
            raise SlamError(f'add_keyframe({vehicle!r}): stamp is {stamp}, expected seconds')
        if self.joint is not None:
            node = self.joint.keyframe(number, self.estimate(vehicle)[0])
            return self.path.append_node(number, stamp, node)
        tree = self.groups.of(number).tree
        return self.path.append(number, stamp, self.particle_poses(vehicle), tree)

    def best_path(self) -> Array:
        """Return the poses (K, 3) of all keyframes along the most likely path.

        Those of vehicles that are not in the map yet are in the frames of these; see
        `keyframes_in_map`. The path is the optimum of the joint graph, the same bit by bit until
        the next redraw; without a graph, the lineage of the best particle, the same as long as
        that continues.
        """
        if self.joint is not None:
            return self.joint.path()[self.path.nodes]
        return self.path.of_particle(self._best_particles())

    def keyframes_of(self, vehicle: str) -> Places:
        """Return the numbers of a vehicle's keyframes, ascending."""
        return self.path.of_vehicle(self._number(vehicle))

    def keyframes_in_map(self) -> NDArray[np.bool_]:
        """Return (K,) which keyframes are of vehicles whose poses are in the map."""
        return ~np.isin(np.array(self.path.vehicles, np.int64), list(self._apart))

    def trajectory(self, vehicle: str) -> tuple[Array, Array]:
        """Return stamps (T,) and poses (T, 3) of a vehicle's keyframes on the most likely path."""
        chosen = self.path.of_vehicle(self._number(vehicle))
        return np.array(self.path.stamps)[chosen], self.best_path()[chosen]

    # -- state ----------------------------------------------------------------------------------

    def state_dict(self) -> State:
        """See Checkpointed."""
        about = {
            'settings': values_of(self.config),
            'vehicles': list(self.vehicles),
            'apart': sorted(self._apart),
            'random': self._random.bit_generator.state,
        }
        stores = [self.map.rows, self.path.rows]
        state: State = {
            'about': text_array(about),
            'states': self._states,
            'predicted': np.array(self._predicted),
            'stamps': np.array(self._stamps),
            'has_chain_covariance': np.array([P is not None for P in self._chain_covariances]),
            'chain_covariances': np.array(
                [np.zeros((3, 3)) if P is None else P for P in self._chain_covariances]
            ),
            **under('map', self.map.state_dict()),
            **under('path', self.path.state_dict()),
            **under('groups', self.groups.state_dict(stores)),
            **under('engine', self._engine.state_dict()),
            **under('manager', self._manager.state_dict()),
            **under('correlation', self._correlation.state_dict()),
        }
        if self.joint is not None:
            state |= under('joint', self.joint.state_dict())
        for number, pending in enumerate(self._pending):
            state |= under(f'motion{number}', pending.state_dict())
        for number, relocalizer in enumerate(self._relocalizers):
            state |= under(f'relocalizer{number}', relocalizer.state_dict())
        for number in self._apart:
            state |= under(f'finder{number}', self._finders[number].state_dict())
        return {name: np.array(value) for name, value in state.items()}

    @classmethod
    def from_state(cls, state: State) -> Self:
        """See Checkpointed."""
        try:
            about = text_value(state['about'])
            starts = dict.fromkeys(about['vehicles'], IDENTITY)
            slam = cls(starts, with_values(FastSlamConfig(), about['settings']))
            slam._apart = set(about['apart'])
            slam._restore(about['random'], state)
        except (KeyError, ValueError, IndexError, TypeError) as error:
            raise SlamError(f'the saved state of the filter is incomplete: {error!r}') from error
        return slam

    def _restore(self, random: dict[str, object], state: State) -> None:
        self._random.bit_generator.state = random
        self._states = state['states'].copy()
        self._predicted = state['predicted'].tolist()
        self._stamps = state['stamps'].tolist()
        self._chain_covariances = [
            P.copy() if known else None
            for P, known in zip(
                state['chain_covariances'], state['has_chain_covariance'], strict=True
            )
        ]
        self.map.restore(part('map', state))
        self.path.restore(part('path', state))
        self.groups.restore(part('groups', state), [self.map.rows, self.path.rows])
        self._engine.restore(part('engine', state))
        self._manager.restore(part('manager', state))
        self._correlation.restore(part('correlation', state))
        if self.joint is not None:
            self.joint.restore(part('joint', state))
        for number, pending in enumerate(self._pending):
            pending.restore(part(f'motion{number}', state))
        for number, relocalizer in enumerate(self._relocalizers):
            relocalizer.restore(part(f'relocalizer{number}', state))
        for number in self._apart:
            self._finders[number] = LandmarkJoin(self.config.relocalization)
            self._finders[number].restore(part(f'finder{number}', state))

    def _group(self, vehicle: str | None) -> Group:
        return self.groups.of(0 if vehicle is None else self._number(vehicle))

    def _number(self, vehicle: str) -> int:
        try:
            return self._numbers[vehicle]
        except (KeyError, TypeError):
            raise SlamError(
                f'there is no vehicle {vehicle!r}, expected one of {list(self.vehicles)}'
            ) from None
