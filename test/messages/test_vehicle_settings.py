"""Settings of the team and of single vehicles."""

import pytest

from explore_slam.data import SweepTiming, VehicleBody
from explore_slam.errors import ConfigError
from explore_slam.messages.vehicle_settings import VehicleConfig, settings_of_vehicles


def test_size_and_speed_are_those_of_the_team_unless_a_vehicle_has_its_own():
    values = {'vehicle_radius': 0.3, 'robot2.vehicle_radius': 0.5, 'robot2.follow_speed': 0.8}
    made = settings_of_vehicles(values, ('robot1', 'robot2'))
    assert made['robot1'].body.record == VehicleBody(0.3, 0.4)
    assert made['robot2'].body.record == VehicleBody(0.5, 0.8)
    assert settings_of_vehicles({}, ['robot1'])['robot1'].body.record == VehicleBody()


def test_sweeps_are_those_of_the_team_unless_a_vehicle_has_its_own():
    values = {'sweep_time': 0.1, 'robot2.sweep_time': 0.2, 'robot2.sweep_stamp': 'last'}
    made = settings_of_vehicles(values, ('robot1', 'robot2'))
    assert made['robot1'].sweep.record == SweepTiming(0.1)
    assert made['robot2'].sweep.record == SweepTiming(0.2, 'auto', 'last')
    assert settings_of_vehicles({}, ['robot1'])['robot1'].sweep.record == SweepTiming()


@pytest.mark.parametrize(
    ('name', 'value', 'words'),
    [
        ('robot2.vehicle_radius', 0.0, 'robot2: vehicle_radius is 0.0, expected 0.05 to 2.0'),
        ('robot2.follow_speed', float('nan'), 'robot2: follow_speed is nan'),
        ('robot2.sweep_stamp', 'middle', 'robot2: sweep_stamp'),
        ('robot2.sweep_time', 1.5, 'robot2: sweep_time is 1.5, expected -1.0 to 1.0'),
        ('robot2.battery_low', 101.0, 'robot2: battery_low is 101.0, expected 0.0 to 100.0'),
        ('robot2.battery_topic', '/battery', "robot2: battery_topic is .'/battery'."),
        ('robot2.battery_topic', '', "robot2: battery_topic is .''."),
        ('robot2.vehicle_radios', 0.3, "did you mean 'vehicle_radius'"),
    ],
)
def test_a_value_that_cannot_be_is_named_with_its_vehicle(name, value, words):
    with pytest.raises(ConfigError, match=words):
        settings_of_vehicles({name: value}, ('robot1', 'robot2'))


@pytest.mark.parametrize(
    ('values', 'has_sensor'),
    [
        ({}, True),
        ({'use_laser': False}, True),
        ({'vision': 'none'}, True),
        ({'use_laser': False, 'vision': 'none'}, False),
    ],
)
def test_a_vehicle_without_laser_and_camera_has_no_sensor(values, has_sensor):
    assert VehicleConfig(**values).has_sensor is has_sensor
