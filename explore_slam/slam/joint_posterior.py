"""The filter's side of the joint graph: what is recorded, when it is due, what a redraw gives.

Resampling makes all particles descend from one ancestor some hundred keyframes back, and whatever
error that ancestor has is in nobody's covariance. Therefore raw motion and raw observations are
also recorded in one sparse graph, each exactly once, and when few ancestors are left all paths are
drawn anew from its posterior, with equal weights: the graph already contains what the weights
said. The particles are then samples of the joint posterior again (FastSLAM's factorization
p(paths) ∏ p(landmark | paths) stays; only how the paths are sampled changes).
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
from explore_slam.slam.graph import Draws, JointGraph, Problem, Solution
from explore_slam.slam.particles.group import Group
from explore_slam.slam.particles.joint_samples import JointSamples
from explore_slam.slam.particles.motion import PendingMotion, Segment
from explore_slam.slam.relative_covariance import RelativeCovariances
from explore_slam.slam.storage.row_format import Places

# Deviation (m, m, rad) that a motion has at least: a graph without it would be singular where
# odometry claims to be exact.
_LEAST_DEVIATIONS = np.array([1e-4, 1e-4, 1e-4])

# Deviations (m, m, rad) of a frame that is held by measurements alone: they weigh nothing beside
# closures, and keep the graph definite.
_LOOSE_DEVIATIONS = np.array([30.0, 30.0, 3.0])

# Closures wait for others until the last redraw is this many keyframes ago (more redraws change
# nothing: design study on the simulated office)
_BATCH = 8
_LEAST_INFORMATION = 1e-4  # of a closure in directions that it leaves free
_SURPRISE = 3.0  # squared Mahalanobis distance of one standard deviation in three dimensions

# Largest part of the particles for which own ancestors can be demanded, whatever the settings:
# right after a resampling 60 % have them, and more would call for redraws without end.
_MOST_ANCESTORS = 0.3
# Part of the samples whose descendants are left right after a draw: one resampling leaves about
# 60 % of them.
_FRESH = 0.5


@dataclass
class _Tail:
    """A vehicle since its newest keyframe in the graph: the motion, and whether it has moved."""

    keyframe: int = -1
    motion: PendingMotion = field(default_factory=PendingMotion)
    moved: bool = False


class Redraw(NamedTuple):
    """Samples for some vehicles: what the particles are replaced by.

    poses[v] (M, 3) of each vehicle at its newest keyframe, chains[v] (M, 3) where the motion since
    then begins, that motion, whether it is one, and the calibrations[v] (M, 3) of the odometry;
    landmarks:
    ids (L,) that the graph knows, and their positions (L, 3) given the most likely path.
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
    """Vehicles that are tied together: their problem, and what is wanted of its solution."""

    problem: Problem
    believed: list[int]  # closures that are new
    keyframes: Places  # whose poses are drawn, ascending
    newest: Places  # of each vehicle, ascending


class Snapshot(NamedTuple):
    """The joint graph of some vehicles at a moment."""

    vehicles: list[int]
    parts: list[_Part]

    @property
    def factors(self) -> int:
        """Number of measurements, which what a redraw takes grows with."""
        return sum(len(tied.problem.factors.kind) for tied in self.parts)


