"""Wheels with a gyroscope: turns, bias, silence, clocks, and sensors that are wrong."""

import logging
import math

import numpy as np
import pytest

from explore_slam.agent.odometry import OdometryBuffer
from explore_slam.agent.odometry_sources.gyro import GyroSource
from explore_slam.data import ImuReading, OdometryReading
from explore_slam.errors import DataError
from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.slam import OdometryNoise

TURN_RATE, SPEED = 0.8, 0.3  # rad/s, m/s
STANDS = 2.0  # s at the beginning
BIAS = 0.04  # rad/s


def true_pose(stamp):
    """The vehicle stands, then drives on a circle."""
    turned = TURN_RATE * max(stamp - STANDS, 0.0)
    radius = SPEED / TURN_RATE
    return Pose2(radius * math.sin(turned), radius * (1.0 - math.cos(turned)), turned)


class Drive:
    """Wheels at 20 Hz that turn too far, and an IMU at 100 Hz, into one trajectory."""

    def __init__(self, factor=1.4, scale=1.0, axis=2, bias=BIAS, noise=0.003):
        self.source = GyroSource('robot1', OdometryNoise())
        self.trajectory = OdometryBuffer('robot1', 30.0, 3.0, 1.0)
        self.factor, self.scale, self.axis, self.bias, self.noise = (
            factor, scale, axis, bias, noise,
        )  # fmt: skip
        self.random = np.random.default_rng(2)
        self.wheels = IDENTITY

    def imu(self, stamp):
        rates = self.noise * self.random.standard_normal(3)
        rates[self.axis] += self.scale * (TURN_RATE if stamp > STANDS else 0.0) + self.bias
        return ImuReading(stamp, tuple(rates.tolist()))

    def take(self, motions):
        for motion in motions:
            self.trajectory.add(motion.reading, motion.step)

    def run(self, until, imu=True, begin=0.0):
        for tick in range(round(100 * begin), round(100 * until) + 1):
            stamp = 0.01 * tick
            if imu:
                self.take(self.source.add_imu(self.imu(stamp)))
            if tick % 5 == 0:
                if tick:
                    step = true_pose(stamp - 0.05).between(true_pose(stamp))
                    turned = Pose2(step.x, step.y, self.factor * step.theta)
                    self.wheels = self.wheels.compose(turned)
                self.take(self.source.add_odometry(OdometryReading(stamp, self.wheels)))
        return self

    def error(self):
        return true_pose(self.trajectory.last).between(self.trajectory.pose)


@pytest.mark.parametrize('factor', [0.7, 1.0, 1.4])
def test_turns_are_those_of_the_gyroscope(factor):
    drive = Drive(factor).run(8.0)
    off = drive.error()
    # the first 0.15 rad, in which the gyroscope is checked, are those of the wheels
    assert abs(off.theta) < 0.10
    assert drive.source.check.accepted
    if factor != 1.0:
        wheels = true_pose(drive.trajectory.last).between(drive.wheels)
        assert math.hypot(wheels.x, wheels.y) > 3.0 * math.hypot(off.x, off.y)
    assert drive.trajectory.reading == pytest.approx(drive.wheels, abs=1e-9)


def test_the_bias_is_estimated_at_standstill_and_followed():
    drive = Drive().run(2.0)
    assert drive.source.bias.bias == pytest.approx(BIAS, abs=0.001)
    known = drive.source.report()['gyro_bias_deviation_rad_per_s']
    assert known < 0.001
    drive.run(6.0, begin=2.01)  # driving: nothing is learnt
    assert drive.source.bias.bias == pytest.approx(BIAS, abs=0.001)
    # later it stands again, with another bias
    drive.bias = BIAS + 0.01
    last, at = drive.wheels, drive.trajectory.last
    for tick in range(1, 300):
        stamp = at + 0.01 * tick
        rates = drive.noise * drive.random.standard_normal(3)
        rates[2] += drive.bias
        drive.take(drive.source.add_imu(ImuReading(stamp, tuple(rates.tolist()))))
        if tick % 5 == 0:
            drive.take(drive.source.add_odometry(OdometryReading(stamp, last)))
    assert drive.source.bias.bias == pytest.approx(BIAS + 0.01, abs=0.003)


