"""The camera's mount: from the optical frame to the vehicle frame."""

import math

import numpy as np
import pytest

from explore_slam.errors import VisionError
from explore_slam.mounts import CameraMountConfig
from explore_slam.vision import CameraMount


def test_the_optical_axis_points_forward_right_becomes_negative_left():
    mount = CameraMount(0.1, 0.2, 0.4)
    points = mount.to_vehicle(np.array([[0.0, 0.0, 2.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))
    np.testing.assert_allclose(points, [[2.1, 0.2, 0.4], [0.1, -0.8, 0.4], [0.1, 0.2, -0.6]])


def test_a_camera_that_looks_left_or_down():
    left = CameraMount(yaw=math.pi / 2).to_vehicle(np.array([[0.0, 0.0, 2.0]]))
    np.testing.assert_allclose(left, [[0.0, 2.0, 0.0]], atol=1e-12)
    down = CameraMount(pitch=math.pi / 2).to_vehicle(np.array([[0.0, 0.0, 2.0]]))
    np.testing.assert_allclose(down, [[0.0, 0.0, -2.0]], atol=1e-12)


def test_covariances_turn_with_the_points():
    mount = CameraMount(0.3, 0.1, 0.2, 0.1, -0.4, 0.9)
    covariance = np.diag([1.0, 4.0, 9.0])[None]
    turned = mount.rotate_covariances(covariance)
    np.testing.assert_allclose(turned[0], mount.rotation @ covariance[0] @ mount.rotation.T)
    np.testing.assert_allclose(np.linalg.eigvalsh(turned[0]), [1.0, 4.0, 9.0])


def test_the_mount_of_the_settings():
    config = CameraMountConfig(0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
    assert CameraMount.from_config(config) == (0.1, 0.2, 0.3, 0.4, 0.5, 0.6)


@pytest.mark.parametrize('value', [math.nan, math.inf])
def test_coordinates_that_are_not_finite_are_refused(value):
    with pytest.raises(VisionError, match='camera mount is'):
        CameraMount(yaw=value).check()
