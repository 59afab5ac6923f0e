"""Reading of compressed images: JPEG colour and 16-bit PNG depth, as image_transport writes."""

import struct
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from explore_slam.errors import VisionError

_PNG = b'\x89PNG\r\n\x1a\n'  # the first bytes of every PNG file
_DEPTH_HEADER = struct.Struct('<iff')  # of compressed_depth_image_transport: format, a, b


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
