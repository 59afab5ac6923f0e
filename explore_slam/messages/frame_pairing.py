"""RGB-D frames: colour and depth images of one camera paired by stamp, with its intrinsics."""

from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from explore_slam.data import Intrinsics, RgbdFrame
from explore_slam.errors import DataError, VisionError
from explore_slam.messages.base import MessageFactory, seconds
from explore_slam.messages.images import (
    camera_info_message,
    color_array,
    depth_array,
    image_message,
    intrinsics_record,
)
from explore_slam.messages.measurement import MeasurementKind, TopicMessages
from explore_slam.messages.sensor_mounts import SensorMounts
from explore_slam.messages.topics import COLOR_TOPICS, DEPTH_TOPICS, TopicKind
from explore_slam.vision import decode_compressed

CLOCK_JUMP = 1.0  # s; a stamp that is older by more than this belongs to a restarted clock
# s; half the period of a Kinect at 30 Hz is 0.017 s, and its two sensors are not synchronized
PAIRING_TOLERANCE = 0.02
PAIRING_DEPTH = 6  # images of either kind that wait; 0.2 s at 30 Hz

_Images = deque[tuple[float, Any]]


class FramePairing:
    """Keeps the newest images of either kind until their partner arrives.

    The add methods return a frame when one is complete, else None. Malformed images raise
    DataError.

    mounts: of the vehicle's sensors, for the pose of the camera.
    unpaired: images whose partner never arrived.
    without_camera_info: pairs that arrived before any camera_info.
    """

    def __init__(
        self,
        mounts: SensorMounts | None = None,
        tolerance: float = PAIRING_TOLERANCE,
        depth: int = PAIRING_DEPTH,
    ) -> None:
        self._mounts = mounts
        self._tolerance = tolerance
        self._colors: _Images = deque()
        self._depths: _Images = deque()
        self._depth = depth
        self._intrinsics: Intrinsics | None = None
        self.unpaired = 0
        self.without_camera_info = 0

    def read(self, topic: TopicKind, message: Any) -> RgbdFrame | None:
        """Add the message of a topic of the camera."""
        if topic in COLOR_TOPICS:
            return self.add_color(message)
        if topic in DEPTH_TOPICS:
            return self.add_depth(message)
        self.add_camera_info(message)
        return None

    def losses(self) -> Mapping[str, int]:
        """Return what could not be used so far, by name."""
        return {
            'unpaired_images': self.unpaired,
            'frames_without_camera_info': self.without_camera_info,
        }

    def add_camera_info(self, message: Any) -> None:
        """Set the intrinsics of all later frames."""
        self._intrinsics = intrinsics_record(message)

    def add_color(self, message: Any) -> RgbdFrame | None:
        """Add a colour image, raw or compressed."""
        return self._add(message, self._colors, self._depths)

    def add_depth(self, message: Any) -> RgbdFrame | None:
        """Add a registered depth image, raw or compressed as PNG."""
        return self._add(message, self._depths, self._colors)

    def _add(self, message: Any, own: _Images, partners: _Images) -> RgbdFrame | None:
        stamp = seconds(message.header.stamp)
        if own and stamp < own[-1][0] - CLOCK_JUMP:
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
        if len(own) > self._depth:
            own.popleft()
            self.unpaired += 1
        return None

    def _drop_older(self, images: _Images, stamp: float) -> None:
        while images and images[0][0] <= stamp:
            images.popleft()
            self.unpaired += 1

    def _frame(self, color: Any, depth: Any) -> RgbdFrame | None:
        if self._intrinsics is None:
            self.without_camera_info += 1
            return None
        rgb = _pixels(color, color_array)
        metres = _pixels(depth, depth_array)
        mount = None
        if self._mounts is not None:
            mount = self._mounts.optical_pose(color.header.frame_id)
        return RgbdFrame(seconds(color.header.stamp), rgb, metres, self._intrinsics, mount)


def _pixels(message: Any, raw: Callable[[Any], Any]) -> Any:
    if hasattr(message, 'encoding'):
        return raw(message)
    try:
        return decode_compressed(bytes(message.data))
    except VisionError as error:
        raise DataError(f'compressed image of format {message.format!r}: {error}') from error


def frame_messages(factory: MessageFactory, frame_id: str, frame: RgbdFrame) -> TopicMessages:
    """Return camera_info, depth and colour image of a frame, all with its stamp.

    frame_id: optical frame of the camera. The camera_info comes first, so that a receiver knows
    it when the images arrive.
    """
    color = 'mono8' if frame.rgb.ndim == 2 else 'rgb8'
    depth = '16UC1' if frame.depth.dtype.kind == 'u' else '32FC1'
    stamp = frame.stamp
    return [
        (
            TopicKind.CAMERA_INFO,
            camera_info_message(factory, stamp, frame_id, frame.intrinsics),
        ),
        (TopicKind.DEPTH, image_message(factory, stamp, frame_id, depth, frame.depth)),
        (TopicKind.COLOR, image_message(factory, stamp, frame_id, color, frame.rgb)),
    ]


FRAME = MeasurementKind(
    name='frame',
    topics=(*COLOR_TOPICS, *DEPTH_TOPICS, TopicKind.CAMERA_INFO),
    reader=FramePairing,
    write=lambda factory, frames, frame: frame_messages(factory, frames.camera, frame),
    queue_limit=4,
    expected=(TopicKind.COLOR, TopicKind.DEPTH, TopicKind.CAMERA_INFO),
    vision='agent',
    high_bandwidth=True,
)
