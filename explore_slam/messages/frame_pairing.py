"""Pairs colour and depth images of one camera by stamp, and joins the camera's description."""

from collections import deque
from typing import Any

from explore_slam.data import Intrinsics, RgbdFrame
from explore_slam.errors import DataError
from explore_slam.messages import (
    color_array,
    depth_array,
    intrinsics_record,
    seconds,
)
from explore_slam.vision import decode_compressed


class FramePairing:
    """Keeps the newest images of either kind until their partner comes.

    Feeding methods return a frame when one is complete, else None. Malformed images raise
    DataError; an image whose partner never comes is counted in `unpaired`.
    """

    def __init__(self, tolerance: float = 0.02, depth: int = 6) -> None:
        self._tolerance = tolerance
        self._colors: deque[tuple[float, Any]] = deque()
        self._depths: deque[tuple[float, Any]] = deque()
        self._most = depth
        self._intrinsics: Intrinsics | None = None
        self.unpaired = 0
        self.without_camera_info = 0

    def add_camera_info(self, message: Any) -> None:
        """Take the camera's description; it holds for all later frames."""
        self._intrinsics = intrinsics_record(message)

    def add_color(self, message: Any) -> RgbdFrame | None:
        """Take a colour image (raw, or compressed)."""
        return self._add(message, self._colors, self._depths)

    def add_depth(self, message: Any) -> RgbdFrame | None:
        """Take a registered depth image (raw, or compressed PNG)."""
        return self._add(message, self._depths, self._colors)

    def _add(
        self,
        message: Any,
        own: deque[tuple[float, Any]],
        partners: deque[tuple[float, Any]],
    ) -> RgbdFrame | None:
        stamp = seconds(message.header.stamp)
        if (
            own and stamp < own[-1][0] - 1.0
        ):  # the clock jumped back: the others are of another time
            self.unpaired += len(own) + len(partners)
            own.clear()
            partners.clear()
        for other in partners:
            if abs(other[0] - stamp) <= self._tolerance:
                partners.remove(other)
                self._drop_older(partners, other[0])
                self._drop_older(own, stamp)
                color, depth = (message, other[1]) if own is self._colors else (other[1], message)
                return self._frame(color, depth)
        own.append((stamp, message))
        if len(own) > self._most:
            own.popleft()
            self.unpaired += 1
        return None

    def _drop_older(self, images: deque[tuple[float, Any]], stamp: float) -> None:
        while images and images[0][0] <= stamp:
            images.popleft()
            self.unpaired += 1

    def _frame(self, color: Any, depth: Any) -> RgbdFrame | None:
        if self._intrinsics is None:
            self.without_camera_info += 1
            return None
        rgb = _pixels(color, color_array)
        meters = _pixels(depth, depth_array)
        return RgbdFrame(seconds(color.header.stamp), rgb, meters, self._intrinsics)


def _pixels(message: Any, raw: Any) -> Any:
    if hasattr(message, 'encoding'):
        return raw(message)
    try:
        return decode_compressed(bytes(message.data))
    except Exception as error:
        raise DataError(f'compressed image of format {message.format!r}: {error}') from error
