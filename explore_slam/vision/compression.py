"""Compressed images: JPEG colour and 16-bit PNG depth, as image_transport writes them."""

import struct
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from explore_slam.errors import VisionError
from explore_slam.vision.depth import depth_in_metres

_PNG = b'\x89PNG\r\n\x1a\n'  # the first bytes of every PNG file
_DEPTH_HEADER = struct.Struct('<iff')  # of compressed_depth_image_transport: format, a, b
_LARGEST_DEPTH = 65535.0  # mm in 16 bits
_FASTEST = 1  # PNG compression level: frames have to be encoded at the rate of the camera


def encode_rgb(image: NDArray[np.uint8], quality: int = 90) -> bytes:
    """Return an RGB image (H, W, 3) or grey image (H, W) as JPEG; quality 1 to 100."""
    if image.dtype != np.uint8 or image.ndim not in (2, 3) or image.size == 0:
        raise VisionError(
            f'image of type {image.dtype} and shape {image.shape} cannot be encoded as JPEG, '
            'expected uint8 (H, W, 3) or (H, W)'
        )
    bgr = cv2.cvtColor(image, cv2.COLOR_RGB2BGR) if image.ndim == 3 else image
    return _encode('.jpg', bgr, [cv2.IMWRITE_JPEG_QUALITY, int(quality)])


def encode_depth(depth: NDArray[np.uint16] | NDArray[np.float32]) -> bytes:
    """Return depth (H, W) as 16-bit PNG in mm; missing and beyond 65.535 m become 0."""
    if depth.ndim != 2 or depth.size == 0 or depth.dtype not in (np.uint16, np.float32):
        raise VisionError(
            f'depth of type {depth.dtype} and shape {depth.shape} cannot be encoded as PNG, '
            'expected uint16 mm or float32 m (H, W)'
        )
    if depth.dtype != np.uint16:
        millimetres = np.rint(depth_in_metres(depth) * np.float32(1000.0))
        depth = np.where(millimetres <= _LARGEST_DEPTH, millimetres, 0.0).astype(np.uint16)
    return _encode('.png', depth, [cv2.IMWRITE_PNG_COMPRESSION, _FASTEST])


def _encode(suffix: str, image: NDArray[Any], options: list[int]) -> bytes:
    done, data = cv2.imencode(suffix, image, options)
    if not done:
        raise VisionError(f'image of shape {image.shape} could not be encoded as {suffix}')
    return bytes(data.tobytes())


def decode_compressed(data: bytes) -> NDArray[Any]:
    """Return the image of a sensor_msgs/CompressedImage.

    Colour is returned as RGB uint8 (H, W, 3), grey as uint8 (H, W), depth as uint16 mm (H, W).
    Depth quantised by compressed_depth_image_transport is float32 m (H, W), NaN if missing.
    """
    payload = bytes(data)
    header = None
    if payload[:8] != _PNG and payload[_DEPTH_HEADER.size :][:8] == _PNG:
        header = _DEPTH_HEADER.unpack_from(payload)
        payload = payload[_DEPTH_HEADER.size :]
    try:
        image = cv2.imdecode(np.frombuffer(payload, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        image = None
    if image is None:
        raise VisionError(
            f'{len(data)} bytes starting with {payload[:8]!r} are not an image, '
            'expected JPEG or PNG'
        )
    if header is not None and header[1] != 0.0 and image.dtype == np.uint16:
        return _from_inverse_depth(image, header[1], header[2])
    if image.ndim == 3:
        code = cv2.COLOR_BGRA2RGB if image.shape[2] == 4 else cv2.COLOR_BGR2RGB
        image = cv2.cvtColor(image, code)
    return np.asarray(image)


def _from_inverse_depth(image: NDArray[np.uint16], a: float, b: float) -> NDArray[np.float32]:
    """Return depth (H, W) m from quantised inverse depth, value = a / depth + b; 0 is missing."""
    scaled = image.astype(np.float32) - np.float32(b)
    valid = (image > 0) & (scaled > 0.0)
    return np.where(valid, np.float32(a) / np.where(valid, scaled, 1.0), np.nan).astype(np.float32)
