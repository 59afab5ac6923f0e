"""Poses, odometry calibrations and pending motions of all vehicles, in all particles."""

from collections.abc import Sequence

import numpy as np

from explore_slam.geometry import Array, Pose2, between, compose, rotated, wrap_angles
from explore_slam.slam.checkpoint import State, part, under
from explore_slam.slam.particles.group import Group
from explore_slam.slam.particles.motion import PendingMotion, Segment
from explore_slam.slam.particles.resampling import mean_and_covariance, systematic_ancestors
from explore_slam.slam.storage.ancestry import Index


class VehicleStates:
    """Poses at the last updates, and the motion since then, which no particle contains yet.

    arrays (V, M, 9), of every vehicle and particle: pose (x, y, theta), calibration of the
    odometry, and the measured pose at which the next motion begins (mean given the pose).
    pending: the motions (V).
    heading_limit (rad): see `PendingMotion`. white_errors: whether the
    independent errors of measured poses cancel in the next increment; otherwise they stay in the
    pose.
    """

    def __init__(
        self, starts: Sequence[Pose2], particles: int, heading_limit: float, *, white_errors: bool
    ) -> None:
        self.arrays = np.zeros((len(starts), particles, 9))
        self.arrays[:, :, :3] = np.array(starts, np.float64)[:, None, :]
        self.pending = [PendingMotion() for _ in starts]
        # (3, 3) in the vehicle frame, of where the next motion begins given the pose; None: there
        self._chain_covariances: list[Array | None] = [None] * len(starts)
        self._heading_limit = heading_limit
        self._white_errors = white_errors

    @property
    def poses(self) -> Array:
        """Poses (V, M, 3) at the last updates; a view."""
        return self.arrays[:, :, :3]

    @property
    def calibrations(self) -> Array:
        """Calibrations (V, M, 3) of the odometry; a view."""
        return self.arrays[:, :, 3:6]

    @property
    def chains(self) -> Array:
        """Measured poses (V, M, 3) at which the next motion begins; a view."""
        return self.arrays[:, :, 6:]

    def append(self, number: int, step: Segment, white: Array) -> None:
        """Append a step to the pending motion of a vehicle; white (3, 3): see FastSlam.predict."""
        if step.is_motion():
            self._leave_pose(number)
            self.pending[number].white = white
        self.pending[number].append(step, self._heading_limit)

    def _leave_pose(self, number: int) -> None:
        """Continue from where the motion begins, if the pose has been updated since."""
        covariance = self._chain_covariances[number]
        if covariance is not None:
            self.poses[number] = self.chains[number]
            self.pending[number] = PendingMotion.of(covariance)
            self._chain_covariances[number] = None

    def propagate(self, number: int, random: np.random.Generator) -> tuple[Array, Array]:
        """Return the predicted poses (M, 3) and their covariance (3, 3) in the vehicle frame."""
        return self.pending[number].propagate(
            self.poses[number].copy(), self.calibrations[number], self._heading_limit, random
        )

    def predicted(self, number: int) -> Array:
        """Return the mean predicted pose (M, 3) of a vehicle in each particle."""
        return self.pending[number].apply(self.poses[number], self.calibrations[number])

    def estimate(self, number: int, weights: Array) -> tuple[Pose2, Array]:
        """Return mean and covariance (3, 3) of a pose, predicted motion included."""
        mean, spread = mean_and_covariance(self.predicted(number), weights)
        spread += rotated(self.pending[number].end_covariance(), -mean.theta)
        return mean, 0.5 * (spread + spread.T)

    def calibration(self, number: int, weights: Array) -> tuple[Array, Array]:
        """Return mean (3,) and covariance (3, 3) of a vehicle's odometry calibration."""
        values = self.calibrations[number]
        mean = weights @ values
        off = values - mean
        return mean, (off * weights[:, None]).T @ off

    def place(
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
        W = self.pending[number].white
        left = np.zeros((3, 3)) if remaining is None else remaining
        if self._white_errors and W.any():
            gain = np.eye(3) - W @ np.linalg.inv(P)
            self.chains[number] = compose(predicted, between(predicted, poses) @ gain.T)
            spread = P - W - gain @ (P - left) @ gain.T
            self._chain_covariances[number] = 0.5 * (spread + spread.T)
        poses[:, 2] = wrap_angles(poses[:, 2])
        self.poses[number] = poses
        self.pending[number] = PendingMotion() if remaining is None else PendingMotion.of(left)

    def restart(self, number: int, poses: Array, covariance: Array) -> None:
        """Continue at poses (3,) or (M, 3) unrelated to the previous motion.

        covariance (3, 3): that the poses still have, in the vehicle frame.
        """
        self.poses[number] = poses
        self.pending[number] = PendingMotion.of(covariance)
        self._chain_covariances[number] = None

    def take(
        self, number: int, poses: Array, chains: Array, motion: PendingMotion, *, moved: bool
    ) -> None:
        """Replace the poses (M, 3) of a vehicle by samples at its newest keyframe.

        chains (M, 3): where the motion since then begins; moved: whether there is any.
        """
        self.poses[number] = poses
        self.chains[number] = chains
        self._chain_covariances[number] = np.zeros((3, 3))
        if moved:
            self._leave_pose(number)
        self.pending[number] = motion

    def resample(self, group: Group, weights: Array, random: np.random.Generator) -> Index:
        """Resample the particles of a group by normalized weights (M,); return the ancestors."""
        ancestors = systematic_ancestors(weights, float(random.random()))
        self.arrays[group.vehicles] = self.arrays[group.vehicles][:, ancestors]
        group.resample(ancestors)
        return ancestors

    def state_dict(self) -> State:
        """Return everything."""
        state: State = {
            'states': self.arrays,
            'has_chain_covariance': np.array([P is not None for P in self._chain_covariances]),
            'chain_covariances': np.array(
                [np.zeros((3, 3)) if P is None else P for P in self._chain_covariances]
            ),
        }
        for number, pending in enumerate(self.pending):
            state |= under(f'motion{number}', pending.state_dict())
        return state

    def restore(self, state: State) -> None:
        """Restore what `state_dict` returned, for the same vehicles."""
        self.arrays = state['states'].copy()
        self._chain_covariances = [
            P.copy() if known else None
            for P, known in zip(
                state['chain_covariances'], state['has_chain_covariance'], strict=True
            )
        ]
        for number, pending in enumerate(self.pending):
            pending.restore(part(f'motion{number}', state))
