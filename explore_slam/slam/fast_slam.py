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
from explore_slam.geometry import IDENTITY, Array, Pose2, rotated
from explore_slam.settings import values_of, with_values
from explore_slam.slam import checks
from explore_slam.slam.association.candidates import find_candidates
from explore_slam.slam.association.reacquisition import without_lone_matches
from explore_slam.slam.association.state import MAJORITY, AssociationState, CandidateSet
from explore_slam.slam.checkpoint import Checkpointed, State, part, text_array, text_value, under
from explore_slam.slam.config import FastSlamConfig
from explore_slam.slam.inter_robot_updates import InterRobotUpdates
from explore_slam.slam.landmarks.landmark_map import Landmarks
from explore_slam.slam.particles.group import Group
from explore_slam.slam.particles.resampling import normalized, stratified_normals
from explore_slam.slam.posterior.joint_posterior import RelativePose
from explore_slam.slam.posterior.loop_constraints import LoopConstraints
from explore_slam.slam.posterior.redrawing import PathRedrawer
from explore_slam.slam.posterior.tag_constraints import TagConstraints
from explore_slam.slam.relocalization.joining import Joining
from explore_slam.slam.relocalization.relocalization import Relocalization
from explore_slam.slam.storage.ancestry import Index
from explore_slam.slam.storage.row_format import Places
from explore_slam.slam.summary import UpdateSummary
from explore_slam.slam.team_state import TeamState
from explore_slam.slam.update.engine import PoseProposal
from explore_slam.slam.update.fastslam2_engine import pair_likelihoods
from explore_slam.slam.update.frame_error import without_frame_error
from explore_slam.slam.update.landmark_update import update_associated
from explore_slam.slam.update.map_management import Committed, MapManager


