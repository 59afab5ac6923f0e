"""Lens distortion of every model is undone: rays of pixels that a distorting lens has made."""

import cv2
import numpy as np
import pytest

from explore_slam.data import Intrinsics
from explore_slam.errors import DataError
from explore_slam.messages.images import camera_info_message, intrinsics_record
from explore_slam.recording.rosbags_types import MESSAGES
from explore_slam.vision.depth import camera_rays

SIZE = (640, 480, 500.0, 510.0, 320.0, 240.0)
MATRIX = np.array([[500.0, 0.0, 320.0], [0.0, 510.0, 240.0], [0.0, 0.0, 1.0]])
RAYS = np.stack(np.meshgrid(np.linspace(-0.4, 0.4, 9), np.linspace(-0.3, 0.3, 7)), -1).reshape(
    -1, 2
)
COEFFICIENTS = {
    'plumb_bob': (0.1, -0.2, 0.001, -0.002, 0.05),
    'rational_polynomial': (0.1, -0.2, 0.001, -0.002, 0.05, 0.02, 0.01, 0.003),
    'equidistant': (0.02, -0.01, 0.003, -0.001),
    'inverse_brown_conrady': (0.1, -0.2, 0.001, -0.002, 0.05),
}


def pixels_of(model, values):
    """Pixels in which a lens of this model shows the rays."""
    points = np.column_stack([RAYS, np.ones(len(RAYS))])
    zero = np.zeros(3)
    if model == 'equidistant':
        made, _ = cv2.fisheye.projectPoints(
            points.reshape(-1, 1, 3), zero, zero, MATRIX, np.array(values)
        )
        return made.reshape(-1, 2)
    if model == 'inverse_brown_conrady':
        # no closed form in this direction: search for the pixel whose ray is the wanted one
        camera = Intrinsics(*SIZE, values, model)
        found = RAYS * SIZE[2:4] + SIZE[4:6]
        for _ in range(100):
            found = found + (RAYS - camera_rays(found, camera)) * SIZE[2:4]
        return found
    made, _ = cv2.projectPoints(points, zero, zero, MATRIX, np.array(values))
    return made.reshape(-1, 2)


@pytest.mark.parametrize(('model', 'values'), COEFFICIENTS.items())
def test_the_rays_of_distorted_pixels_are_found_again(model, values):
    pixels = pixels_of(model, values)
    plain = camera_rays(pixels, Intrinsics(*SIZE))
    assert np.abs(plain - RAYS).max() > 0.004  # the distortion matters
    assert np.abs(camera_rays(pixels, Intrinsics(*SIZE, values, model)) - RAYS).max() < 1e-5


def test_inverse_brown_conrady_is_the_polynomial_of_librealsense():
    """Deprojection by hand, at one pixel: f = 1 + k1 r2 + k2 r2^2 + k3 r2^3."""
    camera = Intrinsics(*SIZE, (0.1, -0.2, 0.001, -0.002, 0.05), 'inverse_brown_conrady')
    x, y = 0.2, -0.1
    r2 = x * x + y * y
    f = 1.0 + 0.1 * r2 - 0.2 * r2**2 + 0.05 * r2**3
    ux = x * f + 2 * 0.001 * x * y - 0.002 * (r2 + 2 * x * x)
    uy = y * f + 2 * -0.002 * x * y + 0.001 * (r2 + 2 * y * y)
    (ray,) = camera_rays(np.array([[320.0 + 500.0 * x, 240.0 + 510.0 * y]]), camera)
    assert tuple(ray) == pytest.approx((ux, uy))


@pytest.mark.parametrize(('model', 'values'), COEFFICIENTS.items())
def test_models_pass_through_camera_info(model, values):
    camera = Intrinsics(*SIZE, values, model)
    message = camera_info_message(MESSAGES, 1.0, 'optical', camera)
    assert message.distortion_model == model
    assert intrinsics_record(message) == camera


def test_names_of_librealsense_are_known_and_other_models_are_refused_with_the_way_out():
    message = camera_info_message(MESSAGES, 1.0, 'optical', Intrinsics(*SIZE))
    for name in ('inverse_brown_conrady', 'ftheta', 'none', ''):  # without distortion: rectified
        message.distortion_model = name
        assert intrinsics_record(message).distortion == ()
    message.d = np.array([0.1, 0.0, 0.0, 0.0, 0.0])
    for name, model in (
        ('Brown_Conrady', 'plumb_bob'),
        ('modified_brown_conrady', 'plumb_bob'),
        ('kannala_brandt4', 'equidistant'),
    ):
        message.distortion_model = name
        assert intrinsics_record(message).distortion_model == model
    message.d = np.array([0.1, 0.0, 0.01, 0.0, 0.0])
    for name in ('modified_brown_conrady', 'ftheta'):
        message.distortion_model = name
        with pytest.raises(DataError, match=f'{name}.* publish rectified images'):
            intrinsics_record(message)
    with pytest.raises(DataError, match='equidistant'):
        Intrinsics(*SIZE, (0.1, 0.2), 'equidistant')
    with pytest.raises(DataError, match="distortion_model is 'magic'"):
        Intrinsics(*SIZE, (), 'magic')


def test_coefficients_of_a_longer_model_are_refused_with_the_way_out():
    eight = COEFFICIENTS['rational_polynomial']
    camera = Intrinsics(*SIZE, eight, 'rational_polynomial')
    message = camera_info_message(MESSAGES, 1.0, 'optical', camera)
    message.d = np.array([*eight, 0.01, 0.0, 0.0, 0.0, 0.0, 0.0])
    with pytest.raises(DataError, match=r'14 coefficients of .*publish rectified images'):
        intrinsics_record(message)
    message.d = np.array([*eight, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])  # as some calibrators fill up
    assert intrinsics_record(message).distortion == eight
