"""Recovery of lost vehicles: noticed by what they observe, led to where the map fits.

If motion may have drifted so far, the vehicle has closed a loop: what it observes becomes part of
the joint graph, which leads the whole path there. If not, it was moved, or its wheels slipped: it
is restarted at the new pose, and nothing ties that to the path before.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import LandmarkObservations
from explore_slam.errors import SlamError
from explore_slam.geometry import Array, Pose2, compose, rotated, to_world, wrap_angle
from explore_slam.slam.association.candidates import find_candidates
from explore_slam.slam.association.state import CandidateSet
from explore_slam.slam.checkpoint import State, part, under
from explore_slam.slam.landmark_loops import LandmarkLoops
from explore_slam.slam.particles.resampling import mean_and_covariance
from explore_slam.slam.redrawing import Redrawing
from explore_slam.slam.relocalization import Relocalized, Relocalizer
from explore_slam.slam.storage.row_format import COVARIANCE, Places
from explore_slam.slam.team_state import TeamState

# A pose is one that motion may have led to if it lies within 8 standard deviations, as squared
# Mahalanobis distance. Where a loop has not been closed before, they can be too small by a factor
# of two or three: odometry turns 5 to 10 % too far, and nothing tells (test_landmark_loops).
_PLAUSIBLE = 64.0
# Beside their deviations, a loop that is closed may leave the pose by this from the one found.
_POSITION, _HEADING = 0.3, 0.1  # m, rad
_GATE = 3.0  # deviations (sigma) within which an observation is of a landmark
_LEAST_DEVIATION = 0.05  # m: of an observation from its landmark at the pose found


class Recovered(NamedTuple):
    """Whether a vehicle is lost, was given another pose, and whether that has closed a loop."""

    lost: bool
    relocated: bool
    closed: bool


class Recovery:
    """Relocalizers of all vehicles, and what becomes of those that they find."""

    def __init__(self, team: TeamState, redrawing: Redrawing) -> None:
        self._team = team
        self._redrawing = redrawing
        config = team.config.relocalization
        self._relocalizers = [Relocalizer(config) for _ in team.vehicles]
        self._loops = [LandmarkLoops(config) for _ in team.vehicles]

    def predict(self, number: int, increment: Pose2) -> None:
        """Propagate a vehicle by an odometry increment."""
        self._relocalizers[number].predict(increment)
        self._loops[number].predict(increment)

    def reach(self, number: int) -> float:
        """Return the distance (m) from its pose within which a vehicle's landmarks may lie."""
        return self._relocalizers[number].reach

    def reset(self, number: int) -> None:
        """Forget what a vehicle observed: its pose is given anew."""
        self._relocalizers[number].reset()
        self._loops[number].reset()

    def update(
        self,
        number: int,
        observations: LandmarkObservations,
        found: CandidateSet,
        agreed: NDArray[np.bool_],
        recorded: Places,
    ) -> Recovered:
        """Note what was matched; lead the vehicle to where it is found if it is lost.

        agreed (K,): observations that most of the particles associate. recorded (K,): ids of the
        landmarks that they are recorded of, or -1.
        """
        team = self._team
        relocalizer, R = self._relocalizers[number], found.measured.R
        deviations = np.sqrt(0.5 * (R[:, 0] + R[:, 3]))
        similar = np.where(found.is_distinctive[:, None], found.similar_ids, -1)
        relocalizer.add(found.observed.z, deviations, similar, agreed)
        wanted = team.config.relocalization.relocalization and team.engine.relocalizes
        if not wanted:
            return Recovered(relocalizer.is_lost, False, False)
        if not relocalizer.is_lost:
            closed = self._search_loop(number, observations, recorded)
            return Recovered(False, closed, closed)
        positions = team.map.positions(
            relocalizer.similar_ids(), team.best_particles(), team.groups
        )
        pose = relocalizer.search(positions, team.best_pose(number), team.random)
        if pose is None:
            return Recovered(True, False, False)
        closed = self._close_loop(number, pose, positions, found, recorded)
        if not closed:
            self._restart(number, pose)
        return Recovered(True, True, closed)

    def _search_loop(
        self, number: int, observations: LandmarkObservations, recorded: Places
    ) -> bool:
        """Search for a loop by landmarks that are not the latest; return whether one is closed."""
        team, loops = self._team, self._loops[number]
        if team.joint is None or number in team.apart:
            return False
        if not loops.is_due(recorded, team.map.next_id):
            return False
        hidden, apart = loops.latest(team.map, number), team.hidden_landmarks(number)
        if apart is not None:
            hidden |= apart
        estimate, P = team.estimate(number)
        found = find_candidates(
            team.map, observations, team.config.association, estimate, P, math.inf, hidden
        )
        positions = team.map.positions(loops.add(found), team.best_particles(), team.groups)
        pose = loops.search(positions, estimate, team.random)
        return pose is not None and self._close_loop(number, pose, positions, found, recorded)

    def _close_loop(
        self,
        number: int,
        pose: Relocalized,
        positions: dict[int, Array],
        found: CandidateSet,
        recorded: Places,
    ) -> bool:
        """Lead the path to the pose found by what is observed there; return whether it went there.

        If that contradicts the motion, or other observations, nothing is changed.
        """
        team, joint = self._team, self._team.joint
        if joint is None:
            return False
        keyframe = joint.keyframe(number, team.estimate(number)[0])
        ids = _observed_at(pose, positions, found)
        stored = np.diff(joint.graph.observations_of(np.maximum(ids, 0)).first) > 0
        ids[~stored | np.isin(ids, recorded)] = -1
        if not (ids >= 0).any() or not self._is_plausible(keyframe, pose):
            return False
        deviations = np.array([pose.position_deviation] * 2 + [pose.heading_deviation])
        saved = {name: np.array(value) for name, value in joint.state_dict().items()}
        try:
            joint.observe_far_off(
                keyframe, ids, recorded, found.observed, pose.pose, np.diag(deviations**2)
            )
            redraw = self._redrawing.draw([number])
        except SlamError:
            redraw = None
        off = np.abs(_off(joint.graph.estimate(keyframe), pose.pose))
        limits = _GATE * deviations + (_POSITION, _POSITION, _HEADING)
        if redraw is None or (off > limits).any():
            joint.restore(saved)
            return False
        self._redrawing.take(redraw)
        stamp, entries = team.stamps[number], team.map.entries_with(ids)
        team.correlation.add(number, stamp, entries, ids)
        self.reset(number)
        return True

    def _is_plausible(self, keyframe: int, pose: Relocalized) -> bool:
        """Return whether the motion may have led to where a vehicle was found."""
        team = self._team
        joint = team.required_joint()
        P = joint.graph.covariance(keyframe)
        P += np.diag([pose.position_deviation**2] * 2 + [pose.heading_deviation**2])
        off = _off(joint.graph.estimate(keyframe), pose.pose)
        return bool(off @ np.linalg.solve(P, off) < _PLAUSIBLE)

    def _restart(self, number: int, found: Relocalized) -> None:
        """Place a vehicle where it was relocalized, in each particle relative to its own map.

        The particles differ in where they have the landmarks; the common frame of these is no
        better known to the vehicle than to them.
        """
        team = self._team
        deviations = np.array([found.position_deviation] * 2 + [found.heading_deviation])
        P = np.diag(deviations**2)
        moves = self._moves_of(team.map.entries_with(found.ids), found.pose)
        poses = compose(np.asarray(found.pose), moves)
        team.particles.restart(number, poses, P)
        self.reset(number)
        if team.joint is not None:
            mean, spread = mean_and_covariance(poses, team.groups.of(number).weights())
            team.joint.restart(number, mean, spread + rotated(P, -mean.theta))
        team.has_motion[number] = True

    def _moves_of(self, entries: Places, pose: Pose2) -> Array:
        """Return how the landmarks of each particle are moved from their mean.

        entries (n,): two landmarks or more. The moves (M, 3) are those of a rigid body, in the
        frame of a pose (least squares, for small angles).
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
        center, shift = place.mean(axis=0), off.mean(axis=0)
        arm = place - center
        turned = (arm[:, :1] * off[:, 1] - arm[:, 1:] * off[:, 0]).sum(axis=0)
        turned /= max(float((arm**2).sum()), np.finfo(float).tiny)
        x = shift[0] + turned * center[1]
        y = shift[1] - turned * center[0]
        moves: Array = np.stack([x, y, turned], axis=1)
        return moves

    def state_dict(self) -> State:
        """Return what recent observations matched, for each vehicle."""
        state: State = {}
        for number, relocalizer in enumerate(self._relocalizers):
            state |= under(f'relocalizer{number}', relocalizer.state_dict())
            state |= under(f'loops{number}', self._loops[number].state_dict())
        return state

    def restore(self, state: State) -> None:
        """Restore what `state_dict` returned."""
        for number, relocalizer in enumerate(self._relocalizers):
            relocalizer.restore(part(f'relocalizer{number}', state))
            self._loops[number].restore(part(f'loops{number}', state))


def _off(estimate: Array, pose: Pose2) -> Array:
    """Return by how much (3,) a pose differs from an estimate, in the axes of the map."""
    off = np.asarray(pose) - estimate
    off[2] = wrap_angle(float(off[2]))
    return off


def _observed_at(found: Relocalized, positions: dict[int, Array], seen: CandidateSet) -> Places:
    """Return (K,) the ids of the landmarks that observations are of at the pose found, or -1.

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
            total = math.hypot(deviation, math.sqrt(0.5 * (R[k, 0] + R[k, 3])), _LEAST_DEVIATION)
            distance = math.hypot(points[k, 0] - x, points[k, 1] - y) / total
            if distance < min(_GATE, nearest[k]):
                ids[k], nearest[k] = similar, distance
    for similar in np.unique(ids[ids >= 0]).tolist():
        rivals = np.flatnonzero(ids == similar)
        ids[rivals[rivals != rivals[np.argmin(nearest[rivals])]]] = -1
    return ids
