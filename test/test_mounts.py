"""Sensor mounts: one section of settings per sensor."""

import pytest

from explore_slam.errors import ConfigError
from explore_slam.geometry import Pose2
from explore_slam.mounts import LaserMountConfig
from explore_slam.settings import with_values


def test_the_pose_of_the_laser_is_that_of_the_settings():
    values = {'laser_x': -0.2, 'laser_y': 0.05, 'laser_yaw': 3.1}
    assert with_values(LaserMountConfig(), values).pose == Pose2(-0.2, 0.05, 3.1)


def test_a_mount_out_of_range_is_refused():
    with pytest.raises(ConfigError, match='laser_yaw is 4'):
        LaserMountConfig(laser_yaw=4.0)
