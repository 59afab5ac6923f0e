"""Every setting of follower and safety gate has an effect on the driven velocities."""

import dataclasses

import numpy as np
import pytest

from explore_slam.geometry import Pose2
from explore_slam.settings import settings_of, with_values
from explore_slam.vehicle import (
    LaserConfig,
    Lms200,
    PathFollowerConfig,
    SafetyConfig,
    SafetyGate,
    SafetyInputs,
)
from explore_slam.vehicle.lms200_scan import RawScan

X = np.arange(0.0, 4.01, 0.05)
SLALOM = np.column_stack([X, 0.4 * np.sin(2 * np.pi * X / 2.0)])
CORNERS = [[0, 0], [1.0, 0], [1.0, 1.0]]
LINE = [[0, 0], [20.0, 0.0]]

# setting -> (another value, scenario that shows it)
FOLLOWER = {
    'follow_speed': (0.3, 'slalom'),
    'follow_turn_rate': (0.5, 'slalom'),
    'follow_acceleration': (0.2, 'slalom'),
    'follow_turn_acceleration': (0.5, 'slalom'),
    'lookahead_time': (2.0, 'slalom'),
    'minimum_lookahead': (0.8, 'slalom'),
    'turn_in_place_angle': (0.3, 'corners'),
    'arrival_tolerance': (0.4, 'corners'),
    'maximum_deviation': (0.2, 'beside'),
    'obstacle_stop': (False, 'wall'),
    'vehicle_radius': (0.5, 'wall'),
    'side_clearance': (0.4, 'pillar'),
    'stop_distance': (0.8, 'wall'),
    'reaction_time': (1.5, 'wall'),
    'blocked_timeout': (0.5, 'wall'),
    'stuck_timeout': (1.0, 'held'),
    'agent_timeout': (0.5, 'agent'),
    'pose_timeout': (1.0, 'pose'),
    'heartbeat_timeout': (2.0, 'heartbeat'),
    'odometry_timeout': (3.0, 'odometry'),
    'scan_timeout': (3.0, 'laser'),
    'laser_x': (0.5, 'wall'),
    'laser_y': (-0.4, 'pillar'),
    'laser_yaw': (0.5, 'wall'),
}


def drive(make_track, config, scenario):
    """Return commands over time in a scenario."""
    obstacles = {'wall': [(2.0, 0.0, 0.3)], 'pillar': [(2.0, 0.5, 0.1)]}.get(scenario, ())
    path = {'slalom': SLALOM, 'corners': CORNERS}.get(scenario, LINE)
    start = Pose2(0.0, 0.5, 0.0) if scenario == 'beside' else Pose2(0.0, 0.0, 0.0)
    track = make_track(path, config, start=start, obstacles=obstacles)
    if scenario in ('agent', 'odometry', 'laser', 'pose'):
        track.run(2.0)
        track.silent.add('agent' if scenario == 'pose' else scenario)
    rows = []
    while track.time < (9.0 if scenario in ('wall', 'slalom', 'corners') else 4.5):
        if scenario == 'held':
            track.velocity = [0.0, 0.0]
        if scenario == 'pose' and track.time > 2.0:  # plans still come
            track.follower.set_plan(track.follower.plan, track.time)
        track.step()
        command = track.last
        if scenario == 'heartbeat':
            command = track.follower.command(track.time, 1.0)
        rows.append((command.linear, command.angular, command.state.value))
    return rows


@pytest.mark.parametrize('name', FOLLOWER)
def test_every_setting_of_the_follower_has_an_effect(make_track, name):
    value, scenario = FOLLOWER[name]
    plain = PathFollowerConfig()
    changed = with_values(plain, {name: value})
    assert drive(make_track, plain, scenario) != drive(make_track, changed, scenario)


def test_no_setting_of_the_follower_is_left_out():
    assert {info.name for info, _ in settings_of(PathFollowerConfig())} == {
        *FOLLOWER,
        'control_frequency',  # the node's timer: test/nodes/test_parameters
    }


SAFETY = {
    'command_timeout': 1.0,
    'laser_timeout': 1.0,
    'laser_stop': False,
    'sonar_stop': True,
    'guard_distance': 0.6,
    'guard_half_width': 0.6,
    'guard_half_length': 0.6,
    'guard_acceleration': 0.1,
    'guard_deceleration': 0.1,
    'guard_turn_acceleration': 0.5,
}


def velocities(config):
    """Return what a gate lets pass while an obstacle nears and commands and laser fall silent."""
    gate, rows = SafetyGate(config, 0.75, 1.5), []
    for k in range(120):
        now = 10.0 + 0.05 * k
        at = 2.5 - 0.025 * k
        points = np.array([[at, 0.0], [0.6, 0.5]]) if k < 90 else np.empty((0, 2))
        sonar = np.array([[0.5, 0.0]]) if k > 110 else np.empty((0, 2))
        if k < 60 or k > 70:
            gate.command(0.5, 0.6, now)
        heard = now if k < 90 or k > 100 else 10.0 + 0.05 * 90
        rows.append(gate.update(SafetyInputs(heard, laser_points=points, sonar_points=sonar), now))
    return [(row.linear, row.angular) for row in rows]


@pytest.mark.parametrize('name', SAFETY)
def test_every_setting_of_the_safety_gate_has_an_effect(name):
    changed = dataclasses.replace(SafetyConfig(), **{name: SAFETY[name]})
    assert velocities(SafetyConfig()) != velocities(changed)


def test_no_setting_of_the_safety_gate_is_left_out():
    assert {info.name for info, _ in settings_of(SafetyConfig())} == set(SAFETY)


def test_an_upside_down_laser_is_read_backwards():
    raw = RawScan(np.arange(1000, 1361).astype(np.uint16), 1, False)
    upright = Lms200(LaserConfig()).record(raw, 1.0).ranges
    inverted = Lms200(LaserConfig(laser_inverted=True)).record(raw, 1.0).ranges
    np.testing.assert_array_equal(upright[::-1], inverted)