class FastSlam(Checkpointed):
    """One Rao-Blackwellized particle filter for several vehicles (paper, sections III and IV).

    Each particle holds the poses of all vehicles and one landmark map. Vehicles whose maps do not
    overlap yet are filtered in separate groups; groups merge when one of their vehicles observes a
    landmark of the other. A vehicle whose start pose is unknown (None) is filtered in a frame of
    its own, where it starts at the origin, until it joins the map; if all are unknown, the first
    one starts at the origin of the map. Results depend only on the inputs and the seed.

    A call that raises SlamError leaves everything that was recorded unchanged. A redraw that was
    due may have preceded the error: the particles are then other samples of the same posterior.
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
        starts = {
            name: None if pose is None else checks.check_pose(f'start pose of {name!r}', pose)
            for name, pose in start_poses.items()
        }
        self.vehicles = tuple(starts)
        self._numbers = {name: number for number, name in enumerate(self.vehicles)}
        self._team = TeamState(starts, self.config, seed)
        self._engine = self._team.engine
        self.groups = self._team.groups
        self.map = self._team.map
        self.path = self._team.path
        self.joint = self._team.joint
        self._manager = MapManager(self.map, self._engine, self.config)
        self._redrawer = PathRedrawer(self._team)
        self._constraints = LoopConstraints(self._team, self._redrawer)
        self._joining = Joining(self._team, self._redrawer, self._constraints)
        self._relocalization = Relocalization(self._team, self._redrawer)
        self._inter_robot = InterRobotUpdates(self._team, self._redrawer)
        self.tags = TagConstraints(self._team, self._redrawer, self._constraints)

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
        white: (3, 3) of an independent error of the measured pose at the end of the increment, in
        the vehicle frame there, that cancels in the next increment: scan matching measures each
        pose independently, and increments lead from measured pose to measured pose. Default: none.
        """
        number = self._number(vehicle)
        motion = checks.check_pose('increment', increment)
        step = self._team.step_of(number, motion, covariance)
        error = np.zeros((3, 3))
        if white is not None:
            error = checks.check_motion_covariance('white', white)
        self._team.particles.append(number, step, error)
        self._relocalization.predict(number, step.mean)
        self._joining.predict(number, step.mean)
        self._team.correlation.predict(number, step.mean)
        if self.joint is not None:
            self.joint.predict(number, step, error)
        self._team.has_motion[number] = True

    def set_pose(self, vehicle: str, pose: Pose2, covariance: Array) -> None:
        """Give a vehicle a known pose; covariance (3, 3) in the map frame (m², rad²).

        A vehicle in a frame of its own joins the map with all that it has mapped.
        """
        number = self._number(vehicle)
        known = checks.check_pose('pose', pose)
        spread = checks.check_motion_covariance('covariance', covariance)
        self._redrawer.complete_pending()
        if number in self._team.unlocalized:
            self._joining.at_pose(number, known, spread)
        else:
            self._restart_at(number, known, spread)

    def displace(self, vehicle: str, covariance: Array) -> None:
        """Record that a vehicle was moved unobserved; covariance (3, 3) of its pose, in its frame.

        A vehicle in a frame of its own remains there.
        """
        number = self._number(vehicle)
        spread = checks.check_motion_covariance('covariance', covariance)
        self._redrawer.complete_pending()
        self._restart_at(number, self.estimate(vehicle)[0], spread)

    def _restart_at(self, number: int, pose: Pose2, covariance: Array) -> None:
        """Continue at a pose unrelated to the previous motion (kidnapped or repositioned)."""
        self._team.particles.restart(number, np.asarray(pose), rotated(covariance, pose.theta))
        self._relocalization.reset(number)
        if self.joint is not None:
            self.joint.restart(number, pose, covariance)
        self._team.has_motion[number] = True

    def restart_clock(self, vehicle: str) -> None:
        """Reset the vehicle's clock: its next update may have any stamp."""
        self._team.stamps[self._number(vehicle)] = -np.inf

    # -- update ---------------------------------------------------------------------------------

    def update(self, vehicle: str, observations: LandmarkObservations) -> UpdateSummary:
        """Update with landmark observations of a vehicle at its current pose.

        A redraw that is running in another thread is completed first, see `PathRedrawer`.

        The numbers of the steps are those of the paper's algorithm. Engine paper samples poses
        (2.1) before the association and resamples (5) at the end, once all vehicles have updated;
        engine fastslam2 resamples and samples after it, from the proposal given the observations.

        If the observations contradict the particles, these are redrawn from the joint graph before
        the observations are used.

        Raises SlamError for no or too many observations, covariances that are not positive
        definite, descriptors of another kind, an unknown vehicle, a stamp before the last one, and
        an update before the first predict.
        """
        number = self._number(vehicle)
        self._check(number, observations)
        redrawn = self._redrawer.complete_pending()
        if self._engine.starts_new_round(number):
            self._end_round()

        what = f'update({vehicle!r}) at stamp {observations.stamp}'
        with self._rejecting(what):
            normals, state, proposal, P = self._associate(number, observations)
        if self._redrawer.is_contradicted(number, state, proposal):
            replacement = self._redrawer.draw([number])
            if replacement is not None:
                state.discard()
                self._redrawer.replace_particles(replacement)
                redrawn = True
                with self._rejecting(what):
                    normals, state, proposal, P = self._associate(number, observations)
        found, group = state.found, self.groups.of(number)
        self._team.stamps[number] = observations.stamp
        # 2.6.2 importance weight
        group.reweight(proposal.log_likelihoods)
        effective, support = group.effective_particles(), state.support(group.weights())
        # 5 resample (fastslam2)
        resampled = self._resample_before_sampling(group, state, proposal)
        # 2.1 sample (fastslam2)
        predicted = proposal.poses.copy()
        poses = proposal.sample(normals)
        error, random = self.config.frame_error.covariance(), self._team.random
        vehicle_poses = without_frame_error(predicted, poses, P, error, random)
        self._team.particles.place(number, vehicle_poses, predicted, P)
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
        relocalization = self._relocalization.update(
            number, observations, found, agreed, committed.ids
        )
        redrawn |= self._redrawer.redraw_if_due(self.groups.of(number)) or relocalization.closed
        joined = self._joining.by_landmarks(number, observations)
        return UpdateSummary(
            stamp=observations.stamp,
            vehicle=vehicle,
            observed=len(observations),
            with_candidates=int(np.count_nonzero(found.has_similar())),
            associated=int(np.count_nonzero(matches >= 0)),
            inserted=committed.inserted,
            removed=len(committed.removed),
            effective_particles=effective,
            resampled=resampled,
            redrawn=redrawn,
            lost=relocalization.lost,
            relocated=relocalization.relocated,
            closed=relocalization.closed,
            retracted=relocalization.retracted,
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
        estimate, reach = self._team.estimate(number), self._relocalization.reach(number)
        hidden = self._team.hidden_landmarks(number)
        association = self.config.association
        found = find_candidates(self.map, observations, association, *estimate, reach, hidden)
        found = self._with_correlated_noise(number, observations.stamp, found)
        fused = self.map.fuse(found.entries, self.groups)
        try:
            poses, P = self._team.particles.propagate(number, self._team.random)
            poses = self._merge_groups(number, found, poses, P)
            group = self.groups.of(number)
            state = AssociationState(found, self.map.rows, group.tree)
            # 2.1 sample (paper), 2.4 gate, 2.5 descriptor; Gaussian proposal of the pose
            # (fastslam2)
            normals = stratified_normals(self._team.random, self.config.particles, 3)
            error = self.config.frame_error.covariance()
            total = P if error is None else P + error
            proposal = self._propose(state, poses, total, normals, group.log_weights)
            if self._leave_out_lone_matches(number, state, group, proposal):
                proposal = self._propose(state, poses, total, normals, group.log_weights)
        except FloatingPointError:
            for draw, entries in fused.items():
                self.map.defer(entries, draw, self.map.reference[entries])
            raise
        return normals, state, proposal, P

    def _with_correlated_noise(
        self, number: int, stamp: float, found: CandidateSet
    ) -> CandidateSet:
        """Return candidates with covariances inflated for repeated observations."""
        if not self._engine.redraws or not len(found.entries):
            return found
        nearest = found.candidates[:, 0]
        entries = np.full(len(found), -1, np.int64)
        entries[nearest >= 0] = found.entries[nearest[nearest >= 0]]
        factors = self._team.correlation.factors(number, stamp, entries, self.map.ids[entries])
        observed = found.observed
        return replace(found, observed=observed._replace(R=observed.R * factors[:, None]))

    def _check(self, number: int, observations: LandmarkObservations) -> None:
        most = self.config.association.maximum_observations
        checks.check_observations(observations, self.map.kind, most)
        checks.check_order(
            self.vehicles[number],
            observations.stamp,
            self._team.stamps[number],
            predicted=self._team.has_motion[number],
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

        arrays, random = self._team.particles.arrays, self._team.random
        return poses[self.groups.merge(group, others, likelihood, arrays, random)]

    def _propose(
        self, state: AssociationState, poses: Array, P: Array, normals: Array, log_weights: Array
    ) -> PoseProposal:
        """Return the proposal of the engine; nothing is staged if its numbers overflow."""
        proposal = self._engine.propose(state, poses, P, normals, log_weights)
        if not proposal.is_finite():
            state.discard()
        return proposal.checked()

    def _leave_out_lone_matches(
        self, number: int, state: AssociationState, group: Group, proposal: PoseProposal
    ) -> bool:
        """Leave out reacquired landmarks if these are too few; return whether any was left out."""
        if not self._engine.redraws or not len(state.found.entries):
            return False
        entries = state.found.entries
        ages = self._team.correlation.ages(number, entries, self.map.ids[entries])
        weights = normalized(group.log_weights + proposal.log_likelihoods)[1]
        fewer = without_lone_matches(state.found, state.support(weights), ages, self.map.kind.same)
        if fewer is None:
            return False
        state.restrict(fewer)
        return True

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
        ancestors = self._team.resample(group)
        state.follow(ancestors)
        proposal.follow(ancestors)
        return True

    def _record(self, number: int, state: AssociationState, committed: Committed) -> None:
        """Record an update in the joint graph: the associations of most of the weight.

        What the filter has taken for outliers counts as little in the graph, whose own kernel
        leaves them their pull: a look-alike seen at 1 m to a few mm outweighed all that was right.
        """
        if self.joint is None:
            return
        keyframe = self.joint.keyframe(number, self._team.estimate(number)[0])
        weights = state.robust_weights(self.groups.of(number).weights())
        self.joint.observe(keyframe, committed.ids, state.found.observed, weights)
        stamp, entries = self._team.stamps[number], self.map.entries_with(committed.ids)
        self._team.correlation.add(number, stamp, entries, committed.ids)
        if len(committed.removed):
            self.joint.graph.remove_landmarks(committed.removed)

    def redraw(self, vehicles: Sequence[int]) -> None:
        """Draw the paths of vehicles (numbers) anew from the posterior of the joint graph.

        All particles then have equal weights and no common ancestors; the rows of their landmarks
        are fused from the stored observations when they are next needed. Landmarks of which no
        observation is stored are removed.
        """
        self._team.required_joint()
        self._redrawer.complete_pending()
        replacement = self._redrawer.draw(vehicles)
        if replacement is None:
            names = [self.vehicles[number] for number in vehicles]
            raise SlamError(f'the joint graph of {names} has no definite optimum')
        self._redrawer.replace_particles(replacement)

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
            measured = self._inter_robot.without_repetition(number, target, observation)
            if measured is None:
                continue
            self._redrawer.complete_pending()
            what = f'observation of {observation.vehicle!r} at stamp {observation.stamp}'
            with self._rejecting(what):
                self._inter_robot.update(number, target, measured)

    # -- unknown start poses --------------------------------------------------------------------

    def is_in_map(self, vehicle: str) -> bool:
        """Return whether the poses of a vehicle are in the map, not in a frame of its own."""
        return self._number(vehicle) not in self._team.unlocalized

    def are_in_one_frame(self, one: str, other: str) -> bool:
        """Return whether the poses of two vehicles can be compared."""
        return one == other or (self.is_in_map(one) and self.is_in_map(other))

    def join(self, vehicle: str, frame: Pose2, closures: Sequence[RelativePose]) -> list[int]:
        """Take a vehicle that is in a frame of its own into the map, with all that it has mapped.

        frame: pose of its frame in the map, from which the optimization starts. closures: relative
        poses of its keyframes and those of vehicles in the map, which tie it from now on; see
        `close_loops`.
        """
        return self._joining.by_closures(self._number(vehicle), frame, closures)

    # -- loop closures --------------------------------------------------------------------------

    def pin(self, keyframe: int) -> None:
        """Keep a keyframe of `add_keyframe`, so that closures can be measured relative to it."""
        self._constraints.pin(keyframe)

    def unpin(self, keyframe: int) -> None:
        """Undo a `pin`."""
        self._constraints.unpin(keyframe)

    def close_loops(self, closures: Sequence[RelativePose]) -> list[int]:
        """Record relative poses of keyframes; return the number of each.

        The numbers are for `retract_closure` and `drop_closure`. The paths are redrawn, in a
        large graph beside the caller, if a closure differs from the estimate by more than is
        expected or the last redraw was some keyframes ago, otherwise with later closures. Groups
        of vehicles that a closure ties together are merged.
        """
        return self._constraints.close(closures)

    def retract_closure(self, number: int) -> None:
        """Remove a closure that has turned out to be wrong."""
        self._constraints.retract(number)

    def drop_closure(self, number: int) -> None:
        """Drop a closure that repeats others; the path stays where it is."""
        self._constraints.drop(number)

    def closure_distances(self) -> dict[int, float]:
        """Return the squared Mahalanobis distance of every closure from the path, by number."""
        return self._constraints.distances()

    def relative_covariance(
        self, reference: int, keyframes: Places, *, keep: bool = True
    ) -> Array:
        """Return covariances (n, 3, 3) of keyframes' poses in the frame of a reference.

        They are those of the components of the relative poses, in the axes of the reference.
        keep: see RelativeCovariances.
        """
        return self._constraints.relative_covariance(reference, keyframes, keep=keep)

    @property
    def redraws(self) -> int:
        """How often paths were drawn; 0 without a joint graph."""
        return 0 if self.joint is None else self.joint.draws

    @contextmanager
    def _rejecting(self, what: str) -> Iterator[None]:
        """Turn an overflow into a SlamError, and restore the random generator."""
        random = self._team.random.bit_generator.state
        try:
            yield
        except FloatingPointError as error:
            self._team.random.bit_generator.state = random
            raise SlamError(
                f'{what}: numbers overflow; the covariances of motion and observations differ by '
                'too many orders of magnitude'
            ) from error

    # -- resampling -----------------------------------------------------------------------------

    def _end_round(self) -> None:
        """Engine paper: resample, because all vehicles have weighted the particles (Eq. 7)."""
        (group,) = self.groups.all
        self._engine.end_round(group)
        self._team.resample(group)

    def resample_now(self, weights: Array | None = None) -> None:
        """Resample all groups by their weights, or by given normalized weights (M,)."""
        self._redrawer.complete_pending()
        for group in self.groups.all:
            self._team.resample(group, weights)

    # -- estimates ------------------------------------------------------------------------------

    def best_particle(self, vehicle: str | None = None) -> int:
        """Return the particle that serves as the estimate of a vehicle (default: the first).

        Engine paper: the one of largest weight (step 4). Engine fastslam2: the one with the most
        likely lineage, so that the best path seldom jumps.
        """
        return self._engine.best_particle(self._group(vehicle))

    def estimate(self, vehicle: str) -> tuple[Pose2, Array]:
        """Return mean and covariance (3, 3) of a pose in the map, predicted motion included."""
        return self._team.estimate(self._number(vehicle))

    def motion(
        self, vehicle: str, steps: Iterable[tuple[Pose2, Array | None]]
    ) -> tuple[Pose2, Array]:
        """Return mean and covariance (3, 3) of a motion that is not predicted yet.

        They are in the frame of the vehicle before it. steps: increments and their covariances as
        for `predict`, so that wheel odometry is corrected by the calibration.
        """
        return self._team.motion(self._number(vehicle), steps)

    def odometry_calibration(self, vehicle: str) -> tuple[Array, Array]:
        """Return mean (3,) and covariance (3, 3) of a vehicle's odometry calibration.

        Its parts are the scale errors of turning and of driving and the heading drift (rad/m) by
        which increments are corrected, see `particles.motion.calibrated`; zero where nothing is
        calibrated.
        """
        return self._team.calibration(self._number(vehicle))

    def best_pose(self, vehicle: str) -> Pose2:
        """Return the pose of a vehicle that its path ends at, predicted motion included.

        It is the mean if the particles are samples of the joint posterior, else that of the best
        particle.
        """
        return self._team.best_pose(self._number(vehicle))

    def particle_poses(self, vehicle: str) -> Array:
        """Return the poses (M, 3) of a vehicle in all particles, predicted motion included."""
        return self._team.particles.predicted(self._number(vehicle))

    def weights(self, vehicle: str | None = None) -> Array:
        """Return the normalized weights (M,) of the particles of a vehicle (else of the first)."""
        return self._group(vehicle).weights()

    def effective_particles(self) -> float:
        """Return the effective sample size, 1 to M: the smallest of all groups of vehicles."""
        return min(group.effective_particles() for group in self.groups.all)

    def landmarks(self) -> Landmarks:
        """Return the landmarks of the best particle that lie in the map."""
        found = self.map.of_particle(self._team.best_particles(), self.groups)
        return (
            found.only(~np.isin(found.owners, list(self._team.unlocalized)))
            if self._team.unlocalized
            else found
        )

    # -- path -----------------------------------------------------------------------------------

    def add_keyframe(self, vehicle: str, stamp: float) -> int:
        """Append the current pose of a vehicle, in all particles, to the path.

        Returns its number, counted 0, 1, 2 … over all vehicles.
        """
        number = self._number(vehicle)
        if not math.isfinite(stamp):
            raise SlamError(f'add_keyframe({vehicle!r}): stamp is {stamp}, expected seconds')
        if self.joint is not None:
            if self.joint.has_moved(number):
                self._redrawer.complete_pending()
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
        return self.path.of_particle(self._team.best_particles())

    def keyframes_of(self, vehicle: str) -> Places:
        """Return the numbers of a vehicle's keyframes, ascending."""
        return self.path.of_vehicle(self._number(vehicle))

    def keyframes_in_map(self) -> NDArray[np.bool_]:
        """Return (K,) which keyframes are of vehicles whose poses are in the map."""
        return ~np.isin(np.array(self.path.vehicles, np.int64), list(self._team.unlocalized))

    def trajectory(self, vehicle: str) -> tuple[Array, Array]:
        """Return stamps (T,) and poses (T, 3) of a vehicle's keyframes on the most likely path."""
        chosen = self.path.of_vehicle(self._number(vehicle))
        return np.array(self.path.stamps)[chosen], self.best_path()[chosen]

    # -- state ----------------------------------------------------------------------------------

    def state_dict(self) -> State:
        """See Checkpointed. A redraw that is running is completed first."""
        self._redrawer.complete_pending()
        about = {
            'settings': values_of(self.config),
            'vehicles': list(self.vehicles),
            'unlocalized': sorted(self._team.unlocalized),
            'random': self._team.random.bit_generator.state,
        }
        state: State = {
            'about': text_array(about),
            **self._team.state_dict(),
            **under('manager', self._manager.state_dict()),
            **self._relocalization.state_dict(),
            **self._joining.state_dict(),
        }
        return {name: np.array(value) for name, value in state.items()}

    @classmethod
    def from_state(cls, state: State) -> Self:
        """See Checkpointed."""
        try:
            about = text_value(state['about'])
            starts = dict.fromkeys(about['vehicles'], IDENTITY)
            slam = cls(starts, with_values(FastSlamConfig(), about['settings']))
            slam._team.unlocalized = set(about['unlocalized'])
            slam._team.random.bit_generator.state = about['random']
            slam._team.restore(state)
            slam._manager.restore(part('manager', state))
            slam._relocalization.restore(state)
            slam._joining.restore(state)
        except (KeyError, ValueError, IndexError, TypeError) as error:
            raise SlamError(f'the saved state of the filter is incomplete: {error!r}') from error
        return slam

    def _group(self, vehicle: str | None) -> Group:
        return self.groups.of(0 if vehicle is None else self._number(vehicle))

    def _number(self, vehicle: str) -> int:
        try:
            return self._numbers[vehicle]
        except (KeyError, TypeError):
            raise SlamError(
                f'there is no vehicle {vehicle!r}, expected one of {list(self.vehicles)}'
            ) from None
