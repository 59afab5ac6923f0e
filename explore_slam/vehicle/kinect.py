"""Driver of a Kinect v1 through libfreenect's Python binding `freenect`, which is optional."""

import logging
import math
import queue
import threading
import time
from collections import deque
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import Intrinsics, RgbdFrame
from explore_slam.errors import VehicleError
from explore_slam.settings import Section, setting
from explore_slam.vehicle.devices import Clock, Progress, Statistics
from explore_slam.vehicle.driver_config import CameraConfig
from explore_slam.vehicle.kinect_models import advice, kinect_model

_log = logging.getLogger(__name__)
WIDTH, HEIGHT = 640, 480
_TICKS = 1 << 32  # stamps of the device wrap here
_HALF_FRAME = 1_000_000 + 50_000  # ticks of 60 MHz: half a period of 30 Hz, and jitter
_RAW_NO_DATA = 2047  # 11-bit disparity without a measurement
_FARTHEST = 10_000  # mm; libfreenect clamps registered depth here
# depth = 1 / (offset + slope * disparity) m: the first-order fit of the OpenKinect wiki (page
# "Imaging Information")
_RAW_OFFSET, _RAW_SLOPE = 3.3309495, -0.0030711016
_QUEUE_LENGTH = 8  # images
_EARLY = 0.9  # of a period of camera_rate that must have passed since the last frame
_CLOSE_TIMEOUT = 0.5  # s
_OPENING_TIME = 2.0  # s that libfreenect takes to open a Kinect, beside camera_timeout
_LONGEST_WAIT = 0.1  # s after which an interruption is noticed


class Image(NamedTuple):
    """An image of one sensor: stamp of the device (ticks), time of receipt (s), pixels."""

    ticks: int
    received: float
    pixels: NDArray[Any]


