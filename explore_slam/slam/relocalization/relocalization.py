"""Detect lost vehicles and relocalize them in the map.

If drift may explain the new pose, the vehicle has closed a loop: the observations become part of
the joint graph, which corrects the whole path. If another closure contradicts it that drift
explains less well, as where two rooms look the same, that one is retracted. Otherwise the vehicle
was moved, its wheels slipped, or it had been placed wrongly: it is restarted at the new pose,
unrelated to the path before.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import LandmarkObservations
from explore_slam.errors import SlamError
from explore_slam.geometry import Array, Pose2, compose, rotated, to_world, wrap_angle
from explore_slam.slam.association.candidates import find_candidates
from explore_slam.slam.association.state import CandidateSet, Observed
from explore_slam.slam.checkpoint import State, part, under
from explore_slam.slam.particles.resampling import mean_and_covariance
from explore_slam.slam.posterior.joint_posterior import JointPosterior
from explore_slam.slam.posterior.redrawing import PathRedrawer
from explore_slam.slam.relocalization.landmark_closures import (
    LandmarkClosure,
    LandmarkClosures,
    Separation,
    separate,
)
from explore_slam.slam.relocalization.landmark_loops import LandmarkLoops
from explore_slam.slam.relocalization.relocalizer import RelocalizedPose, Relocalizer
from explore_slam.slam.storage.row_format import COVARIANCE, Places
from explore_slam.slam.team_state import TeamState

# Drift may explain a pose within 8 standard deviations of the estimate (squared Mahalanobis
# distance). Before a first loop is closed, the standard deviations can be too small by a factor of
# two or three (8 is 3 sigma times 2.7): odometry may turn 5 to 10 % too far without any indication
# (test_landmark_loops).
_PLAUSIBLE = 64.0
# A closure is retracted in favour of another one if drift explains it less well by this squared
# Mahalanobis distance, a likelihood ratio of 100.
_LESS_PLAUSIBLE = 9.2
# Closures that may be the wrong one: the newest of this vehicle, since older ones are held by it,
# and of another one. Each is tried: an optimization of the graph, and another to undo it.
_RIVALS = 2
# Chosen by hand; `benchmarks/relocalization.py` and test_landmark_loops show what a change does.
# Distance (m, rad) of the corrected pose from the relocalized one that is tolerated beside its
# standard deviation: the joint graph weighs the pose against all other observations.
_POSITION, _HEADING = 0.3, 0.1
# Squared Mahalanobis distance beyond which a pose contradicts one that a vehicle was given and no
# landmark has confirmed: 95 % of the chi-square distribution with 3 degrees of freedom. A loop
# would make them a compromise, which is neither.
_CONTRADICTED = 7.81
# m: a vehicle is not restarted at a pose that is more uncertain, but searched for further; chosen
# by hand, below the distance between two rooms.
_RESTART_DEVIATION = 0.5
_GATE = 3.0  # sigma, within which an observation is associated with a landmark
# m: errors that the covariances of observation and landmark do not model
_MINIMUM_DEVIATION = 0.05


class RelocalizationResult(NamedTuple):
    """Whether a vehicle is lost, was given another pose, and whether that closed a loop.

    retracted: whether a closure was retracted because it contradicts this one.
    """

    lost: bool
    relocated: bool
    closed: bool
    retracted: bool = False


class _Loop(NamedTuple):
    """Observations of a vehicle, by number, at a keyframe of the joint graph, that close a loop.

    ids (K,): landmarks that they show at the pose, or -1; recorded (K,): those under which the
    graph has recorded them, or -1.
    """

    number: int
    keyframe: int
    observed: Observed
    ids: Places
    recorded: Places
    pose: RelocalizedPose


class Relocalization:
    """Searches for the poses of lost vehicles, and corrects or restarts them."""

    def __init__(self, team: TeamState, redrawer: PathRedrawer) -> None:
        self._team = team
        self._redrawer = redrawer
        config = team.config.relocalization
        self._relocalizers = [Relocalizer(config) for _ in team.vehicles]
        self._loops = [LandmarkLoops(config) for _ in team.vehicles]
        self._closures = LandmarkClosures()

    def predict(self, number: int, increment: Pose2) -> None:
        """Propagate a vehicle by an odometry increment."""
        self._relocalizers[number].predict(increment)
        self._loops[number].predict(increment)

    def reach(self, number: int) -> float:
        """Return how far (m) from its estimated pose a vehicle may be."""
        return self._relocalizers[number].reach

    def reset(self, number: int, *, placed: bool = True) -> None:
        """Discard the recent matches of a vehicle, because it was given another pose.

        placed: one that is unrelated to its path so far.
        """
        self._relocalizers[number].reset(placed=placed)
        self._loops[number].reset()

    def update(
        self,
        number: int,
        observations: LandmarkObservations,
        found: CandidateSet,
        agreed: NDArray[np.bool_],
        recorded: Places,
    ) -> RelocalizationResult:
        """Record the matches of an update; relocalize the vehicle if it is lost.

        agreed (K,): observations that most of the particles associate. recorded (K,): ids of the
        landmarks under which the joint graph has recorded them, or -1.
        """
        team = self._team
        relocalizer, R = self._relocalizers[number], found.measured.R
        deviations = np.sqrt(0.5 * (R[:, 0] + R[:, 3]))
        similar = np.where(found.is_distinctive[:, None], found.similar_ids, -1)
        relocalizer.add(found.observed.z, deviations, similar, agreed)
        enabled = team.config.relocalization.relocalization and team.engine.relocalizes
        if not enabled:
            return RelocalizationResult(relocalizer.is_lost, False, False)
        if not relocalizer.is_lost:
            outcome = self._search_loop(number, observations, recorded)
            self._note_closure(number, recorded)
            return outcome or RelocalizationResult(False, False, False)
        positions = team.map.positions(
            relocalizer.similar_ids(), team.best_particles(), team.groups
        )
        pose = relocalizer.search(positions, team.best_pose(number), team.random)
        if pose is None:
            return RelocalizationResult(True, False, False)
        outcome = None
        if not self._contradicts_placement(number, pose):
            outcome = self._close_loop(number, pose, positions, found, recorded)
        if outcome is None:
            return RelocalizationResult(True, self._restart(number, pose), False)
        return outcome._replace(lost=True)

    def _note_closure(self, number: int, recorded: Places) -> None:
        """Note which landmarks an update observes: a loop may be closed by data association.

        This comes after the search, which may contradict the closures noted so far.
        """
        team, loops = self._team, self._loops[number]
        known = recorded[recorded >= 0]
        if team.joint is None or not len(known):
            return
        keyframe = team.joint.keyframe(number, team.estimate(number)[0])
        closure = LandmarkClosure(number, keyframe, loops.first_recent, np.empty(0, np.int64))
        is_old = closure.are_old(known, team.map)
        self._closures.note(closure, is_old, loops.distance_driven)

    def _search_loop(
        self, number: int, observations: LandmarkObservations, recorded: Places
    ) -> RelocalizationResult | None:
        """Search for a loop among the older landmarks; return how one was closed, if any."""
        team, loops = self._team, self._loops[number]
        if team.joint is None or number in team.unlocalized:
            return None
        if not loops.is_due(recorded, team.map.next_id):
            return None
        hidden, foreign = loops.is_recent(team.map, number), team.hidden_landmarks(number)
        if foreign is not None:
            hidden |= foreign
        estimate, P = team.estimate(number)
        found = find_candidates(
            team.map, observations, team.config.association, estimate, P, math.inf, hidden
        )
        positions = team.map.positions(loops.add(found), team.best_particles(), team.groups)
        pose = loops.search(positions, estimate, team.random)
        if pose is None:
            return None
        if self._contradicts_placement(number, pose):
            return RelocalizationResult(False, self._restart(number, pose), False)
        return self._close_loop(number, pose, positions, found, recorded)

    def _contradicts_placement(self, number: int, pose: RelocalizedPose) -> bool:
        """Return whether a vehicle was given another pose, which no landmark has confirmed."""
        team, joint = self._team, self._team.joint
        if joint is None or not self._relocalizers[number].is_placed:
            return False
        keyframe = joint.keyframe(number, team.estimate(number)[0])
        return self._squared_distance(keyframe, pose) > _CONTRADICTED

    def _close_loop(
        self,
        number: int,
        pose: RelocalizedPose,
        positions: dict[int, Array],
        found: CandidateSet,
        recorded: Places,
    ) -> RelocalizationResult | None:
        """Close a loop at the relocalized pose; return None if the path cannot agree with it.

        A closure that contradicts the pose may be retracted. If the pose contradicts the motion or
        other observations, nothing changes.
        """
        team, joint = self._team, self._team.joint
        if joint is None:
            return None
        keyframe = joint.keyframe(number, team.estimate(number)[0])
        ids = _associated_at(pose, positions, found)
        stored = np.diff(joint.graph.observations_of(np.maximum(ids, 0)).first) > 0
        ids[~stored | np.isin(ids, recorded)] = -1
        if not (ids >= 0).any():
            return None
        loop = _Loop(number, keyframe, found.observed, ids, recorded, pose)
        if self._squared_distance(keyframe, pose) < _PLAUSIBLE:
            saved = _saved(joint)
            if self._enter(loop):
                return RelocalizationResult(False, True, True)
            joint.restore(saved)
        retracted = self._enter_instead(loop)
        return RelocalizationResult(False, True, True, retracted=True) if retracted else None

    def _enter(self, loop: _Loop, separation: Separation | None = None) -> bool:
        """Record a loop and redraw the particles; return whether the path agrees with it.

        separation: of a closure that is retracted. If the path does not agree, the joint graph has
        changed all the same, and only the graph.
        """
        team, joint, number = self._team, self._team.required_joint(), loop.number
        deviations = loop.pose.deviations()
        try:
            merged = joint.observe_with_initial_pose(
                loop.keyframe,
                loop.ids,
                loop.recorded,
                loop.observed,
                loop.pose.pose,
                np.diag(deviations**2),
            )
            replacement = self._redrawer.draw([number])
        except SlamError:
            replacement = None
        off = np.abs(_pose_difference(joint.graph.estimate(loop.keyframe), loop.pose.pose))
        limits = _GATE * deviations + (_POSITION, _POSITION, _HEADING)
        if replacement is None or (off > limits).any():
            return False
        if separation is not None:
            separation.add_copies(team.map, team.groups.of(number).tree)
        self._redrawer.replace_particles(replacement)
        stamp, entries = team.stamps[number], team.map.entries_with(loop.ids)
        team.correlation.add(number, stamp, entries, loop.ids)
        loops = self._loops[number]
        self._closures.add(
            LandmarkClosure(number, loop.keyframe, loops.first_recent, merged),
            loops.distance_driven,
        )
        self.reset(number, placed=False)
        return True

    def _enter_instead(self, loop: _Loop) -> bool:
        """Record a loop in place of an earlier one that contradicts it; return whether it was.

        Both cannot be right if the path can agree with either but not with both. The one that
        drift explains less well is taken to be wrong, if the difference is clear. Otherwise
        nothing changes.
        """
        joint = self._team.required_joint()
        rivals = self._closures.newest(loop.number, joint.graph.tied(loop.number))
        for closure in rivals[:_RIVALS]:
            saved = _saved(joint)
            if self._replaces(loop, closure):
                self._closures.retract(closure)
                return True
            joint.restore(saved)
        return False

    def _replaces(self, loop: _Loop, closure: LandmarkClosure) -> bool:
        """Return whether a loop enters once a closure is retracted; changes the graph anyway."""
        team, joint = self._team, self._team.required_joint()
        graph = joint.graph
        keyframe = closure.live_keyframe(graph)
        separation = separate(graph, team.map, closure)
        if keyframe is None or not len(separation.landmarks):
            return False
        before, (ids, places) = graph.estimate(keyframe), graph.landmarks()
        try:
            graph.optimize(loop.number)
        except SlamError:
            return False
        off = graph.estimate(keyframe) - before
        off[2] = wrap_angle(float(off[2]))
        contradicted = off @ np.linalg.solve(graph.covariance(keyframe), off)
        pose = loop.pose.moved(ids, places, *graph.landmarks())
        distance = self._squared_distance(loop.keyframe, pose)
        if distance >= _PLAUSIBLE or contradicted < distance + _LESS_PLAUSIBLE:
            return False
        renamed = loop._replace(recorded=separation.renamed(loop.recorded), pose=pose)
        return self._enter(renamed, separation)

    def _squared_distance(self, keyframe: int, pose: RelocalizedPose) -> float:
        """Return the squared Mahalanobis distance of a relocalized pose from the estimate.

        Drift may explain it below `_PLAUSIBLE`.
        """
        graph = self._team.required_joint().graph
        P = graph.covariance(keyframe) + np.diag(pose.deviations() ** 2)
        off = _pose_difference(graph.estimate(keyframe), pose.pose)
        return float(off @ np.linalg.solve(P, off))

    def _restart(self, number: int, found: RelocalizedPose) -> bool:
        """Place a vehicle at the relocalized pose, in each particle relative to its own map.

        The particles differ in the positions of the landmarks. The pose is relative to these, so
        that it inherits their uncertainty. Returns False, and changes nothing, if the pose is too
        uncertain.
        """
        if found.position_deviation > _RESTART_DEVIATION:
            return False
        team = self._team
        P = np.diag(found.deviations() ** 2)
        moves = self._moves_of(team.map.entries_with(found.ids), found.pose)
        poses = compose(np.asarray(found.pose), moves)
        team.particles.restart(number, poses, P)
        self.reset(number)
        if team.joint is not None:
            mean, spread = mean_and_covariance(poses, team.groups.of(number).weights())
            team.joint.restart(number, mean, spread + rotated(P, -mean.theta))
        team.has_motion[number] = True
        return True

    def _moves_of(self, entries: Places, pose: Pose2) -> Array:
        """Return the motion (M, 3) of the landmarks of each particle relative to their mean.

        entries (n,): two landmarks or more. The motion is that of a rigid body, in the frame of a
        pose (least squares, for small angles).
        """
        self._team.map.fuse(entries, self._team.groups)
        rows = self._team.map.rows.read(entries)
        there = rows[:, COVARIANCE] > 0.0
        mean = (rows[:, :2] * there[:, None]).sum(axis=2)
        mean /= np.maximum(there.sum(axis=1), 1)[:, None]
        c, s = math.cos(pose.theta), math.sin(pose.theta)
        axes = np.array([[c, s], [-s, c]])  # rows: the axes of the frame, in the map
        place = (mean - [pose.x, pose.y]) @ axes.T
        off = np.where(there[:, None], rows[:, :2] - mean[:, :, None], 0.0)
        off = np.einsum('ab,nbm->nam', axes, off)
        centre, shift = place.mean(axis=0), off.mean(axis=0)
        arm = place - centre
        turned = (arm[:, :1] * off[:, 1] - arm[:, 1:] * off[:, 0]).sum(axis=0)
        turned /= max(float((arm**2).sum()), np.finfo(float).tiny)
        x = shift[0] + turned * centre[1]
        y = shift[1] - turned * centre[0]
        moves: Array = np.stack([x, y, turned], axis=1)
        return moves

    def state_dict(self) -> State:
        """Return the recent matches of each vehicle."""
        state: State = {}
        for number, relocalizer in enumerate(self._relocalizers):
            state |= under(f'relocalizer{number}', relocalizer.state_dict())
            state |= under(f'loops{number}', self._loops[number].state_dict())
        return state | under('landmark_closures', self._closures.state_dict())

    def restore(self, state: State) -> None:
        """Restore what `state_dict` returned."""
        for number, relocalizer in enumerate(self._relocalizers):
            relocalizer.restore(part(f'relocalizer{number}', state))
            self._loops[number].restore(part(f'loops{number}', state))
        self._closures.restore(part('landmark_closures', state))


def _saved(joint: JointPosterior) -> State:
    """Return a copy of the joint posterior, to restore it."""
    return {name: np.array(value) for name, value in joint.state_dict().items()}


def _pose_difference(estimate: Array, pose: Pose2) -> Array:
    """Return the difference (3,) of a pose from an estimate, in the axes of the map."""
    off = np.asarray(pose) - estimate
    off[2] = wrap_angle(float(off[2]))
    return off


def _associated_at(
    found: RelocalizedPose, positions: dict[int, Array], seen: CandidateSet
) -> Places:
    """Return the ids (K,) of the landmarks nearest to the observations at a pose, or -1.

    positions: see Relocalizer.search.
    """
    points = to_world(found.pose, seen.measured.z)[:, :2]
    R = seen.measured.R
    ids = np.full(len(seen), -1, np.int64)
    nearest = np.full(len(seen), np.inf)
    known = set(found.ids.tolist()) & positions.keys()
    for k in np.flatnonzero(seen.is_distinctive).tolist():
        for similar in set(seen.similar_ids[k].tolist()) & known:
            x, y, deviation = positions[similar]
            total = math.hypot(deviation, math.sqrt(0.5 * (R[k, 0] + R[k, 3])), _MINIMUM_DEVIATION)
            distance = math.hypot(points[k, 0] - x, points[k, 1] - y) / total
            if distance < min(_GATE, nearest[k]):
                ids[k], nearest[k] = similar, distance
    for similar in np.unique(ids[ids >= 0]).tolist():
        rivals = np.flatnonzero(ids == similar)
        ids[rivals[rivals != rivals[np.argmin(nearest[rivals])]]] = -1
    return ids
