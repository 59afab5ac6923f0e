"""Every setting of the simulator changes what it measures."""

import dataclasses
import hashlib
import math

import numpy as np
import pytest

from explore_slam.data import LaserScan, OdometryReading, RgbdFrame
from explore_slam.geometry import Pose2
from explore_slam.settings import values_of, with_values
from explore_slam.simulation import SimulationConfig, Simulator, load_world, world_path
from explore_slam.simulation.worlds.world import Board

BASE = {
    'simulated_image_width': 64, 'simulated_image_height': 48, 'simulated_camera_rate': 2.0,
    'simulated_beams': 31,
}  # fmt: skip
OTHER = {
    'tick_rate': 40.0,
    'simulated_radius': 0.3,
    'simulated_height': 1.0,
    'simulated_max_speed': 0.5,
    'simulated_max_turn_rate': 1.0,
    'simulated_acceleration': 0.4,
    'simulated_turn_acceleration': 1.0,
    'simulated_odometry_rate': 10.0,
    'simulated_distance_variance': 1e-3,
    'simulated_drift_variance': 3e-3,
    'simulated_turn_variance': 1e-3,
    'simulated_distance_scale': 0.05,
    'simulated_turn_scale': 0.05,
    'simulated_heading_drift': 0.05,
    'simulated_scan_rate': 5.0,
    'simulated_beams': 61,
    'simulated_field_of_view': 90.0,
    'simulated_scan_range': 2.0,
    'simulated_scan_noise': 0.05,
    'laser_x': 0.0,
    'laser_y': 0.2,
    'laser_yaw': 0.3,
    'simulated_sweep_time': 0.05,
    'simulated_laser_z': 0.1,
    'simulated_camera_rate': 4.0,
    'simulated_image_width': 80,
    'simulated_image_height': 64,
    'simulated_camera_angle': 70.0,
    'simulated_min_depth': 1.2,
    'simulated_max_depth': 2.0,
    'simulated_depth_noise': 0.02,
    'simulated_readout_time': 0.05,
    'simulated_color_noise': 9.0,
    'camera_x': 0.0,
    'camera_y': 0.2,
    'camera_z': 0.8,
    'camera_roll': 0.2,
    'camera_pitch': 0.2,
    'camera_yaw': 0.3,
}


@pytest.fixture(scope='module')
def world():
    shelf = Board(0.3, 1.4, 0.15, 0.3, 0.0, 0.9, 0.93)  # behind a vehicle
    small = load_world(world_path('small'))
    return dataclasses.replace(small, texture_resolution=0.03, boards=(shelf,))


def digest(world, values):
    """Return a digest of all records of a drive against a wall and a turn."""
    hasher = hashlib.sha256()
    starts = {'a': Pose2(0.8, 1.5, 0.2), 'b': Pose2(2.4, 2.4, math.pi)}
    with Simulator(world, starts, with_values(SimulationConfig(), {**BASE, **values})) as sim:
        sim.set_velocity('a', -2.0, 0.0)
        sim.set_velocity('b', 0.0, 3.0)
        while sim.time < 2.0:
            for stamp, vehicle, record in sim.step():
                hasher.update(f'{stamp:.6f} {vehicle}'.encode())
                if isinstance(record, LaserScan):
                    hasher.update(record.ranges.tobytes())
                elif isinstance(record, RgbdFrame):
                    hasher.update(record.rgb.tobytes() + record.depth.tobytes())
                elif isinstance(record, OdometryReading):
                    hasher.update(np.array(record.pose).tobytes())
                else:
                    hasher.update(repr(record).encode())
    return hasher.hexdigest()


def test_the_list_is_complete():
    assert set(OTHER) == set(values_of(SimulationConfig()))


@pytest.fixture(scope='module')
def usual(world):
    return digest(world, {})


@pytest.mark.parametrize('name', sorted(OTHER))
def test_a_setting_has_an_effect(world, usual, name):
    assert digest(world, {name: OTHER[name]}) != usual
