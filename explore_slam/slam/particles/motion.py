"""Motion between updates: odometry noise, and odometry increments compounded.

The covariance of a long motion does not follow from its end points alone, since heading errors
become lateral errors. It is compounded per odometry step, Σ ← F Σ Fᵀ + L Q Lᵀ (Smith, Self and
Cheeseman, "Estimating uncertain spatial relationships in robotics", 1990).
"""

import math
from dataclasses import dataclass, field

import numpy as np

from explore_slam.geometry import IDENTITY, Array, Pose2, compose
from explore_slam.settings import Section, setting
from explore_slam.slam.checkpoint import State
from explore_slam.slam.particles.resampling import stratified_normals


@dataclass(frozen=True)
class OdometryNoise(Section):
    """Noise of wheel odometry: variances that grow with the distance driven and the angle turned.

    Variances (not deviations) are proportional to the distance, so that a motion in many steps is
    as uncertain as the same motion in one step.
    """

    forward_variance_per_metre: float = setting(
        0.002,
        'Odometry variance along the motion per metre driven',
        unit='m²/m',
        low=0.0,
        high=10.0,
        tier='basic',
    )
    lateral_variance_per_metre: float = setting(
        0.0005,
        'Odometry variance across the motion per metre driven',
        unit='m²/m',
        low=0.0,
        high=10.0,
        tier='basic',
    )
    position_variance_per_radian: float = setting(
        0.0002,
        'Odometry variance of x and of y per radian turned',
        unit='m²/rad',
        low=0.0,
        high=10.0,
        tier='basic',
    )
    heading_variance_per_metre: float = setting(
        0.002,
        'Odometry variance of the heading per metre driven',
        unit='rad²/m',
        low=0.0,
        high=10.0,
        tier='basic',
    )
    heading_variance_per_radian: float = setting(
        0.005,
        'Odometry variance of the heading per radian turned',
        unit='rad²/rad',
        low=0.0,
        high=10.0,
        tier='basic',
    )

    def covariance(self, increment: Pose2) -> Array:
        """Return the covariance (3, 3) of an odometry step, in the vehicle frame before it."""
        distance = math.hypot(increment.x, increment.y)
        turn = abs(increment.theta)
        along = self.forward_variance_per_metre * distance
        across = self.lateral_variance_per_metre * distance
        c, s = (1.0, 0.0)
        if distance > 0.0:
            c, s = increment.x / distance, increment.y / distance
        both = self.position_variance_per_radian * turn
        xy = c * s * (along - across)
        heading = self.heading_variance_per_metre * distance
        heading += self.heading_variance_per_radian * turn
        return np.array(
            [
                [c * c * along + s * s * across + both, xy, 0.0],
                [xy, s * s * along + c * c * across + both, 0.0],
                [0.0, 0.0, heading],
            ]
        )


def compound(
    mean: Pose2, covariance: Array, increment: Pose2, noise: Array
) -> tuple[Pose2, Array]:
    """Compound a motion with an odometry step: Σ ← F Σ Fᵀ + L Q Lᵀ.

    mean and covariance (3, 3) are in the vehicle frame before the motion; increment and its noise
    (3, 3) in that after it. Returns mean and covariance of the whole, in the first frame.
    """
    c, s = math.cos(mean.theta), math.sin(mean.theta)
    dx = c * increment.x - s * increment.y
    dy = s * increment.x + c * increment.y
    F = np.array([[1.0, 0.0, -dy], [0.0, 1.0, dx], [0.0, 0.0, 1.0]])
    L = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    total = F @ covariance @ F.T + L @ noise @ L.T
    return mean.compose(increment), 0.5 * (total + total.T)


def rotated(covariance: Array, angle: float) -> Array:
    """Return a pose covariance (3, 3) expressed in axes rotated by an angle (rad)."""
    c, s = math.cos(angle), math.sin(angle)
    T = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    turned: Array = T @ covariance @ T.T
    return turned


@dataclass
class PendingMotion:
    """Motion of one vehicle that the particles do not contain yet.

    It is kept in segments, mean and covariance (3, 3) in the vehicle frame before the segment,
    each so short that its heading uncertainty allows linearization. Nothing is sampled before an
    observation needs it: samples drawn earlier would be depleted by the resamplings that other
    vehicles cause meanwhile.
    """

    segments: list[tuple[Pose2, Array]] = field(default_factory=list)

    @classmethod
    def of(cls, covariance: Array) -> 'PendingMotion':
        """Return a motion of mean zero."""
        return cls([(IDENTITY, covariance)])

    def append(self, increment: Pose2, noise: Array, heading_limit: float) -> None:
        """Compound one more step; a segment ends at a heading deviation of heading_limit (rad)."""
        if not self.segments or self.segments[-1][1][2, 2] > heading_limit**2:
            self.segments.append((IDENTITY, np.zeros((3, 3))))
        self.segments[-1] = compound(*self.segments[-1], increment, noise)

    @property
    def mean(self) -> Pose2:
        """The mean of the whole motion."""
        total = IDENTITY
        for mean, _ in self.segments:
            total = total.compose(mean)
        return total

    def end_covariance(self) -> Array:
        """Return the linearized covariance (3, 3) in the vehicle frame after the mean motion."""
        total, covariance = IDENTITY, np.zeros((3, 3))
        for mean, noise in self.segments:
            total, covariance = compound(total, covariance, mean, noise)
        return rotated(covariance, total.theta)

    def state_dict(self) -> State:
        """Return the segments."""
        rows = [[*mean, *covariance.ravel()] for mean, covariance in self.segments]
        return {'segments': np.array(rows, np.float64).reshape(-1, 12)}

    def restore(self, state: State) -> None:
        """Restore the segments."""
        self.segments = [
            (Pose2(*row[:3].tolist()), row[3:].reshape(3, 3).copy()) for row in state['segments']
        ]

    def propagate(
        self, poses: Array, heading_limit: float, random: np.random.Generator
    ) -> tuple[Array, Array]:
        """Return predicted poses (M, 3) and their remaining covariance (3, 3), in their frames.

        If the heading is more uncertain than heading_limit (rad), it is sampled and the position
        is conditioned on the sample; a heading deviation of half the limit remains.
        """
        total, left = IDENTITY, np.zeros((3, 3))
        uncertain = self.end_covariance()[2, 2] > heading_limit**2
        last = len(self.segments) - 1
        for number, (mean, noise) in enumerate(self.segments):
            moves, rest = np.asarray(mean), noise
            if uncertain:
                deviation = 0.5 * heading_limit if number == last else 0.0
                direction, rest = split_heading(noise, deviation)
                factors = stratified_normals(random, len(poses), 1)[:, 0]
                moves = moves + factors[:, None] * direction
            poses = compose(poses, moves)
            total, left = compound(total, left, mean, rest)
        return poses, rotated(left, total.theta)


def split_heading(covariance: Array, deviation: float) -> tuple[Array, Array]:
    """Split a covariance P (3, 3) so that a heading deviation (rad) remains.

    Returns the direction δ (3,) to sample along with a standard normal factor, and P − δ δᵀ, the
    covariance conditioned on that sample.
    """
    variance = float(covariance[2, 2])
    if variance <= deviation**2:
        return np.zeros(3), covariance
    part = 1.0 - deviation**2 / variance
    direction: Array = covariance[:, 2] * math.sqrt(part / variance)
    rest = covariance - np.outer(direction, direction)
    return direction, 0.5 * (rest + rest.T)