def test_standing_still_is_exact_whatever_the_bias():
    drive = Drive(bias=0.2).run(2.0)
    assert drive.trajectory.pose == IDENTITY
    steps = drive.trajectory.steps(0.5, 2.0)
    assert all(not step.covariance_or(OdometryNoise()).any() for step in steps)


def test_the_heading_is_less_uncertain_than_by_the_wheels():
    drive = Drive(1.0).run(8.0)
    noise = OdometryNoise()
    steps = drive.trajectory.steps(5.0, 8.0)
    by_gyro = sum(step.covariance_or(noise)[2, 2] for step in steps)
    by_wheels = sum(noise.covariance(step.increment)[2, 2] for step in steps)
    assert 0.0 < by_gyro < 0.4 * by_wheels


def test_a_silent_imu_is_named_once_and_the_wheels_go_on(caplog):
    drive = Drive().run(4.0, imu=False)
    assert drive.trajectory.last >= 3.4
    assert caplog.text.count('no readings of its IMU for 0.5 s') == 1
    assert drive.trajectory.pose == pytest.approx(drive.trajectory.reading)


def test_readings_wait_until_the_gyroscope_has_reached_them():
    source = GyroSource('robot1', OdometryNoise())
    source.add_imu(ImuReading(0.0, (0.0, 0.0, 0.0)))
    assert len(source.add_odometry(OdometryReading(0.0, IDENTITY))) == 1
    assert source.add_odometry(OdometryReading(0.05, Pose2(0.01, 0.0, 0.0))) == []
    assert len(source.add_imu(ImuReading(0.06, (0.0, 0.0, 0.0)))) == 1


@pytest.mark.parametrize(
    ('changes', 'words'),
    [
        ({'scale': 57.3}, ['angular_velocity.z is 45.', 'degrees per second']),
        ({'scale': -1.0}, ['turns the other way', '-0.7']),
        ({'axis': 0}, ['turns about its x axis', 'imu_mount']),
    ],
)
def test_a_wrong_imu_is_named_once_and_the_wheels_go_on(changes, words, caplog):
    drive = Drive(**changes).run(8.0)
    named = [record.message for record in caplog.records if 'IMU' in record.message]
    assert len(named) == 1
    assert named[0].startswith('robot1: IMU: ')
    for word in words:
        assert word in named[0]
    assert drive.trajectory.pose == pytest.approx(drive.wheels, abs=1e-6)
    assert drive.source.report()['gyro'] == drive.source.check.problem


def test_stamps_that_go_back_are_named_once(caplog):
    drive = Drive().run(3.0)
    for stamp in (2.9, 2.8):
        drive.take(drive.source.add_imu(ImuReading(stamp, (0.0, 0.0, 5.0))))
    assert caplog.text.count('stamps of the IMU go back from 3.000 s to 2.900 s') == 1
    before = drive.trajectory.pose
    drive.run(5.0, begin=3.01)
    assert before != drive.trajectory.pose
    assert abs(drive.error().theta) < 0.10


def test_a_clock_that_jumps_back_begins_anew(caplog):
    caplog.set_level(logging.ERROR)
    drive = Drive().run(4.0)
    drive.source.restart_clock()
    drive.trajectory = OdometryBuffer('robot1', 30.0, 3.0, 1.0)
    bias = drive.source.bias.bias
    drive.wheels = IDENTITY
    drive.run(2.0)
    assert drive.trajectory.last == pytest.approx(2.0)
    assert drive.source.bias.bias == pytest.approx(bias, abs=0.002)


def test_readings_that_are_not_finite_are_refused():
    with pytest.raises(DataError, match=r'angular_velocity is .*nan'):
        ImuReading(1.0, (0.0, 0.0, math.nan))