class Drawn(NamedTuple):
    """The optimum of vehicles that are tied together, and samples around it."""

    solution: Solution
    draws: Draws


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
        self._tails = [_Tail() for _ in starts]
        self._next = 0
        self._redrawn_at = 0  # number of the next keyframe at the last redraw
        # closures that have not been part of an optimum yet, and a vehicle of each
        self._believed: dict[int, int] = {}
        self.relative_covariance = RelativeCovariances(self.graph)
        self.calibrations = np.zeros((len(starts), 3))
        for vehicle, pose in enumerate(starts):
            self.graph.add_start(vehicle, self._next, np.asarray(pose))
            if config.calibration.odometry_calibration:
                self.graph.add_calibration(vehicle, config.calibration.deviations())
            self._tails[vehicle].keyframe = self._next
            self._next += 1

    # -- recording ------------------------------------------------------------------------------

    def predict(self, vehicle: int, step: Segment, white: Array) -> None:
        """Append an odometry increment; white (3, 3): see FastSlam.predict."""
        tail = self._tails[vehicle]
        tail.motion.append(step, self.config.linearizable_heading)
        if step.is_motion():
            tail.motion.white = white
            tail.moved = True

    def check_motion(self, vehicle: int) -> None:
        """Raise FloatingPointError if the motion since the newest keyframe has overflown."""
        if not all(np.isfinite(part).all() for part in self._tails[vehicle].motion.total()):
            raise FloatingPointError('a motion is not finite')

    def keyframe(self, vehicle: int, estimate: Pose2) -> int:
        """Return the graph's keyframe at the current pose; a new one if the vehicle has moved.

        estimate: mean pose of the filter, used until the graph is next optimized.
        """
        tail = self._tails[vehicle]
        if tail.moved:
            motion = tail.motion.total()
            self.graph.add_keyframe(
                vehicle,
                self._next,
                np.asarray(motion.mean) - motion.offset,
                motion.covariance + np.diag(_LEAST_DEVIATIONS**2),
                self._white(tail.motion.white),
                estimate=np.asarray(estimate),
                sensitivity=motion.sensitivity,
            )
            self._tails[vehicle] = _Tail(self._next)
            self._next += 1
        return self._tails[vehicle].keyframe

    def _white(self, motion: Array) -> Array | None:
        """Return the white error (3, 3) of a keyframe: those of its motion and its frame."""
        frame = self.config.frame_error.covariance()
        if frame is not None:
            return motion + frame
        return motion if motion.any() else None

    def observe(self, keyframe: int, ids: Places, observed: Observed) -> None:
        """Record observations (K,) of landmarks by id, -1 where there is none, at a keyframe."""
        known = ids >= 0
        if known.any():
            self.graph.add_observations(keyframe, ids[known], observed.z[known], observed.R[known])

    def observe_far_off(
        self,
        keyframe: int,
        ids: Places,
        recorded: Places,
        observed: Observed,
        pose: Pose2,
        covariance: Array,
    ) -> None:
        """Record observations, as `observe`, that lead a keyframe to another pose.

        recorded (K,): ids of landmarks that they have been recorded of already, or -1; these are
        the same as the others.
        pose, covariance (3, 3) in the map: where they lead. The estimate is brought there first:
        from where it is, a robust kernel takes them for outliers, however many agree.
        """
        again = (ids >= 0) & (recorded >= 0)
        _, first = np.unique(recorded[again], return_index=True)
        self.graph.merge_landmarks(recorded[again][first], ids[again][first])
        self.observe(keyframe, np.where(again, -1, ids), observed)
        factor = self.graph.add_prior(keyframe, np.asarray(pose), covariance)
        vehicle = int(self.graph.vehicles_of([keyframe])[0])
        try:
            self.graph.adopt(self.graph.solve(self.graph.snapshot(vehicle)))
        finally:
            self.graph.remove_factor(factor)

    def observe_vehicle(self, keyframe: int, of: int, observation: InterRobotObservation) -> None:
        """Record an observation, at a keyframe, of the vehicle that another keyframe is of."""
        self.graph.add_relative_position(
            keyframe, of, observation.position, observation.covariance
        )

    def pin(self, keyframe: int) -> None:
        """Keep a keyframe as a variable, for closures that are still to be found."""
        self.graph.pin(keyframe)

    def unpin(self, keyframe: int) -> None:
        """Take back a `pin`."""
        self.graph.unpin(keyframe)

    def close(self, closure: RelativePose) -> int:
        """Record a closure between keyframes of the graph; return its factor.

        It is believed until the graph is next optimized, and robust from then on: from a start
        that is far off, a robust kernel takes new closures for outliers, however many agree.
        """
        factor = self.graph.add_relative_pose(
            closure.reference,
            closure.keyframe,
            np.asarray(closure.pose),
            closure.information,
            robust=False,
        )
        self._believed[factor] = int(self.graph.vehicles_of([closure.keyframe])[0])
        return factor

    def reopen(self, factor: int) -> None:
        """Take back a closure."""
        self.graph.remove_factor(factor)
        self._believed.pop(factor, None)

    def forget(self, factor: int) -> None:
        """Drop a closure of a place that others hold as well."""
        self.graph.forget_factor(factor)
        self._believed.pop(factor, None)

    def closure_distances(self) -> dict[int, float]:
        """Return the squared Mahalanobis distance of every closure at the estimate, by factor."""
        factors, distances = self.graph.closure_residuals()
        return dict(zip(factors.tolist(), distances.tolist(), strict=True))

    def is_closure_due(self, closures: Sequence[RelativePose]) -> bool:
        """Return whether closures call for a redraw at once, instead of with later ones.

        That is so when the last redraw is some keyframes ago, or when they move the estimate by
        more than its deviation.
        """
        if self._next - self._redrawn_at >= _BATCH:
            return True
        path = self.graph.path()
        for closure in closures:
            P = self.relative_covariance(closure.reference, np.array([closure.keyframe]))[0]
            P = P + np.linalg.inv(closure.information + _LEAST_INFORMATION * np.eye(3))
            expected = between(path[closure.reference], path[closure.keyframe])
            off = np.asarray(closure.pose) - expected
            off[2] = wrap_angle(off[2])
            if off @ np.linalg.solve(P, off) > _SURPRISE:
                return True
        return False

    def has_moved(self, vehicle: int) -> bool:
        """Return whether a keyframe at the present pose would be a new one."""
        return self._tails[vehicle].moved

    def restart(self, vehicle: int, pose: Pose2, covariance: Array) -> None:
        """Continue the path of a vehicle at a pose that its motion does not lead to."""
        self.graph.restart(vehicle, self._next, np.asarray(pose), covariance)
        self._tails[vehicle] = _Tail(self._next)
        self._next += 1

    def move(self, vehicles: Sequence[int], frame: Pose2) -> None:
        """Move vehicles to the map, in which the frame that they have been in has this pose.

        What ties them to the map is for the caller to record; their priors hold them loosely.
        """
        self.graph.move(vehicles, np.asarray(frame), _LOOSE_DEVIATIONS)
        self.relative_covariance.forget()

    def measure_pose(self, keyframe: int, pose: Pose2, covariance: Array) -> None:
        """Record a pose in the map, with its covariance (3, 3) there, known from elsewhere."""
        self.graph.add_prior(keyframe, np.asarray(pose), covariance)

    # -- drawing --------------------------------------------------------------------------------

    def first_samples(self) -> JointSamples:
        """Return the samples that the particles of a group are at the beginning."""
        self.draws += 1
        return JointSamples.of_start(self.draws - 1, self.config.particles)

    def is_fresh(self, group: Group) -> bool:
        """Return whether the particles of a group descend from most of the samples drawn last."""
        samples = min(samples.distinct() for samples in group.samples)
        return samples > _FRESH * self.config.particles

    def is_due(self, group: Group) -> bool:
        """Return whether the particles of a group no longer represent the posterior.

        That is the case if they descend from few of the samples drawn last, or if few of them are
        effective, because a loop was closed.
        """
        least = min(
            max(self.config.redraw_ancestors, self.config.redraw_part * self.config.particles),
            _MOST_ANCESTORS * self.config.particles,
        )
        if group.effective_particles() < self.config.redraw_effective * self.config.particles:
            return True
        return min(samples.distinct() for samples in group.samples) < least

    def snapshot(self, vehicles: Sequence[int]) -> Snapshot:
        """Return what paths are drawn from; of vehicles that are tied together, all are given.

        It shares nothing with what is recorded later, so that another thread may draw from it.
        """
        parts, done = list[_Part](), set[int]()
        for vehicle in vehicles:
            if vehicle in done:
                continue
            tied = self.graph.tied(vehicle)
            done |= tied
            newest = np.sort([self._tails[v].keyframe for v in tied])
            observing = self.graph.observing_keyframes(tied)
            parts.append(
                _Part(
                    self.graph.snapshot(vehicle),
                    [factor for factor, owner in self._believed.items() if owner in tied],
                    np.union1d(observing, newest),
                    newest,
                )
            )
        return Snapshot(list(vehicles), parts)

    def draw(self, snapshot: Snapshot, random: np.random.Generator) -> list[Drawn]:
        """Draw the paths in a snapshot anew; nothing that is recorded changes.

        SlamError if the graph has no definite optimum. Closures that are new become robust once
        they have been believed. Drawn is what the particles need: poses where landmarks were
        observed, and the newest ones.
        """
        drawn = []
        for tied in snapshot.parts:
            solution = self.graph.solve(tied.problem, tied.believed)
            draws = solution.draw(self.config.particles, random, tied.keyframes, tied.newest)
            if not (np.isfinite(draws.poses).all() and np.isfinite(draws.chains).all()):
                raise SlamError(f'samples of vehicles {tied.problem.vehicles} are not finite')
            drawn.append(Drawn(solution, draws))
        return drawn

    def adopt(self, snapshot: Snapshot, drawn: Sequence[Drawn]) -> Redraw:
        """Make the optimum of a snapshot the estimate, and return what the particles take over.

        No keyframe may have been added since, and no vehicle may have been restarted or moved.
        """
        members = snapshot.vehicles
        chains: dict[int, Array] = {}
        calibrations: dict[int, Array] = {}
        for solution, draws in drawn:
            self.graph.adopt(solution)
            for factor in solution.problem.made_robust:
                self._believed.pop(factor, None)
            self.relative_covariance.renew(solution.problem.vehicles[0])
            for v in solution.problem.vehicles:
                row = np.searchsorted(draws.ends, self._tails[v].keyframe)
                chains[v] = draws.chains[row].T.copy()
            calibrations |= {v: some.T for v, some in draws.calibrations.items()}
        for vehicle in members:
            self.calibrations[vehicle] = self.graph.calibration(vehicle)
        samples = self._samples(members, drawn)
        self.draws += 1
        self._redrawn_at = self._next
        # the nodes of a keyframe that observations belong to contain the error of its frame
        framed = self.config.frame_error.covariance() is not None
        return Redraw(
            members,
            samples,
            chains if framed else {v: samples.pose_of(self._tails[v].keyframe) for v in members},
            chains,
            {v: self._tails[v].motion.copy() for v in members},
            {v: self._tails[v].moved for v in members},
            calibrations,
            samples.ids,
            samples.fused_at_mean(samples.ids)[:, :3] if len(samples.ids) else np.empty((0, 3)),
        )

    def _samples(self, members: Sequence[int], drawn: Sequence[Drawn]) -> JointSamples:
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
        self.relative_covariance.forget()  # as in what is restored from the state
        state = under('graph', self.graph.state_dict())
        state['calibrations'] = self.calibrations
        state['counters'] = np.array([self.draws, self._next, self._redrawn_at], np.int64)
        state['believed'] = np.array(list(self._believed.items()), np.int64).reshape(-1, 2)
        state['tails'] = np.array([[t.keyframe, t.moved] for t in self._tails], np.int64)
        for vehicle, tail in enumerate(self._tails):
            state |= under(f'motion{vehicle}', tail.motion.state_dict())
        return state

    def restore(self, state: State) -> None:
        """Restore what `state_dict` returned, for the same vehicles and settings."""
        self.graph = JointGraph.from_state(part('graph', state), self.config.graph)
        self.relative_covariance = RelativeCovariances(self.graph)
        self._believed = dict(state['believed'].tolist())
        self.calibrations = state['calibrations'].copy()
        self.draws, self._next, self._redrawn_at = state['counters'].tolist()
        for vehicle, (keyframe, moved) in enumerate(state['tails'].tolist()):
            motion = PendingMotion()
            motion.restore(part(f'motion{vehicle}', state))
            self._tails[vehicle] = _Tail(keyframe, motion, bool(moved))
