"""Compressed images are read, and what is no image is refused."""

import struct

import numpy as np
import pytest
from compressed_images import jpeg, png

from explore_slam.errors import VisionError
from explore_slam.vision import decode_compressed


def colours():
    image = np.zeros((64, 96, 3), np.uint8)
    image[:, :32] = (230, 20, 30)
    image[:, 32:64] = (20, 220, 30)
    image[:, 64:] = (10, 30, 240)
    return image


def test_colour_keeps_its_channels():
    decoded = decode_compressed(jpeg(colours()))
    assert decoded.dtype == np.uint8
    assert np.abs(decoded.astype(int) - colours())[:, [8, 48, 88]].max() < 12


def test_grey_stays_grey():
    grey = np.tile(np.arange(96, dtype=np.uint8), (64, 1))
    decoded = decode_compressed(jpeg(grey))
    assert decoded.shape == (64, 96)
    assert np.abs(decoded.astype(int) - grey).max() < 8


def test_depth_is_lossless_in_millimetres():
    depth = np.random.default_rng(0).integers(0, 65535, (48, 64)).astype(np.uint16)
    decoded = decode_compressed(png(depth))
    assert decoded.dtype == np.uint16
    np.testing.assert_array_equal(decoded, depth)


def test_depth_of_compressed_depth_image_transport():
    depth = np.array([[800, 2000, 0]], np.uint16)
    plain = struct.pack('<iff', 0, 0.0, 0.0) + png(depth)
    np.testing.assert_array_equal(decode_compressed(plain), depth)


def test_quantised_inverse_depth_becomes_metres():
    metres = np.array([[0.8, 1.5, 3.5]])
    a, b = 100.0 * 101.0, 1.0 - 101.0 / 10.0  # its depth_quantization 100, depth_max 10
    values = np.append(np.rint(a / metres + b), [[0]], axis=1).astype(np.uint16)
    data = struct.pack('<iff', 0, a, b) + png(values)
    decoded = decode_compressed(data)
    assert decoded.dtype == np.float32
    np.testing.assert_allclose(decoded[0, :3], metres[0], rtol=1e-3)
    assert np.isnan(decoded[0, 3])


def test_png_colour_is_read():
    np.testing.assert_array_equal(decode_compressed(png(colours())), colours())


@pytest.mark.parametrize('data', [b'', b'not an image', b'\xff\xd8\xff\xe0truncated'])
def test_what_is_no_image_is_refused(data):
    with pytest.raises(VisionError, match=f'{len(data)} bytes'):
        decode_compressed(data)
