"""Motion between updates: odometry noise, and increments compounded along the way.

The covariance of a long gap is not that of its end points: a heading error becomes a lateral
error, so it is compounded per odometry step, Σ ← F Σ Fᵀ + L Q Lᵀ.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from explore_slam.geometry import IDENTITY, Array, Pose2, compose
from explore_slam.settings import Section, setting
from explore_slam.slam.particles.resampling import stratified_normals


@dataclass(frozen=True)
class OdometryNoise(Section):
    """Noise of odometry: variances that grow with what was driven, the same for every step length.

    Variances (not deviations) are proportional to the way, so that a way cut into many steps
    has the same uncertainty as the same way in one step.
    """

    forward_variance_per_metre: float = setting(
        0.002, 'Variance along the motion per metre driven', unit='m²/m', low=0.0, high=10.0
    )
    lateral_variance_per_metre: float = setting(
        0.0005, 'Variance across the motion per metre driven', unit='m²/m', low=0.0, high=10.0
    )
    position_variance_per_radian: float = setting(
        0.0002, 'Variance of x and y per radian turned', unit='m²/rad', low=0.0, high=10.0
    )
    heading_variance_per_metre: float = setting(
        0.002, 'Variance of the heading per metre driven', unit='rad²/m', low=0.0, high=10.0
    )
    heading_variance_per_radian: float = setting(
        0.005, 'Variance of the heading per radian turned', unit='rad²/rad', low=0.0, high=10.0
    )

    def covariance(self, increment: Pose2) -> Array:
        """Return the covariance (3, 3) of an odometry step, in the frame where the step begins."""
        way = math.hypot(increment.x, increment.y)
        turn = abs(increment.theta)
        along = self.forward_variance_per_metre * way
        across = self.lateral_variance_per_metre * way
        c, s = (increment.x / way, increment.y / way) if way > 0.0 else (1.0, 0.0)
        turned = self.position_variance_per_radian * turn
        xy = c * s * (along - across)
        heading = self.heading_variance_per_metre * way + self.heading_variance_per_radian * turn
        return np.array(
            [
                [c * c * along + s * s * across + turned, xy, 0.0],
                [xy, s * s * along + c * c * across + turned, 0.0],
                [0.0, 0.0, heading],
            ]
        )


def compound(
    mean: Pose2, covariance: Array, increment: Pose2, noise: Array
) -> tuple[Pose2, Array]:
    """Append an odometry step to a motion: Σ ← F Σ Fᵀ + L Q Lᵀ.

    mean and covariance (3, 3) are in the frame where the motion began; increment and its noise
    (3, 3) in the frame where the mean ends. Returns the longer motion in the first frame.
    """
    c, s = math.cos(mean.theta), math.sin(mean.theta)
    dx = c * increment.x - s * increment.y
    dy = s * increment.x + c * increment.y
    F = np.array([[1.0, 0.0, -dy], [0.0, 1.0, dx], [0.0, 0.0, 1.0]])
    L = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    total = F @ covariance @ F.T + L @ noise @ L.T
    return mean.compose(increment), 0.5 * (total + total.T)


def rotated(covariance: Array, angle: float) -> Array:
    """Return a pose covariance (3, 3) expressed in axes turned by angle (rad)."""
    c, s = math.cos(angle), math.sin(angle)
    T = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    turned: Array = T @ covariance @ T.T
    return turned


@dataclass
class PendingMotion:
    """Motion of one vehicle since the particles last moved.

    Kept in segments (mean, covariance (3, 3) in the frame where the segment begins), so short
    that the heading within each stays certain enough to linearize over. Nothing is sampled
    before an observation needs it: samples drawn early would be thinned out by the resamplings
    that other vehicles cause meanwhile.
    """

    segments: list[tuple[Pose2, Array]] = field(default_factory=list)

    @classmethod
    def of(cls, covariance: Array) -> 'PendingMotion':
        """Make a motion of mean zero."""
        return cls([(IDENTITY, covariance)])

    def append(self, increment: Pose2, noise: Array, heading_limit: float) -> None:
        """Compound one more step; a segment ends when its heading deviates by the limit (rad)."""
        if not self.segments or self.segments[-1][1][2, 2] > heading_limit**2:
            self.segments.append((IDENTITY, np.zeros((3, 3))))
        self.segments[-1] = compound(*self.segments[-1], increment, noise)

    @property
    def mean(self) -> Pose2:
        """The motion without noise."""
        total = IDENTITY
        for mean, _ in self.segments:
            total = total.compose(mean)
        return total

    def end_covariance(self) -> Array:
        """Return the covariance (3, 3), linearized, in the frame where the mean ends."""
        total, covariance = IDENTITY, np.zeros((3, 3))
        for mean, noise in self.segments:
            total, covariance = compound(total, covariance, mean, noise)
        return rotated(covariance, total.theta)

    def move(
        self, poses: Array, heading_limit: float, random: np.random.Generator
    ) -> tuple[Array, Array]:
        """Return moved poses (M, 3) and the covariance (3, 3) that is left, in their frames.

        Where the heading is more uncertain than the limit (rad) it is sampled, and the position
        conditioned on the sample; the covariance left has half the limit in heading.
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
    """Take heading uncertainty out of a covariance (3, 3), leaving the deviation (rad).

    Returns the direction δ (3,) along which to sample with a standard normal factor, and the
    rest P − δ δᵀ, which is conditioned on that sample.
    """
    variance = float(covariance[2, 2])
    if variance <= deviation**2:
        return np.zeros(3), covariance
    part = 1.0 - deviation**2 / variance
    direction: Array = covariance[:, 2] * math.sqrt(part / variance)
    rest = covariance - np.outer(direction, direction)
    return direction, 0.5 * (rest + rest.T)
