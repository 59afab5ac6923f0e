"""The registry of devices: settings select, configure and switch off each role's device."""

import pytest

from explore_slam.errors import ConfigError
from explore_slam.settings import settings_of, values_of, with_values
from explore_slam.vehicle import (
    DriverConfig,
    Kinect,
    Lms200,
    PioneerRobot,
    make_base,
    make_camera,
    make_laser,
)

ROLES = [
    (make_base, PioneerRobot, 'enable_base', {'base_baud': 38400}),
    (make_laser, Lms200, 'enable_laser', {'laser_angle': 100}),
    (make_camera, Kinect, 'enable_camera', {'camera_index': 3}),
]


def clock():
    return 7.0


@pytest.mark.parametrize(('make', 'kind', '_', 'own'), ROLES)
def test_a_device_gets_its_common_and_its_own_settings(make, kind, _, own):
    device = make(with_values(DriverConfig(), own), clock)
    assert type(device) is kind
    (name, value), *_ = own.items()
    assert getattr(device.own, name) == value
    assert device._clock is clock
    assert set(values_of(device.config)).isdisjoint(values_of(device.own))
    device.close()  # not connected: no effect


@pytest.mark.parametrize(('make', '_', 'switch', '__'), ROLES)
def test_a_device_that_is_switched_off_is_not_made(make, _, switch, __):
    assert make(with_values(DriverConfig(), {switch: False}), clock) is None


@pytest.mark.parametrize('role', ['base_type', 'laser_type', 'camera_type'])
def test_an_unknown_kind_of_device_is_refused_with_those_known(role):
    with pytest.raises(ConfigError, match=rf"{role} is 'x', expected one of \["):
        with_values(DriverConfig(), {role: 'x'})


def test_settings_of_all_devices_have_unique_names_and_a_meaning():
    found = [info for info, _ in settings_of(DriverConfig())]
    assert len({info.name for info in found}) == len(found)
    assert all(info.doc for info in found)
    assert {'base_baud', 'laser_angle', 'camera_index', 'laser_x'} <= {i.name for i in found}