class StampPairing:
    """Pairs depth and colour images whose device stamps differ by at most half a period."""

    def __init__(self) -> None:
        self._waiting: dict[str, deque[Image]] = {
            'depth': deque(maxlen=3),
            'color': deque(maxlen=3),
        }
        self.unpaired = 0

    def add(self, kind: str, image: Image) -> tuple[Image, Image] | None:
        """Add an image ('depth' or 'color'); return (depth, colour) if it completes a pair."""
        other = self._waiting['color' if kind == 'depth' else 'depth']
        for partner in other:
            gap = (image.ticks - partner.ticks + _TICKS // 2) % _TICKS - _TICKS // 2
            if abs(gap) <= _HALF_FRAME:
                while other[0] is not partner:
                    other.popleft()
                    self.unpaired += 1
                other.popleft()
                self.unpaired += len(self._waiting[kind])
                self._waiting[kind].clear()
                return (image, partner) if kind == 'depth' else (partner, image)
        if len(self._waiting[kind]) == self._waiting[kind].maxlen:
            self.unpaired += 1
        self._waiting[kind].append(image)
        return None


def raw_to_millimetres(raw: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Convert 11-bit disparities (H, W) to depth in mm; 0 is no data."""
    table = np.zeros(_RAW_NO_DATA + 1)
    steps = np.arange(_RAW_NO_DATA)
    inverse = _RAW_OFFSET + _RAW_SLOPE * steps
    valid = inverse > 1.0 / (0.001 * _FARTHEST)
    table[:_RAW_NO_DATA][valid] = 1000.0 / inverse[valid]
    millimetres: NDArray[np.uint16] = np.rint(table).astype(np.uint16)[
        np.minimum(raw, _RAW_NO_DATA)
    ]
    return millimetres


@dataclass(frozen=True)
class KinectConfig(Section):
    """Settings of a Kinect beside those of any camera."""

    camera_index: int = setting(
        0, 'Index of the Kinect among those connected', low=0, high=15, tier='basic'
    )
    camera_depth: str = setting(
        'registered',
        'registered: depth in mm, which libfreenect has moved from the infrared to the colour '
        'camera (2.5 cm apart); raw: disparities converted by a formula, not registered: objects '
        'at 1 m are about 20 columns beside their colour',
        choices=('registered', 'raw'),
    )
    camera_focal_length: float = setting(
        525.0, 'Focal length of the colour camera', unit='pixels', low=100.0, high=2000.0
    )
    camera_center_x: float = setting(
        319.5, 'Column of the principal point', unit='pixels', low=0.0, high=640.0
    )
    camera_center_y: float = setting(
        239.5, 'Row of the principal point', unit='pixels', low=0.0, high=480.0
    )


class Kinect:
    """A Kinect v1 (protocols Camera and SlowDevice): pairs of colour and registered depth.

    libfreenect is called in a separate thread, since its calls never return once the camera is
    unplugged. clock gives the stamps (s).
    """

    def __init__(
        self,
        config: CameraConfig,
        own: KinectConfig | None = None,
        clock: Clock = time.time,
    ) -> None:
        self.config = config
        self.own = own or KinectConfig()
        self.frames = 0
        self.pairing = StampPairing()
        self._clock = clock
        self._freenect: Any = None
        self._images: queue.Queue[tuple[str, Image] | None] = queue.Queue(_QUEUE_LENGTH)
        self._reader: threading.Thread | None = None
        self._running = threading.Event()
        self._heard = 0.0
        self._published = -math.inf
        self.progress = Progress()
        focal = self.own.camera_focal_length
        self.intrinsics = Intrinsics(
            WIDTH, HEIGHT, focal, focal, self.own.camera_center_x, self.own.camera_center_y
        )

    def connect(self) -> str:
        """Open the camera and start reading; raises VehicleError that says what to do."""
        self.close()
        if self._reader is not None and self._reader.is_alive():
            raise VehicleError(
                f'Kinect {self.own.camera_index}: libfreenect has hung since the camera was '
                'lost; plug it in again and restart the driver'
            )
        self._freenect = _import_freenect()
        self._images = queue.Queue(_QUEUE_LENGTH)
        self._running = threading.Event()
        self._running.set()
        self._reader = threading.Thread(
            target=self._read, args=(self._running, self._images), name='kinect', daemon=True
        )
        self._reader.start()
        self._await_images()
        model = kinect_model()
        raw = self.own.camera_depth == 'raw'
        aligned = 'depth is not registered to colour' if raw else 'depth registered to colour'
        return f'Kinect {", ".join(filter(None, (str(self.own.camera_index), model, aligned)))}'

    def _await_images(self) -> None:
        """Wait for the first image of each sensor; VehicleError when they do not come in time."""
        missing = ['depth', 'color']
        limit = _OPENING_TIME + self.config.camera_timeout
        end = time.monotonic() + limit
        name = f'Kinect {self.own.camera_index}'
        while missing:
            try:
                item = self._images.get(timeout=_LONGEST_WAIT)
            except queue.Empty:
                if time.monotonic() < end and not self.progress.interrupted.is_set():
                    continue
                self._running.clear()
                hint = advice()
                raise VehicleError(
                    f'{name}: opened, but no {" or ".join(missing)} image came for {limit:.0f} s; '
                    'plug it into another USB port (USB 2, without a hub), check its power '
                    f'supply, and restart the driver{"; " if hint else ""}{hint}'
                ) from None
            if item is None:
                hint = advice()
                raise VehicleError(
                    f'{name}: not found or busy; is it plugged in, is its '
                    'power supply on, do the udev rules of libfreenect allow this user to open '
                    f'it?{" " if hint else ""}{hint}'
                )
            if item[0] in missing:
                missing.remove(item[0])
        self._heard = time.monotonic()

    def suspend(self) -> None:
        """Give up the camera after a failure, like close."""
        self.close()

    def _depth_format(self) -> int:
        raw = self.own.camera_depth == 'raw'
        freenect = self._freenect
        return int(freenect.DEPTH_11BIT if raw else freenect.DEPTH_REGISTERED)

    def _read(self, running: threading.Event, images: 'queue.Queue[Any]') -> None:
        """Put images into the queue until asked to stop; None marks the loss of the camera."""
        freenect, index = self._freenect, self.own.camera_index
        while running.is_set():
            for kind in ('depth', 'color'):
                if kind == 'depth':
                    got = freenect.sync_get_depth(index, self._depth_format())
                else:
                    got = freenect.sync_get_video(index, freenect.VIDEO_RGB)
                if got is None:
                    images.put(None)
                    return
                if not running.is_set():  # the call was given up
                    return
                pixels, ticks = got
                image = Image(
                    int(ticks), self._clock(), np.array(pixels)
                )  # copied: freenect reuses it
                try:
                    images.put_nowait((kind, image))
                except queue.Full:  # not polled: drop the image
                    continue

    def poll(self, timeout: float) -> list[RgbdFrame]:
        """Return the frames received within timeout (s), at most camera_rate per second.

        Raises VehicleError when the camera is lost.
        """
        if self._reader is None:
            raise VehicleError(f'Kinect {self.own.camera_index}: not connected')
        frames: list[RgbdFrame] = []
        try:
            item = self._images.get(timeout=timeout)
            while True:
                if item is None:
                    raise VehicleError(f'Kinect {self.own.camera_index}: lost')
                self._heard = time.monotonic()
                pair = self.pairing.add(*item)
                if pair is not None:
                    frames += self._frame(*pair)
                item = self._images.get_nowait()
        except queue.Empty:
            pass
        silent = time.monotonic() - self._heard
        if silent > self.config.camera_timeout:
            text = f'no image for {silent:.0f} s; is it plugged in?'
            raise VehicleError(f'Kinect {self.own.camera_index}: {text}')
        return frames

    def _frame(self, depth: Image, color: Image) -> list[RgbdFrame]:
        """Return the frame of a pair; none if the last frame was published too recently."""
        if depth.received - self._published < _EARLY / self.config.camera_rate:
            return []
        self._published = depth.received
        self.frames += 1
        millimetres = depth.pixels.astype(np.uint16)
        if self.own.camera_depth == 'raw':
            millimetres = raw_to_millimetres(millimetres)
        else:
            millimetres[millimetres >= _FARTHEST] = 0
        return [RgbdFrame(depth.received, color.pixels, millimetres, self.intrinsics)]

    def close(self) -> None:
        """Stop reading; never raises, returns within a second."""
        self._running.clear()
        if self._reader is None:
            return
        self._reader.join(_CLOSE_TIMEOUT)
        if not self._reader.is_alive():
            self._freenect.sync_stop()
            self._reader = None

    def statistics(self) -> Statistics:
        """Return counters for diagnostics."""
        return {'frames': self.frames, 'unpaired': self.pairing.unpaired}


def _import_freenect() -> Any:
    try:
        import freenect
    except ImportError as error:
        raise VehicleError(
            f'the Kinect needs the Python binding of libfreenect ({error}): '
            '`apt install libfreenect-dev`, then `pip install freenect`; '
            'without a Kinect, set enable_camera to false'
        ) from error
    return freenect
