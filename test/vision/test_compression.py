"""Compressed images round-trip, and what is no image is refused."""

import struct

import cv2
import numpy as np
import pytest

from explore_slam.errors import VisionError
from explore_slam.vision import decode_compressed, encode_depth, encode_rgb


def colours():
    image = np.zeros((64, 96, 3), np.uint8)
    image[:, :32] = (230, 20, 30)
    image[:, 32:64] = (20, 220, 30)
    image[:, 64:] = (10, 30, 240)
    return image


def test_colour_keeps_its_channels():
    decoded = decode_compressed(encode_rgb(colours(), quality=95))
    assert decoded.dtype == np.uint8
    assert np.abs(decoded.astype(int) - colours())[:, [8, 48, 88]].max() < 12


def test_grey_stays_grey():
    grey = np.tile(np.arange(96, dtype=np.uint8), (64, 1))
    decoded = decode_compressed(encode_rgb(grey))
    assert decoded.shape == (64, 96)
    assert np.abs(decoded.astype(int) - grey).max() < 8


def test_lower_quality_is_smaller():
    noise = np.random.default_rng(0).integers(0, 255, (64, 96, 3)).astype(np.uint8)
    assert len(encode_rgb(noise, quality=20)) < len(encode_rgb(noise, quality=90))


def test_depth_is_lossless_in_millimetres():
    depth = np.random.default_rng(0).integers(0, 65535, (48, 64)).astype(np.uint16)
    decoded = decode_compressed(encode_depth(depth))
    assert decoded.dtype == np.uint16
    np.testing.assert_array_equal(decoded, depth)


def test_metres_become_millimetres():
    depth = np.array([[1.2344, np.nan, 0.0, np.inf, -1.0, 70.0, 3.5]], np.float32)
    decoded = decode_compressed(encode_depth(depth))
    assert decoded.tolist() == [[1234, 0, 0, 0, 0, 0, 3500]]


def test_depth_of_compressed_depth_image_transport():
    depth = np.array([[800, 2000, 0]], np.uint16)
    plain = struct.pack('<iff', 0, 0.0, 0.0) + encode_depth(depth)
    np.testing.assert_array_equal(decode_compressed(plain), depth)


def test_quantised_inverse_depth_becomes_metres():
    metres = np.array([[0.8, 1.5, 3.5]])
    a, b = 100.0 * 101.0, 1.0 - 101.0 / 10.0  # its depth_quantization 100, depth_max 10
    values = np.append(np.rint(a / metres + b), [[0]], axis=1).astype(np.uint16)
    data = struct.pack('<iff', 0, a, b) + encode_depth(values)
    decoded = decode_compressed(data)
    assert decoded.dtype == np.float32
    np.testing.assert_allclose(decoded[0, :3], metres[0], rtol=1e-3)
    assert np.isnan(decoded[0, 3])


def test_png_colour_is_read():
    done, data = cv2.imencode('.png', cv2.cvtColor(colours(), cv2.COLOR_RGB2BGR))
    assert done
    np.testing.assert_array_equal(decode_compressed(data.tobytes()), colours())


@pytest.mark.parametrize('data', [b'', b'not an image', b'\xff\xd8\xff\xe0truncated'])
def test_what_is_no_image_is_refused(data):
    with pytest.raises(VisionError, match=f'{len(data)} bytes'):
        decode_compressed(data)


def test_what_cannot_be_encoded_is_refused():
    with pytest.raises(VisionError, match='float64'):
        encode_rgb(np.zeros((4, 4)))
    with pytest.raises(VisionError, match='int32'):
        encode_depth(np.zeros((4, 4), np.int32))
    with pytest.raises(VisionError, match=r'\(0, 4\)'):
        encode_depth(np.zeros((0, 4), np.uint16))
