import math

import numpy as np
import pytest

from explore_slam.vehicle import SafetyConfig, SafetyGate, SafetyInputs
from explore_slam.vehicle.pioneer_sonar import sonar_points
from explore_slam.vehicle.safety import free_in_lane


def gate(**settings):
    made = SafetyGate(SafetyConfig(**settings), 0.75, 1.5)
    made.time = 100.0
    return made


def drive(made, linear, angular=0.0, seconds=2.0, **inputs):
    """Command for a while at 20 Hz; return what may be driven at the end."""
    given = SafetyInputs(**{'laser_heard': made.time + seconds, **inputs})
    for _ in range(round(seconds / 0.05)):
        made.time += 0.05
        made.command(linear, angular, made.time)
        result = made.update(given, made.time)
    return result


def test_drives_as_commanded_up_to_its_limits():
    made = gate()
    result = drive(made, 0.4, 0.3)
    assert (result.linear, result.angular, result.reason) == (0.4, 0.3, '')
    result = drive(made, 5.0, -9.0)
    assert (result.linear, result.angular) == (0.75, -1.5)


def test_speeds_up_no_faster_than_allowed_and_stops_at_once():
    made = gate(guard_acceleration=0.5)
    made.command(0.7, 0.0, 100.0)
    made.update(SafetyInputs(), 100.0)
    made.command(0.7, 0.0, 100.1)
    assert made.update(SafetyInputs(), 100.1).linear <= 0.5 * 0.15 + 1e-9
    drive(made, 0.7)
    assert drive(made, 0.0, seconds=0.05).linear == 0.0
    assert drive(made, -0.7, seconds=0.05).linear >= -0.5 * 0.05 - 1e-9


def test_nothing_is_driven_before_the_first_command():
    assert gate().update(SafetyInputs(), 5.0).reason == 'no command yet'


def test_watchdog_stops_after_300_ms():
    made = gate()
    drive(made, 0.4)
    assert made.update(SafetyInputs(), made.time + 0.29).linear > 0.0
    late = made.update(SafetyInputs(), made.time + 0.31)
    assert (late.linear, late.angular) == (0.0, 0.0)
    assert 'no command' in late.reason


def test_commands_that_are_no_numbers_stop():
    for linear, angular in ((math.nan, 0.0), (0.3, math.inf)):
        made = gate()
        drive(made, 0.4)
        result = drive(made, linear, angular, seconds=0.05)
        assert (result.linear, result.angular) == (0.0, 0.0)


@pytest.mark.parametrize(
    ('inputs', 'reason'),
    [
        ({'connected': False}, 'base not connected'),
        ({'emergency_stop': True}, 'emergency stop pressed'),
        ({'laser_heard': 100.0}, 'laser silent'),
        ({'laser_heard': -math.inf}, 'no laser yet'),
        ({'bumpers_front': True}, 'front bumper'),
        ({'stalled': True}, 'stalled'),
    ],
)
def test_stops_for(inputs, reason):
    made = gate()
    drive(made, 0.4)
    result = drive(made, 0.4, seconds=0.5, **inputs)
    assert result.linear == 0.0
    assert reason in result.reason


def test_a_vehicle_without_a_laser_is_not_stopped_for_its_silence():
    assert drive(gate(), 0.4, laser_heard=None).linear == 0.4


def test_bumpers_and_stalls_may_be_backed_out_of():
    made = gate()
    drive(made, 0.4)
    assert drive(made, -0.3, bumpers_front=True).linear == -0.3
    assert drive(made, -0.3, bumpers_rear=True, seconds=0.1).linear == 0.0
    made = gate()
    drive(made, 0.4)
    assert drive(made, 0.4, stalled=True).linear == 0.0
    assert drive(made, -0.3, stalled=True).linear == -0.3


@pytest.mark.parametrize('speed', [0.2, 0.4, 0.75])
def test_brakes_in_time_before_an_obstacle(speed):
    made, at, wall = gate(), 0.0, 3.0
    given = SafetyInputs()
    velocity = 0.0
    for k in range(1500):
        now = 100.0 + 0.02 * k
        if k % 11 == 0:  # a scan at last every 220 ms
            given.laser_points = np.array([[wall - at, 0.05], [0.1, 2.0]])
        made.command(speed, 0.0, now)
        wanted = made.update(given, now).linear
        velocity += min(max(wanted - velocity, -0.02), 0.02)  # 1 m/s²
        at += 0.02 * velocity
    assert 0.13 <= wall - 0.25 - at < 0.35
    assert velocity < 0.01
    assert drive(made, -0.2, laser_points=given.laser_points).linear == -0.2  # away from it


def test_what_lies_beside_the_lane_does_not_matter():
    points = np.array([[0.5, 0.23], [0.3, -0.4], [-0.4, 0.0]])
    assert free_in_lane(points, 0.22, 0.25, forward=True) == math.inf
    assert free_in_lane(points, 0.22, 0.25, forward=False) == pytest.approx(0.15)
    assert drive(gate(), 0.4, laser_points=points).linear == 0.4


def test_sonar_stops_where_it_is_asked_to():
    readings = {3: 0.15, 4: 5.0, 12: 0.5}
    points = sonar_points(readings)
    assert len(points) == 2  # 5 m is no echo
    assert points[0] == pytest.approx([0.314, 0.053], abs=0.001)
    assert drive(gate(), 0.4, sonar_points=points).linear == 0.4
    assert drive(gate(sonar_stop=True), 0.4, sonar_points=points).linear == 0.0
