"""The joint posterior of all paths, which the filter records to and redraws its particles from.

Resampling makes all particles descend from one ancestor some hundred keyframes back, and whatever
error that ancestor has is missing from every covariance. Therefore raw motion and raw observations
are also recorded in one sparse graph, each exactly once. When few ancestors are left, all paths
are sampled anew from its posterior, with equal weights, since the graph already contains the
observations that the weights came from. The particles are then samples of the joint posterior
again: FastSLAM's factorization p(paths) ∏ p(landmark | paths) remains, only the sampling of the
paths changes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from explore_slam.data import InterRobotObservation
from explore_slam.errors import SlamError
from explore_slam.geometry import Array, Pose2, between, wrap_angle
from explore_slam.slam.association.state import Observed
from explore_slam.slam.checkpoint import State, part, under
from explore_slam.slam.config import FastSlamConfig
from explore_slam.slam.graph import JointGraph, PoseSamples, Problem, Solution
from explore_slam.slam.particles.group import Group
from explore_slam.slam.particles.joint_samples import JointSamples
from explore_slam.slam.particles.motion import PendingMotion, Segment
from explore_slam.slam.posterior.relative_covariance import RelativeCovariances
from explore_slam.slam.storage.row_format import Places

# Minimum standard deviation (m, m, rad) of a motion: without it the graph would be singular where
# odometry claims to be exact. Far below the errors of any odometry.
_MINIMUM_DEVIATIONS = np.array([1e-4, 1e-4, 1e-4])

# Standard deviations (m, m, rad) of the prior of a frame that measurements tie to the map: wide
# enough to be negligible beside a closure, narrow enough to keep the graph definite.
_LOOSE_DEVIATIONS = np.array([30.0, 30.0, 3.0])

# Keyframes since the last redraw after which closures no longer wait for others: the first number,
# in a large graph one for every hundred of its keyframes. Each redraw optimizes all of them, which
# after half an hour kept a processor busy. Chosen by hand: more redraws hardly change the path. A
# change can be judged by `explore_slam benchmark consistency` and `benchmark endurance`.
_BATCH, _KEYFRAMES_PER_BATCH = 8, 100
_MINIMUM_INFORMATION = 1e-4  # 1/m², 1/rad²: of a closure in directions that it leaves free
_EXPECTED_D2 = 3.0  # expected squared Mahalanobis distance of a pose (chi-square, 3 dof)

# Largest part of the particles for which own ancestors can be demanded, whatever the settings:
# one resampling leaves about 60 % of them, and a threshold near that would call for a redraw after
# every resampling.
_MAXIMUM_ANCESTOR_FRACTION = 0.3
# Part of the samples that still have descendants as long as at most one resampling (about 60 %)
# has taken place since the draw.
_FRESH_FRACTION = 0.5


@dataclass
class _MotionSinceKeyframe:
    """Motion of a vehicle since its newest keyframe in the graph."""

    keyframe: int = -1
    motion: PendingMotion = field(default_factory=PendingMotion)
    moved: bool = False


class ParticleReplacement(NamedTuple):
    """Samples of the joint posterior that replace the particles of some vehicles.

    Per vehicle v: poses[v] (M, 3) at its newest keyframe; chains[v] (M, 3), where the motion since
    then begins; pending[v], that motion; moved[v], whether there is any; calibrations[v] (M, 3) of
    its odometry. ids (L,): landmarks of which the graph stores observations; positions (L, 3):
    theirs given the most likely path.
    """

    vehicles: list[int]
    samples: JointSamples
    poses: dict[int, Array]
    chains: dict[int, Array]
    pending: dict[int, PendingMotion]
    moved: dict[int, bool]
    calibrations: dict[int, Array]
    ids: Places
    positions: Array


class _Part(NamedTuple):
    """Vehicles that measurements tie together: their problem, and what to sample from it."""

    problem: Problem
    new_closures: list[int]  # factors that have no robust kernel yet
    keyframes: Places  # whose poses are sampled, ascending
    newest: Places  # of each vehicle, ascending


class Snapshot(NamedTuple):
    """A copy of the joint graph of some vehicles, to sample from."""

    vehicles: list[int]
    parts: list[_Part]

    @property
    def factors(self) -> int:
        """Number of measurements; the time of a redraw is proportional to it."""
        return sum(len(tied.problem.factors.kind) for tied in self.parts)


class PosteriorSamples(NamedTuple):
    """The optimum of vehicles that are tied together, and samples from the posterior there."""

    solution: Solution
    samples: PoseSamples


class RelativePose(NamedTuple):
    """A measured pose of one keyframe in the frame of another, as loop closing finds it.

    information (3, 3): of the components of the pose, in the axes of the reference.
    """

    reference: int
    keyframe: int
    pose: Pose2
    information: Array


class JointPosterior:
    """Records motion and observations of all vehicles, and draws joint samples of their paths."""

    def __init__(self, starts: Sequence[Pose2], config: FastSlamConfig) -> None:
        self.config = config
        self.graph = JointGraph(config.graph)
        self.draws = 0
        self._motions = [_MotionSinceKeyframe() for _ in starts]
        self._next = 0
        self._redrawn_at = 0  # number of the next keyframe at the last redraw
        # closures that have not been part of an optimum yet -> vehicle of each
        self._new_closures: dict[int, int] = {}
        self.tags = 0  # how many tags are nodes of the graph
        self.relative_covariance = RelativeCovariances(self.graph)
        self.calibrations = np.zeros((len(starts), 3))
        for vehicle, pose in enumerate(starts):
            self.graph.add_start(vehicle, self._next, np.asarray(pose))
            if config.calibration.odometry_calibration:
                self.graph.add_calibration(vehicle, config.calibration.deviations())
            self._motions[vehicle].keyframe = self._next
            self._next += 1

    # -- recording ------------------------------------------------------------------------------

    def predict(self, vehicle: int, step: Segment, white: Array) -> None:
        """Append an odometry increment; white (3, 3): see FastSlam.predict."""
        since = self._motions[vehicle]
        since.motion.append(step, self.config.linearizable_heading)
        if step.is_motion():
            since.motion.white = white
            since.moved = True

    def check_motion(self, vehicle: int) -> None:
        """Raise FloatingPointError if the motion since the newest keyframe has overflown."""
        if not all(np.isfinite(part).all() for part in self._motions[vehicle].motion.total()):
            raise FloatingPointError('a motion is not finite')

    def keyframe(self, vehicle: int, estimate: Pose2) -> int:
        """Return the graph's keyframe at the current pose; a new one if the vehicle has moved.

        estimate: mean pose of the filter, which is used until the next optimization.
        """
        since = self._motions[vehicle]
        if since.moved:
            motion = since.motion.total()
            self.graph.add_keyframe(
                vehicle,
                self._next,
                np.asarray(motion.mean) - motion.offset,
                motion.covariance + np.diag(_MINIMUM_DEVIATIONS**2),
                self._white(since.motion.white),
                estimate=np.asarray(estimate),
                sensitivity=motion.sensitivity,
            )
            self._motions[vehicle] = _MotionSinceKeyframe(self._next)
            self._next += 1
        return self._motions[vehicle].keyframe

    def _white(self, motion: Array) -> Array | None:
        """Return the white error (3, 3) of a keyframe: those of its motion and its frame."""
        frame = self.config.frame_error.covariance()
        if frame is not None:
            return motion + frame
        return motion if motion.any() else None

    def observe(
        self, keyframe: int, ids: Places, observed: Observed, weights: Array | None = None
    ) -> None:
        """Record observations (K,) of landmarks by id, -1 where there is none, at a keyframe.

        weights (K,) in (0, 1]: the part of its information that each counts with. Default: all.
        """
        known = ids >= 0
        if known.any():
            some = None if weights is None else weights[known]
            self.graph.add_observations(
                keyframe, ids[known], observed.z[known], observed.R[known], some
            )

    def observe_with_initial_pose(
        self,
        keyframe: int,
        ids: Places,
        recorded: Places,
        observed: Observed,
        pose: Pose2,
        covariance: Array,
    ) -> Places:
        """Record observations that contradict the estimate of a keyframe; see `observe`.

        The graph is first optimized with a prior at the pose that they imply: from the current
        estimate, the robust kernel would treat them as outliers, however many agree.

        recorded (K,): ids of the landmarks under which they have already been recorded, or -1;
        those landmarks are merged into `ids`.
        pose, covariance (3, 3): of the vehicle in the map, as implied by the observations.
        Returns the numbers (n,) of the observations of merged landmarks.
        """
        again = (ids >= 0) & (recorded >= 0)
        _, first = np.unique(recorded[again], return_index=True)
        merged = self.graph.observation_numbers(recorded[again])
        self.graph.merge_landmarks(recorded[again][first], ids[again][first])
        self.observe(keyframe, np.where(again, -1, ids), observed)
        factor = self.graph.add_prior(keyframe, np.asarray(pose), covariance)
        vehicle = int(self.graph.vehicles_of([keyframe])[0])
        try:
            self.graph.adopt(self.graph.solve(self.graph.snapshot(vehicle)))
        finally:
            self.graph.remove_factor(factor)
        return merged

    def observe_vehicle(self, keyframe: int, of: int, observation: InterRobotObservation) -> None:
        """Record an inter-robot observation; of: keyframe of the observed vehicle."""
        self.graph.add_relative_position(
            keyframe, of, observation.position, observation.covariance
        )

    def add_tag(self, keyframe: int, pose: Pose2) -> int:
        """Add a tag that was seen from a keyframe of the graph; return the node of the tag.

        pose: of the tag in the frame of the keyframe. To the graph a tag is a vehicle that never
        moves: its only keyframe is the pose of the tag.
        """
        node = self._next
        seen_at = Pose2.from_array(self.graph.estimate(keyframe)).compose(pose)
        covariance = np.diag(_LOOSE_DEVIATIONS**2)
        number = len(self._motions) + self.tags
        self.graph.add_start(number, node, np.asarray(seen_at), covariance)
        self.tags += 1
        self._next += 1
        return node

    def observe_tag(self, keyframe: int, tag: int, pose: Pose2, information: Array) -> int:
        """Record the pose of a tag, by its node, in the frame of a keyframe; return the factor.

        information (3, 3): of the components of the pose, zero where the heading is unknown.
        """
        return self.graph.add_relative_pose(keyframe, tag, np.asarray(pose), information)

    def vehicles_at(self, nodes: Sequence[int]) -> list[int]:
        """Return the vehicles of nodes of the graph; of a tag, those that have seen it."""
        numbers = self.graph.vehicles_of(nodes).tolist()
        return [
            vehicle
            for number in numbers
            for vehicle in ([number] if number < len(self._motions) else self._seen_by(number))
        ]

    def _seen_by(self, tag: int) -> list[int]:
        return sorted(self.vehicles_tied(tag))

    def vehicles_tied(self, number: int) -> set[int]:
        """Return the vehicles that measurements tie to one, or to a tag, by its number."""
        return {other for other in self.graph.tied(number) if other < len(self._motions)}

    def pin(self, keyframe: int) -> None:
        """Keep a keyframe as a variable of the graph, for closures yet to be found."""
        self.graph.pin(keyframe)

    def unpin(self, keyframe: int) -> None:
        """Undo a `pin`."""
        self.graph.unpin(keyframe)

    def close(self, closure: RelativePose) -> int:
        """Record a closure between keyframes of the graph; return its factor.

        It has no robust kernel until the next optimization: from an estimate that is far off, the
        kernel would treat new closures as outliers, however many agree.
        """
        factor = self.graph.add_relative_pose(
            closure.reference,
            closure.keyframe,
            np.asarray(closure.pose),
            closure.information,
            robust=False,
        )
        self._new_closures[factor] = int(self.graph.vehicles_of([closure.keyframe])[0])
        return factor

    def retract_closure(self, factor: int) -> None:
        """Remove a closure that has turned out to be wrong."""
        self.graph.remove_factor(factor)
        self._new_closures.pop(factor, None)

    def drop_closure(self, factor: int) -> None:
        """Drop a closure that repeats others; the path stays where it is."""
        self.graph.drop_factor(factor)
        self._new_closures.pop(factor, None)

    def closure_distances(self) -> dict[int, float]:
        """Return the squared Mahalanobis distance of every closure at the estimate, by factor."""
        factors, distances = self.graph.closure_residuals()
        return dict(zip(factors.tolist(), distances.tolist(), strict=True))

    def is_closure_due(self, closures: Sequence[RelativePose]) -> bool:
        """Return whether closures require a redraw now instead of together with later ones.

        They do if the last redraw was some keyframes ago, more in a large graph, or if a closure
        differs from the estimate by more than the expected squared Mahalanobis distance.
        """
        batch = max(_BATCH, len(self.graph.live_keyframes()) // _KEYFRAMES_PER_BATCH)
        if self._next - self._redrawn_at >= batch:
            return True
        path = self.graph.path()
        for closure in closures:
            P = self.relative_covariance(closure.reference, np.array([closure.keyframe]))[0]
            P = P + np.linalg.inv(closure.information + _MINIMUM_INFORMATION * np.eye(3))
            expected = between(path[closure.reference], path[closure.keyframe])
            off = np.asarray(closure.pose) - expected
            off[2] = wrap_angle(off[2])
            if off @ np.linalg.solve(P, off) > _EXPECTED_D2:
                return True
        return False

    def has_moved(self, vehicle: int) -> bool:
        """Return whether a vehicle has moved since its newest keyframe."""
        return self._motions[vehicle].moved

    def restart(self, vehicle: int, pose: Pose2, covariance: Array) -> None:
        """Continue the path of a vehicle at a pose unrelated to its previous motion."""
        self.graph.restart(vehicle, self._next, np.asarray(pose), covariance)
        self._motions[vehicle] = _MotionSinceKeyframe(self._next)
        self._next += 1

    def move(self, vehicles: Sequence[int], frame: Pose2) -> None:
        """Transform the paths of vehicles from a frame of their own into the map.

        frame: pose of that frame in the map. The priors become wide; the caller must record the
        measurements that tie the vehicles to the map. The tags that they have seen move along.
        """
        self.graph.move(self._with_tags(vehicles), np.asarray(frame), _LOOSE_DEVIATIONS)
        self.relative_covariance.invalidate()

    def move_map(self, vehicles: Sequence[int], frame: Pose2) -> None:
        """Transform the map with the paths of all vehicles in it into the frame of surveyed tags.

        frame: pose of the map's frame so far. Starts that were known exactly remain so relative to
        each other; the caller must record the poses of surveyed tags.
        """
        self.graph.move(self._with_tags(vehicles), np.asarray(frame), None)
        self.graph.release_starts(sorted(vehicles), _LOOSE_DEVIATIONS)
        self.relative_covariance.invalidate()

    def _with_tags(self, vehicles: Sequence[int]) -> list[int]:
        """Return vehicles and the tags that are tied to them, by number."""
        tied = {other for vehicle in vehicles for other in self.graph.tied(vehicle)}
        return sorted({*vehicles, *(other for other in tied if other >= len(self._motions))})

    def measure_pose(self, keyframe: int, pose: Pose2, covariance: Array) -> None:
        """Record the pose of a keyframe in the map, known with a covariance (3, 3) there."""
        self.graph.add_prior(keyframe, np.asarray(pose), covariance)

    # -- drawing --------------------------------------------------------------------------------

    def first_samples(self) -> JointSamples:
        """Return the samples that the particles of a group start as."""
        self.draws += 1
        return JointSamples.of_start(self.draws - 1, self.config.particles)

    def is_fresh(self, group: Group) -> bool:
        """Return whether the particles of a group descend from most of the samples drawn last."""
        samples = min(samples.distinct() for samples in group.samples)
        return samples > _FRESH_FRACTION * self.config.particles

    def is_due(self, group: Group) -> bool:
        """Return whether the particles of a group no longer represent the posterior.

        That is the case if they descend from few of the samples drawn last, or if the effective
        sample size is small because a loop was closed.
        """
        least = min(
            max(self.config.redraw_ancestors, self.config.redraw_fraction * self.config.particles),
            _MAXIMUM_ANCESTOR_FRACTION * self.config.particles,
        )
        if group.effective_particles() < self.config.redraw_effective * self.config.particles:
            return True
        return min(samples.distinct() for samples in group.samples) < least

    def snapshot(self, vehicles: Sequence[int]) -> Snapshot:
        """Return a copy of the graph of vehicles that `draw` samples paths from.

        vehicles: must include all that are tied to one of them. The copy shares nothing with the
        graph, so that another thread may sample from it.
        """
        parts, done = list[_Part](), set[int]()
        for vehicle in vehicles:
            if vehicle in done:
                continue
            tied = self.graph.tied(vehicle)
            done |= tied
            newest = np.sort([self._motions[v].keyframe for v in self.vehicles_tied(vehicle)])
            observing = self.graph.observing_keyframes(tied)
            parts.append(
                _Part(
                    self.graph.snapshot(vehicle),
                    [factor for factor, owner in self._new_closures.items() if owner in tied],
                    np.union1d(observing, newest),
                    newest,
                )
            )
        return Snapshot(list(vehicles), parts)

    def draw(
        self, snapshot: Snapshot, random: np.random.Generator, *, with_marginals: bool = False
    ) -> list[PosteriorSamples]:
        """Sample the paths in a snapshot; what is recorded does not change.

        Only what the particles need is sampled: the poses at which landmarks were observed, and
        the newest ones. New closures get their robust kernel after a first optimization.

        with_marginals: compute now what search windows ask for first, which takes about as long
        as the samples.

        Raises SlamError if the graph has no definite optimum.
        """
        drawn = []
        for tied in snapshot.parts:
            solution = self.graph.solve(tied.problem, tied.new_closures)
            draws = solution.draw(self.config.particles, random, tied.keyframes, tied.newest)
            if not (np.isfinite(draws.poses).all() and np.isfinite(draws.chains).all()):
                raise SlamError(f'samples of vehicles {tied.problem.vehicles} are not finite')
            if with_marginals:
                solution.compute_marginals()
            drawn.append(PosteriorSamples(solution, draws))
        return drawn

    def adopt(self, snapshot: Snapshot, drawn: Sequence[PosteriorSamples]) -> ParticleReplacement:
        """Make the optimum of a snapshot the estimate; return what replaces the particles.

        No keyframe may have been added since the snapshot, and no vehicle restarted or moved.
        """
        members = snapshot.vehicles
        chains: dict[int, Array] = {}
        calibrations: dict[int, Array] = {}
        for solution, draws in drawn:
            self.graph.adopt(solution)
            for factor in solution.problem.made_robust:
                self._new_closures.pop(factor, None)
            self.relative_covariance.renew(solution.problem.vehicles[0])
            for v in solution.problem.vehicles:
                if v >= len(self._motions):  # a tag
                    continue
                row = np.searchsorted(draws.ends, self._motions[v].keyframe)
                chains[v] = draws.chains[row].T.copy()
            calibrations |= {v: some.T for v, some in draws.calibrations.items()}
        for vehicle in members:
            self.calibrations[vehicle] = self.graph.calibration(vehicle)
        samples = self._samples(members, drawn)
        self.draws += 1
        self._redrawn_at = self._next
        # the nodes of a keyframe that observations belong to contain the error of its frame
        framed = self.config.frame_error.covariance() is not None
        return ParticleReplacement(
            members,
            samples,
            chains if framed else {v: samples.pose_of(self._motions[v].keyframe) for v in members},
            chains,
            {v: self._motions[v].motion.copy() for v in members},
            {v: self._motions[v].moved for v in members},
            calibrations,
            samples.ids,
            samples.fused_at_mean(samples.ids)[:, :3] if len(samples.ids) else np.empty((0, 3)),
        )

    def _samples(self, members: Sequence[int], drawn: Sequence[PosteriorSamples]) -> JointSamples:
        numbers = np.concatenate([draws.keyframes for _, draws in drawn])
        means = np.concatenate([found.poses_of(draws.keyframes) for found, draws in drawn])
        poses = np.concatenate([draws.poses for _, draws in drawn])
        order = np.argsort(numbers)
        ids, observations = self.graph.observations_from(members)
        return JointSamples(
            self.draws,
            numbers[order],
            means[order],
            poses[order],
            ids,
            observations,
            np.arange(self.config.particles, dtype=np.int32),
        )

    def path(self) -> Array:
        """Return the most likely poses (N, 3) of all keyframes, without errors of frames."""
        return self.graph.path(chains=self.config.frame_error.covariance() is not None)

    # -- state ----------------------------------------------------------------------------------

    def state_dict(self) -> State:
        """Return the graph and the motion since the newest keyframes."""
        self.relative_covariance.invalidate()  # as in what is restored from the state
        state = under('graph', self.graph.state_dict())
        state['calibrations'] = self.calibrations
        state['tags'] = np.array(self.tags)
        state['counters'] = np.array([self.draws, self._next, self._redrawn_at], np.int64)
        state['new_closures'] = np.array(list(self._new_closures.items()), np.int64).reshape(-1, 2)
        state['newest_keyframes'] = np.array(
            [[t.keyframe, t.moved] for t in self._motions], np.int64
        )
        for vehicle, since in enumerate(self._motions):
            state |= under(f'motion{vehicle}', since.motion.state_dict())
        return state

    def restore(self, state: State) -> None:
        """Restore what `state_dict` returned, for the same vehicles and settings."""
        self.graph = JointGraph.from_state(part('graph', state), self.config.graph)
        self.relative_covariance = RelativeCovariances(self.graph)
        self._new_closures = dict(state['new_closures'].tolist())
        self.calibrations = state['calibrations'].copy()
        self.tags = int(state.get('tags', np.array(0)))
        self.draws, self._next, self._redrawn_at = state['counters'].tolist()
        for vehicle, (keyframe, moved) in enumerate(state['newest_keyframes'].tolist()):
            motion = PendingMotion()
            motion.restore(part(f'motion{vehicle}', state))
            self._motions[vehicle] = _MotionSinceKeyframe(keyframe, motion, bool(moved))
