"""Compressed images as other drivers publish them."""

import cv2
import numpy as np


def jpeg(image: np.ndarray, quality: int = 95) -> bytes:
    """Return an RGB image (H, W, 3) or a grey one (H, W) as JPEG."""
    bgr = cv2.cvtColor(image, cv2.COLOR_RGB2BGR) if image.ndim == 3 else image
    return _encoded('.jpg', bgr, [cv2.IMWRITE_JPEG_QUALITY, quality])


def png(image: np.ndarray) -> bytes:
    """Return an RGB image (H, W, 3) or depth (H, W) uint16 as PNG."""
    return _encoded('.png', cv2.cvtColor(image, cv2.COLOR_RGB2BGR) if image.ndim == 3 else image)


def _encoded(suffix: str, image: np.ndarray, options: list[int] | None = None) -> bytes:
    done, data = cv2.imencode(suffix, image, options or [])
    assert done
    return data.tobytes()
