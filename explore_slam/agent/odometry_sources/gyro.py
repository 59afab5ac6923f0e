"""Wheel odometry whose turns are measured by a gyroscope.

Wheels slip sideways where a base turns, and their distance is rarely known well: their turns are
the poor part of odometry, and the one that a gyroscope measures best.
"""

import logging
import math
from collections import deque
from dataclasses import replace

import numpy as np

from explore_slam.agent.odometry import OdometryBuffer, Step
from explore_slam.agent.odometry_sources.gyro_bias import GyroBias
from explore_slam.agent.odometry_sources.gyro_check import GyroCheck
from explore_slam.agent.odometry_sources.source import Motion, MotionPrior, OdometrySource
from explore_slam.agent.odometry_sources.twists import exponential, logarithm
from explore_slam.agent.odometry_sources.wheels import WheelSource
from explore_slam.data import ImuReading, OdometryReading
from explore_slam.geometry import IDENTITY, Array, Pose2
from explore_slam.registration import ScanMatch
from explore_slam.slam import FastSlamConfig, OdometryNoise

logger = logging.getLogger(__name__)

_SILENT = 0.5  # s without readings of the IMU after which wheels alone count; it sends at 50 Hz
_GAP = 0.2  # s between two readings of the IMU over which the turn rate is not interpolated
_KEPT = 5.0  # s of readings of the IMU
_CLOCK_JUMP = 1.0  # s by which a stamp goes back if the clock was restarted, not a message late
_STANDSTILL = 0.5  # s without motion of the wheels that show the bias
_SETTLING = 0.3  # s after which a vehicle that has stopped no longer shakes
_STILL = 1e-4  # m and rad between two readings of wheels that do not turn
_SHAKING = 0.05  # rad/s, standard deviation at a standstill; else something moves the vehicle
_QUIET = 0.05  # rad/s; beyond it, a vehicle whose wheels stand is turned by something else
# rad²/rad: the scale of a gyroscope is right to 3 % (MPU-6050, sensitivity scale factor tolerance)
_SCALE_VARIANCE = 0.03**2
_UNCHECKED_DEVIATION = 0.5  # rad, at most, of a turn on which wheels and gyroscope disagree


