"""Wheel odometry, as the base reports it."""

import numpy as np

from explore_slam.agent.odometry import OdometryBuffer, compound_steps
from explore_slam.agent.odometry_sources.source import Motion, MotionPrior, OdometrySource
from explore_slam.data import OdometryReading
from explore_slam.geometry import IDENTITY, rotated
from explore_slam.slam import FastSlamConfig, calibrated

# Trace (m² + rad²) of the covariance of a motion below which the vehicle stands still: with the
# default odometry noise, less than 0.01 mm.
_STATIONARY_TRACE = 1e-8

# rad; of the direction of the motion from the heading: the laser's yaw on the vehicle, and the
# chord of a turn between two readings (`benchmarks/wheel_course.py`: 0.07 to 0.1 on Intel, ACES
# and Belgioioso).
_COURSE_DEVIATION = 0.1


class WheelSource(OdometrySource):
    """The readings of the base, with the noise of the settings."""

    name = 'wheels'

    def add_odometry(self, reading: OdometryReading) -> list[Motion]:
        """Return the reading as it is."""
        return [Motion(reading)]

    def prior(
        self, trajectory: OdometryBuffer, since: float, stamp: float, slam: FastSlamConfig
    ) -> MotionPrior:
        """Return the prior by the wheels.

        Between scans far apart their systematic errors are larger than the noise: they are part
        of the prior as if they were unknown.
        """
        motion, covariance = compound_steps(
            IDENTITY, np.zeros((3, 3)), trajectory.steps(since, stamp), slam.odometry_noise
        )
        prior = trajectory.at(stamp)
        if covariance.trace() < _STATIONARY_TRACE:
            return MotionPrior(prior, rotated(covariance, motion.theta), still=True)
        systematic = calibrated(motion, np.zeros(3)).sensitivity * slam.calibration.deviations()
        covariance = covariance + systematic @ systematic.T
        sideways = _COURSE_DEVIATION * np.array([-motion.y, motion.x])
        covariance[:2, :2] += np.outer(sideways, sideways)
        return MotionPrior(prior, rotated(covariance, motion.theta))
