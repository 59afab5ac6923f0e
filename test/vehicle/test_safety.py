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
    given = SafetyInputs(**{'laser_last_received': made.time + seconds, **inputs})
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
        ({'laser_last_received': 100.0}, 'laser silent'),
        ({'laser_last_received': -math.inf}, 'no laser yet'),
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
    assert drive(gate(), 0.4, laser_last_received=None).linear == 0.4


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


def points_at(*distances):
    """Return points straight ahead, at distances (m) from the front of the body."""
    return np.array([[0.25 + distance, 0.0] for distance in distances])


@pytest.mark.parametrize('room', [0.05, 0.3, 0.8])
def test_the_speed_allows_to_stop_at_the_guard_distance(room):
    """Distance in 0.2 s at that speed plus braking at 0.6 m/s² is the room left."""
    made = gate()
    allowed = drive(made, 0.75, laser_points=points_at(0.15 + room, 9.0)).linear
    if allowed < 0.75:
        assert 0.2 * allowed + allowed**2 / (2.0 * 0.6) == pytest.approx(room)
    assert (allowed < 0.75) == (room < 0.2 * 0.75 + 0.75**2 / 1.2)


def test_what_slows_or_stops_the_vehicle_is_named():
    slow = drive(gate(), 0.75, laser_points=points_at(0.35))
    assert slow.reason == 'slow: obstacle 0.35 m ahead'
    assert 0.0 < slow.linear < 0.75
    stopped = drive(gate(), 0.75, 0.5, laser_points=points_at(0.14))
    assert (stopped.linear, stopped.angular) == (0.0, 0.5)  # turning away stays allowed
    assert stopped.reason == 'obstacle 0.14 m ahead'
    assert drive(gate(), 0.75, laser_points=points_at(-0.1)).reason == 'obstacle 0.00 m ahead'


def test_backing_is_stopped_by_what_lies_behind_and_only_by_that():
    behind = -points_at(0.1)
    result = drive(gate(), -0.3, laser_points=behind)
    assert (result.linear, result.reason) == (0.0, 'obstacle 0.10 m behind')
    assert drive(gate(), 0.3, laser_points=behind).linear == 0.3
    slow = drive(gate(), -0.7, laser_points=-points_at(0.25))
    assert 0.2 * -slow.linear + slow.linear**2 / 1.2 == pytest.approx(0.1)
    assert slow.linear < 0.0
    assert slow.reason == 'slow: obstacle 0.25 m behind'


def test_bumpers_stop_their_own_direction_only():
    made = gate()
    assert drive(made, 0.3, bumpers_rear=True).linear == 0.3
    assert drive(gate(), -0.3, bumpers_front=True).linear == -0.3
    result = drive(gate(), -0.3, 0.4, bumpers_rear=True)
    assert (result.linear, result.angular) == (0.0, 0.4)
    assert result.reason == 'rear bumper pressed'


def test_a_stall_forbids_to_go_on_in_its_direction_until_it_is_over():
    made = gate()
    drive(made, -0.4)
    assert drive(made, -0.4, stalled=True).linear == 0.0
    assert drive(made, 0.0, 0.5, stalled=True).angular == 0.0
    assert drive(made, 0.3, stalled=True).linear == 0.3  # the other way
    drive(made, 0.3)
    assert drive(made, 0.3, stalled=True).linear == 0.0  # a new stall, in the other direction
    assert drive(made, 0.3, stalled=False).linear == 0.3


def test_a_stall_while_turning_on_the_spot_stops_all():
    made = gate()
    drive(made, 0.0, 1.0)
    assert drive(made, 0.0, 1.0, stalled=True).angular == 0.0
    assert drive(made, 0.3, stalled=True).linear == 0.0


def test_acceleration_is_limited_by_the_time_between_updates():
    made = gate(guard_acceleration=0.5, guard_turn_acceleration=2.0)

    def update(now):
        made.command(0.7, 1.4, now)
        result = made.update(SafetyInputs(), now)
        return result.linear, result.angular

    assert update(100.0) == pytest.approx((0.025, 0.1))  # the first one counts as 50 ms
    assert update(100.1) == pytest.approx((0.075, 0.3))
    assert update(100.1) == pytest.approx((0.075, 0.3))
    assert update(105.0) == pytest.approx((0.175, 0.7))  # 0.2 s at most
    assert update(104.0) == pytest.approx((0.175, 0.7))  # time that goes back


def test_turn_rate_slows_down_within_its_limit_and_speed_at_once():
    made = gate(guard_turn_acceleration=2.0)
    drive(made, 0.5, 1.0)
    result = drive(made, 0.1, 0.0, seconds=0.05)
    assert (result.linear, result.angular) == pytest.approx((0.1, 0.9))


def test_reversing_starts_from_rest():
    made = gate(guard_acceleration=0.5)
    drive(made, 0.6)
    assert drive(made, -0.6, seconds=0.05).linear == pytest.approx(-0.025)


@pytest.mark.parametrize('timeout', ['command_timeout', 'laser_timeout'])
def test_timeouts_hold_to_the_second(timeout):
    made = gate(**{timeout: 0.5})
    drive(made, 0.4)
    now = made.time
    heard = now if timeout == 'laser_timeout' else now + 9.0
    for later, drives in ((0.49, True), (0.51, False)):
        if timeout == 'laser_timeout':
            made.command(0.4, 0.0, now + later)
        assert (made.update(SafetyInputs(heard), now + later).linear > 0.0) == drives


def test_all_reasons_are_reported_the_first_one_by_itself():
    made = gate()
    inputs = SafetyInputs(-math.inf, emergency_stop=True, motors_on=False)
    assert made.update(inputs, 1.0).all_reasons == (
        'emergency stop pressed; motors off (service enable_motors); no command yet; no laser yet'
    )
    assert drive(made, 0.4, motors_on=False).linear == 0.0


def test_the_first_reason_is_the_one_reported():
    made = gate()
    inputs = SafetyInputs(laser_last_received=-math.inf, stalled=True, emergency_stop=True)
    assert made.update(inputs, 1.0).reason == 'emergency stop pressed'
    inputs.emergency_stop = False
    assert made.update(inputs, 1.0).reason == 'no command yet'
    made.command(0.1, 0.0, 1.0)
    assert made.update(inputs, 1.0).reason == 'no laser yet'
    inputs.laser_last_received = 0.5
    assert made.update(inputs, 1.0).reason == 'laser silent for 0.5 s'
    inputs.laser_last_received = 0.9
    assert made.update(inputs, 1.0).reason == 'wheel stalled'
    assert made.update(SafetyInputs(0.9), 1.5).reason == 'no command for 0.5 s'


def test_after_a_stop_it_starts_from_rest():
    made = gate(guard_acceleration=0.5, guard_turn_acceleration=2.0)
    drive(made, 0.6, 1.0)
    assert drive(made, 0.6, 1.0, seconds=0.05, emergency_stop=True).linear == 0.0
    result = drive(made, 0.6, 1.0, seconds=0.05)
    assert (result.linear, result.angular) == pytest.approx((0.025, 0.1))
