"""Motion between updates: odometry noise, and odometry increments compounded.

The covariance of a long motion does not follow from its end points alone, since heading errors
become lateral errors. It is compounded per odometry step, Σ ← F Σ Fᵀ + L Q Lᵀ (Smith, Self and
Cheeseman, "Estimating uncertain spatial relationships in robotics", 1990).
"""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from explore_slam.geometry import IDENTITY, Array, Pose2, compose, planar_rotation, rotated
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
    )
    position_variance_per_radian: float = setting(
        0.0002,
        'Odometry variance of x and of y per radian turned',
        unit='m²/rad',
        low=0.0,
        high=10.0,
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
    `explore_slam.slam.graph.se2` has the kernel of it.
    """
    c, s = math.cos(mean.theta), math.sin(mean.theta)
    dx = c * increment.x - s * increment.y
    dy = s * increment.x + c * increment.y
    F = np.array([[1.0, 0.0, -dy], [0.0, 1.0, dx], [0.0, 0.0, 1.0]])
    L = planar_rotation(mean.theta)
    total = F @ covariance @ F.T + L @ noise @ L.T
    return mean.compose(increment), 0.5 * (total + total.T)


class CalibratedStep(NamedTuple):
    """A wheel odometry increment, corrected by the calibration, and its Jacobian (3, 3) in it."""

    increment: Pose2
    sensitivity: Array


def calibrated(increment: Pose2, calibration: Array) -> CalibratedStep:
    """Correct an increment of wheel odometry by the systematic errors of a differential drive.

    calibration (3,): scale error of turning and of driving, and the heading drift (rad/m) of
    wheels of unequal diameter (Borenstein and Feng, "Measurement and correction of systematic
    odometry errors in mobile robots", 1996); zero where the odometry is right.
    """
    turn, distance, drift = calibration.tolist()
    corrected = Pose2(
        (1.0 + distance) * increment.x,
        (1.0 + distance) * increment.y,
        (1.0 + turn) * increment.theta + drift * increment.x,
    )
    sensitivity = np.zeros((3, 3))
    sensitivity[0, 1], sensitivity[1, 1] = increment.x, increment.y
    sensitivity[2, 0], sensitivity[2, 2] = increment.theta, increment.x
    return CalibratedStep(corrected, sensitivity)


class OdometryCalibration(NamedTuple):
    """Estimated calibration of a vehicle's wheel odometry, with deviations; see `calibrated`.

    The scales are the factors that turns and distances as measured are multiplied by; the drift of
    the heading, per metre driven, is added.
    """

    turn_scale: float
    turn_scale_deviation: float
    distance_scale: float
    distance_scale_deviation: float
    heading_drift_rad_per_m: float
    heading_drift_deviation_rad_per_m: float

    @classmethod
    def of(cls, mean: Array, covariance: Array) -> 'OdometryCalibration':
        """Return the calibration whose errors have a mean (3,) and a covariance (3, 3)."""
        turn, distance, drift = mean.tolist()
        deviations = np.sqrt(np.maximum(np.diag(covariance), 0.0)).tolist()
        return cls(1.0 + turn, deviations[0], 1.0 + distance, deviations[1], drift, deviations[2])


class Segment(NamedTuple):
    """A part of a motion: mean and covariance (3, 3) in the vehicle frame before it.

    The mean holds for the calibration with which the increments were corrected; with calibration
    c (3,) it is mean + sensitivity (3, 3) c − offset (3,).
    """

    mean: Pose2
    covariance: Array
    sensitivity: Array
    offset: Array

    @classmethod
    def empty(cls) -> 'Segment':
        """Return a segment without motion."""
        return cls(IDENTITY, np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3))

    def is_motion(self) -> bool:
        """Return whether the vehicle moves, or may have moved."""
        return self.mean != IDENTITY or bool(np.any(self.covariance))

    def extended(self, other: 'Segment') -> 'Segment':
        """Return this motion followed by another."""
        mean, covariance = compound(self.mean, self.covariance, other.mean, other.covariance)
        F, L = np.eye(3), planar_rotation(self.mean.theta)
        F[0, 2], F[1, 2] = self.mean.y - mean.y, mean.x - self.mean.x
        return Segment(
            mean,
            covariance,
            F @ self.sensitivity + L @ other.sensitivity,
            F @ self.offset + L @ other.offset,
        )

    def moves(self, calibrations: Array) -> Array:
        """Return the mean motions (M, 3) of particles with calibrations (M, 3)."""
        moves: Array = np.asarray(self.mean) + calibrations @ self.sensitivity.T - self.offset
        return moves


@dataclass
class PendingMotion:
    """Motion of one vehicle that the particles do not contain yet.

    It is kept in segments, each so short that its heading uncertainty allows linearization.
    Nothing is sampled before an observation needs it: samples drawn earlier would be depleted by
    the resamplings that other vehicles cause meanwhile.

    white (3, 3): covariance of the independent error of the pose measured last, which cancels in
    the next increment; in the vehicle frame there (see `FastSlam.predict`).
    """

    segments: list[Segment] = field(default_factory=list)
    white: Array = field(default_factory=lambda: np.zeros((3, 3)))

    @classmethod
    def of(cls, covariance: Array) -> 'PendingMotion':
        """Return a motion of mean zero."""
        return cls([Segment.empty()._replace(covariance=covariance)])

    def append(self, step: Segment, heading_limit: float) -> None:
        """Compound one more step; a segment ends at a heading deviation of heading_limit (rad)."""
        if not self.segments or self.segments[-1].covariance[2, 2] > heading_limit**2:
            self.segments.append(Segment.empty())
        self.segments[-1] = self.segments[-1].extended(step)

    def total(self) -> Segment:
        """Return the whole motion, linearized."""
        total = Segment.empty()
        for segment in self.segments:
            total = total.extended(segment)
        return total

    def copy(self) -> 'PendingMotion':
        """Return an independent copy."""
        return PendingMotion(list(self.segments), self.white)

    def end_covariance(self) -> Array:
        """Return the linearized covariance (3, 3) in the vehicle frame after the mean motion.

        The white error is part of it.
        """
        total = self.total()
        return rotated(total.covariance, total.mean.theta) + self.white

    def apply(self, poses: Array, calibrations: Array) -> Array:
        """Return poses (M, 3) moved by the mean motion for calibrations (M, 3)."""
        for segment in self.segments:
            poses = compose(poses, segment.moves(calibrations))
        return poses

    def state_dict(self) -> State:
        """Return the segments."""
        rows = [np.concatenate([np.ravel(part) for part in segment]) for segment in self.segments]
        return {'segments': np.array(rows, np.float64).reshape(-1, 24), 'white': self.white}

    def restore(self, state: State) -> None:
        """Restore the segments."""
        self.segments = [
            Segment(
                Pose2(*row[:3].tolist()),
                row[3:12].reshape(3, 3).copy(),
                row[12:21].reshape(3, 3).copy(),
                row[21:].copy(),
            )
            for row in state['segments']
        ]
        self.white = state['white'].copy()

    def propagate(
        self, poses: Array, calibrations: Array, heading_limit: float, random: np.random.Generator
    ) -> tuple[Array, Array]:
        """Return predicted poses (M, 3) and their remaining covariance (3, 3), in their frames.

        calibrations (M, 3) of the particles. If the heading is more uncertain than heading_limit
        (rad), it is sampled and the position is conditioned on the sample; a heading deviation of
        half the limit remains. The covariance contains the white error.
        """
        left = Segment.empty()
        uncertain = self.end_covariance()[2, 2] > heading_limit**2
        last = len(self.segments) - 1
        for number, segment in enumerate(self.segments):
            moves, rest = segment.moves(calibrations), segment.covariance
            if uncertain:
                deviation = 0.5 * heading_limit if number == last else 0.0
                direction, rest = split_heading(rest, deviation)
                factors = stratified_normals(random, len(poses), 1)[:, 0]
                moves = moves + factors[:, None] * direction
            poses = compose(poses, moves)
            left = left.extended(segment._replace(covariance=rest))
        return poses, rotated(left.covariance, left.mean.theta) + self.white


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
