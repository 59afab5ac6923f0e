"""RGB-D frames: colour and depth images of one camera paired by stamp, with its intrinsics."""

from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

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
from explore_slam.messages.measurement import (
    MeasurementKind,
    RefusedMessageError,
    TopicMessages,
)
from explore_slam.messages.sensor_mounts import SensorMounts
from explore_slam.messages.topics import COLOR_TOPICS, DEPTH_TOPICS, TopicKind
from explore_slam.messages.vehicle_settings import VehicleConfig
from explore_slam.vision import decode_compressed

CLOCK_JUMP = 1.0  # s; a stamp that is older by more than this belongs to a restarted clock
PAIRING_DEPTH = 6  # images of either kind that wait; 0.2 s at 30 Hz

# names of what could not be used
UNPAIRED, WITHOUT_CAMERA_INFO = 'unpaired_images', 'frames_without_camera_info'


class _Image(NamedTuple):
    stamp: float
    message: Any
    topic: TopicKind


_Images = deque[_Image]


class FramePairing:
    """Keeps the newest images of either kind until their partner arrives.

    The add methods return a frame when one is complete, else None. Malformed images raise
    RefusedMessageError with the topic they came on. An image that comes raw and compressed is
    used once: the second one with its stamp is ignored.

    mounts: of the vehicle's sensors, for the pose of the camera.
    sensor: which of the vehicle's cameras it is; '' is the only one.
    tolerance: largest difference of the stamps of a pair (s); default: the vehicle's setting.
    unpaired: images whose partner never arrived.
    without_camera_info: pairs that arrived before any camera_info.
    """

    def __init__(
        self,
        mounts: SensorMounts | None = None,
        sensor: str = '',
        tolerance: float | None = None,
        depth: int = PAIRING_DEPTH,
    ) -> None:
        self._mounts = mounts
        self._sensor = sensor
        config = VehicleConfig() if mounts is None else mounts.config
        self._tolerance = config.pairing_tolerance if tolerance is None else tolerance
        self._colors: _Images = deque()
        self._depths: _Images = deque()
        self._depth = depth
        self._paired: deque[tuple[bool, float]] = deque(maxlen=2 * depth)
        self._intrinsics: Intrinsics | None = None
        self.unpaired = 0
        self.without_camera_info = 0

    def read(self, topic: TopicKind, message: Any) -> RgbdFrame | None:
        """Add the message of a topic of the camera."""
        if topic in COLOR_TOPICS:
            return self.add_color(message, topic)
        if topic in DEPTH_TOPICS:
            return self.add_depth(message, topic)
        self.add_camera_info(message)
        return None

    def losses(self) -> Mapping[str, int]:
        """Return what could not be used so far, by name."""
        return {UNPAIRED: self.unpaired, WITHOUT_CAMERA_INFO: self.without_camera_info}

    def explanations(self) -> Mapping[str, str]:
        """Return name of a loss -> why, as the end of a sentence that begins with the number."""
        return {
            UNPAIRED: (
                'images have no partner, colour or depth, whose stamp differs by at most '
                f'{1e3 * self._tolerance:g} ms (pairing_tolerance)'
            ),
            WITHOUT_CAMERA_INFO: 'frames came before any camera_info',
        }

    def add_camera_info(self, message: Any) -> None:
        """Set the intrinsics of all later frames."""
        self._intrinsics = intrinsics_record(message)

    def add_color(self, message: Any, topic: TopicKind = TopicKind.COLOR) -> RgbdFrame | None:
        """Add a colour image, raw or compressed."""
        return self._add(message, topic, self._colors, self._depths)

    def add_depth(self, message: Any, topic: TopicKind = TopicKind.DEPTH) -> RgbdFrame | None:
        """Add a registered depth image, raw or compressed as PNG."""
        return self._add(message, topic, self._depths, self._colors)

    def _add(
        self, message: Any, topic: TopicKind, own: _Images, partners: _Images
    ) -> RgbdFrame | None:
        image = _Image(seconds(message.header.stamp), message, topic)
        stamp = image.stamp
        is_color = own is self._colors
        if own and stamp < own[-1].stamp - CLOCK_JUMP:
            self.unpaired += len(own) + len(partners)
            own.clear()
            partners.clear()
            self._paired.clear()
        if (is_color, stamp) in self._paired or any(other.stamp == stamp for other in own):
            return None  # the same image in its other form
        for other in partners:
            if abs(other.stamp - stamp) <= self._tolerance:
                partners.remove(other)
                self._drop_older(partners, other.stamp)
                self._drop_older(own, stamp)
                self._paired.extend(((is_color, stamp), (not is_color, other.stamp)))
                return self._frame(*((image, other) if is_color else (other, image)))
        own.append(image)
        if len(own) > self._depth:
            own.popleft()
            self.unpaired += 1
        return None

    def _drop_older(self, images: _Images, stamp: float) -> None:
        while images and images[0].stamp <= stamp:
            images.popleft()
            self.unpaired += 1

    def _frame(self, color: _Image, depth: _Image) -> RgbdFrame | None:
        if self._intrinsics is None:
            self.without_camera_info += 1
            return None
        rgb = _pixels(color, color_array)
        metres = _pixels(depth, depth_array)
        mount = None
        if self._mounts is not None:
            frame = color.message.header.frame_id
            self._mounts.check_registered(frame, depth.message.header.frame_id)
            mount = self._mounts.optical_pose(frame, self._sensor)
        return RgbdFrame(color.stamp, rgb, metres, self._intrinsics, mount)


def _pixels(image: _Image, raw: Callable[[Any], Any]) -> Any:
    message = image.message
    try:
        if hasattr(message, 'encoding'):
            return raw(message)
        return decode_compressed(bytes(message.data))
    except DataError as error:
        raise RefusedMessageError(str(error), image.topic) from error
    except VisionError as error:
        text = f'compressed image of format {message.format!r}: {error}'
        raise RefusedMessageError(text, image.topic) from error


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
    write=lambda factory, frames, frame: frame_messages(
        factory, frames.camera_frame(frame.sensor), frame
    ),
    queue_limit=4,
    expected=(TopicKind.COLOR, TopicKind.DEPTH, TopicKind.CAMERA_INFO),
    vision='agent',
    high_bandwidth=True,
    camera=True,
)