class GyroSource(OdometrySource):
    """Distances by the wheels, turns by the gyroscope.

    A reading of the wheels waits until the gyroscope has reached its stamp. Until the gyroscope
    has shown that it measures turns, and where it is silent, the turns are those of the wheels.
    """

    name = 'wheels+gyro'
    uses_imu = True

    def __init__(self, vehicle: str, noise: OdometryNoise) -> None:
        self.vehicle = vehicle
        self.bias = GyroBias()
        self.check = GyroCheck()
        self._noise = noise
        self._wheels = WheelSource()
        self._samples: deque[tuple[float, Array]] = deque()  # stamp (s), rates (3,) rad/s
        self._waiting: deque[OdometryReading] = deque()
        self._last: OdometryReading | None = None  # that was passed on
        self._still_since: float | None = None
        self._newest = -math.inf  # stamp (s) of the wheels
        self._reckoned = IDENTITY
        self._increment = IDENTITY
        self._late = 0
        self._without = 0  # readings of the wheels without a turn by the gyroscope
        self._named: set[str] = set()

    # -- records in ----------------------------------------------------------------------------

    def add_imu(self, reading: ImuReading) -> list[Motion]:
        """Take angular velocities; return the readings of the wheels that they complete."""
        if self._samples and reading.stamp <= self._samples[-1][0]:
            last = self._samples[-1][0]
            self._name(
                'stamps',
                f'stamps of the IMU go back from {last:.3f} s to {reading.stamp:.3f} s',
            )
            if last - reading.stamp < _CLOCK_JUMP:
                self._late += 1
                return []
            self._samples.clear()
        self.check.check_rate(reading.angular_velocity)
        self._explain_problem()
        self._samples.append((reading.stamp, np.array(reading.angular_velocity)))
        while self._samples[0][0] < reading.stamp - _KEPT:
            self._samples.popleft()
        return self._released()

    def add_odometry(self, reading: OdometryReading) -> list[Motion]:
        """Take a reading of the wheels; return those that the gyroscope has reached."""
        if reading.stamp < self._newest - _CLOCK_JUMP:
            self.restart_clock()
        self._newest = reading.stamp
        self._waiting.append(reading)
        return self._released()

    def _released(self) -> list[Motion]:
        motions = []
        reached = self._samples[-1][0] if self._samples else -math.inf
        while self._waiting:
            oldest = self._waiting[0]
            silent = self._newest - max(reached, oldest.stamp - _SILENT) > _SILENT
            if self._last is not None and oldest.stamp > reached and not silent:
                break
            if self._last is not None and silent and oldest.stamp > reached:
                self._name(
                    'silent',
                    f'no readings of its IMU for {_SILENT:g} s (odometry: wheels+gyro): until '
                    'they come, the turns of the wheels are used; set the topic with imu',
                )
            motions.append(self._motion(self._waiting.popleft()))
        return motions

    # -- motion --------------------------------------------------------------------------------

    def _motion(self, reading: OdometryReading) -> Motion:
        """Return the motion since the last reading, with the turn of the gyroscope."""
        last, self._last = self._last, reading
        self._increment = IDENTITY
        if last is None or reading.stamp <= last.stamp:
            return Motion(reading)
        wheels = last.pose.between(reading.pose)
        self._increment = wheels
        turns = self._turns(last.stamp, reading.stamp)
        if turns is None:
            self._without += 1
            return Motion(reading)
        self._find_bias(wheels, reading.stamp)
        duration = reading.stamp - last.stamp
        turns[2] -= self.bias.bias * duration
        self.check.compare('wheels', wheels.theta, turns, duration)
        self._explain_problem()
        if self.check.problem:
            return Motion(reading)
        turn = float(turns[2])
        stands = max(abs(wheels.x), abs(wheels.y), abs(wheels.theta)) < _STILL
        if stands and (not self.bias.is_known or abs(turn) < _QUIET * duration):
            self._increment = IDENTITY
            return Motion(reading, Step(IDENTITY, np.zeros((3, 3))))
        covariance = self._noise.covariance(wheels)
        covariance[2, 2] = self.bias.heading_growth(last.stamp, reading.stamp)
        covariance[2, 2] += _SCALE_VARIANCE * abs(turn)
        if not self.check.accepted:
            apart = min(abs(turn - wheels.theta), _UNCHECKED_DEVIATION)
            covariance[2, 2] = self._noise.covariance(wheels)[2, 2] + apart**2
            return Motion(reading, Step(wheels, covariance))
        velocity = logarithm(wheels)
        velocity[2] = turn
        self._increment = exponential(velocity)
        return Motion(reading, Step(self._increment, covariance))

    def _turns(self, begin: float, end: float) -> Array | None:
        """Return the turns (3,) about x, y and z (rad) between two stamps (s), bias included.

        None where the gyroscope does not cover the time.
        """
        if not self._samples or self._samples[0][0] > begin or self._samples[-1][0] < end:
            return None
        stamps = np.array([stamp for stamp, _ in self._samples])
        low = int(np.searchsorted(stamps, begin, side='right')) - 1
        high = int(np.searchsorted(stamps, end)) + 1
        at = stamps[low:high]
        if np.diff(at).max(initial=0.0) > _GAP:
            return None
        rates = np.array([self._samples[index][1] for index in range(low, high)])
        inside = np.concatenate([[begin], at[(at > begin) & (at < end)], [end]])
        values = np.stack([np.interp(inside, at, column) for column in rates.T], axis=1)
        turns: Array = np.trapezoid(values, inside, axis=0)
        return turns

    def _find_bias(self, wheels: Pose2, stamp: float) -> None:
        """Estimate the bias at a stamp (s) when the vehicle has stood long enough."""
        if max(abs(wheels.x), abs(wheels.y), abs(wheels.theta)) >= _STILL:
            self._still_since = None
            return
        if self._still_since is None:
            self._still_since = stamp + _SETTLING
        if stamp - self._still_since < _STANDSTILL:
            return
        begin, self._still_since = self._still_since, stamp
        rates = [float(rate[2]) for at, rate in self._samples if begin <= at <= stamp]
        if len(rates) < 2:
            return
        mean, deviation = float(np.mean(rates)), float(np.std(rates))
        known = self.bias.is_known
        if deviation < _SHAKING and (not known or abs(mean - self.bias.bias) < _QUIET):
            self.bias.add_standstill(stamp, mean, deviation, len(rates), stamp - begin)

    def reckoned(self, reading: OdometryReading) -> OdometryReading:
        """Return a reading with the turns of the gyroscope."""
        self._reckoned = self._reckoned.compose(self._increment)
        return replace(reading, pose=self._reckoned)

    # -- matching ------------------------------------------------------------------------------

    def prior(
        self, trajectory: OdometryBuffer, since: float, stamp: float, slam: FastSlamConfig
    ) -> MotionPrior:
        """Return the prior by wheels and gyroscope; once it is accepted, turns have no scale."""
        found = self._wheels.prior(trajectory, since, stamp, slam)
        if found.still or not self.check.accepted:
            return found
        config = replace(slam.calibration, turn_scale_deviation=math.sqrt(_SCALE_VARIANCE))
        return self._wheels.prior(trajectory, since, stamp, replace(slam, calibration=config))

    def take_match(
        self, trajectory: OdometryBuffer, since: float, stamp: float,
        prior: MotionPrior, match: ScanMatch, restarted: bool,
    ) -> Array:  # fmt: skip
        """Compare the turn of the gyroscope with that of the scans."""
        if not self.check.is_done and not restarted:
            turns = self._turns(since, stamp)
            if turns is not None:
                turns[2] -= self.bias.bias * (stamp - since)
                turn = trajectory.at(since).between(match.pose).theta
                self.check.compare('scans', turn, turns, stamp - since)
                self._explain_problem()
        return super().take_match(trajectory, since, stamp, prior, match, restarted)

    # -- health --------------------------------------------------------------------------------

    def _name(self, key: str, text: str) -> None:
        """Log a warning once."""
        if key not in self._named:
            self._named.add(key)
            logger.warning('%s: %s', self.vehicle, text)

    def _explain_problem(self) -> None:
        if self.check.problem:
            self._name(
                'check',
                f'IMU: {self.check.problem}; the turns of the wheels are used until the agent is '
                'restarted',
            )

    def restart_clock(self) -> None:
        """Forget all stamps; what is known of the sensor is kept."""
        self._samples.clear()
        self._waiting.clear()
        self._still_since, self._newest = None, -math.inf
        if self.bias.known_at is not None:
            self.bias.known_at = 0.0

    def keep_knowledge(self, other: OdometrySource) -> None:
        """Take over bias and verdict of a source of the same vehicle."""
        if isinstance(other, GyroSource):
            self.bias, self.check, self._named = other.bias, other.check, other._named

    def report(self) -> dict[str, float | str]:
        """Return bias and verdict."""
        verdict = 'used' if self.check.accepted else 'not checked yet: no turn so far'
        return {
            'gyro': self.check.problem or verdict,
            'gyro_bias_rad_per_s': self.bias.bias,
            'gyro_bias_deviation_rad_per_s': math.sqrt(self.bias.variance),
            'readings_without_gyro': float(self._without),
        }
