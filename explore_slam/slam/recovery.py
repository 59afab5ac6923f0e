"""Recovery of lost vehicles: noticed by what they observe, restarted where the map fits."""

import math

import numpy as np
from numpy.typing import NDArray

from explore_slam.geometry import Array, Pose2, compose, rotated
from explore_slam.slam.association.state import CandidateSet
from explore_slam.slam.checkpoint import State, part, under
from explore_slam.slam.particles.resampling import mean_and_covariance
from explore_slam.slam.relocalization import Relocalized, Relocalizer
from explore_slam.slam.storage.row_format import COVARIANCE, Places
from explore_slam.slam.team_state import TeamState


class Recovery:
    """Relocalizers of all vehicles, and the restart of those that they find."""

    def __init__(self, team: TeamState) -> None:
        self._team = team
        config = team.config.relocalization
        self._relocalizers = [Relocalizer(config) for _ in team.vehicles]

    def predict(self, number: int, increment: Pose2) -> None:
        """Propagate a vehicle by an odometry increment."""
        self._relocalizers[number].predict(increment)

    def reach(self, number: int) -> float:
        """Return the distance (m) from its pose within which a vehicle's landmarks may lie."""
        return self._relocalizers[number].reach

    def reset(self, number: int) -> None:
        """Forget what a vehicle observed: its pose is given anew."""
        self._relocalizers[number].reset()

    def update(
        self, number: int, found: CandidateSet, agreed: NDArray[np.bool_]
    ) -> tuple[bool, bool]:
        """Note what was matched; return whether the vehicle is lost, and whether it was found.

        agreed (K,): observations that most of the particles associate.
        """
        team = self._team
        relocalizer, R = self._relocalizers[number], found.measured.R
        deviations = np.sqrt(0.5 * (R[:, 0] + R[:, 3]))
        similar = np.where(found.is_distinctive[:, None], found.similar_ids, -1)
        relocalizer.add(found.observed.z, deviations, similar, agreed)
        wanted = team.config.relocalization.relocalization and team.engine.relocalizes
        if not wanted or not relocalizer.is_lost:
            return relocalizer.is_lost, False
        positions = team.map.positions(
            relocalizer.similar_ids(), team.best_particles(), team.groups
        )
        pose = relocalizer.search(positions, team.best_pose(number), team.random)
        if pose is None:
            return True, False
        self._restart(number, pose)
        return True, True

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
        return state

    def restore(self, state: State) -> None:
        """Restore what `state_dict` returned."""
        for number, relocalizer in enumerate(self._relocalizers):
            relocalizer.restore(part(f'relocalizer{number}', state))
