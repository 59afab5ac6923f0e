"""The camera: a Kinect v1 through libfreenect's Python binding (`freenect`), which is optional."""

import logging
import math
import queue
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import Intrinsics, RgbdFrame
from explore_slam.errors import VehicleError
from explore_slam.vehicle.driver_config import CameraConfig

_log = logging.getLogger(__name__)
WIDTH, HEIGHT = 640, 480
_TICKS = 1 << 32  # the device's stamps wrap here
_HALF_FRAME = 1_000_000 + 50_000  # ticks of 60 MHz: half of 1/30 s and some jitter
_RAW_NO_DATA = 2047
_FARTHEST = 10_000  # mm; registered depth is clamped here


class Image(NamedTuple):
    """One image of one sensor: the device's stamp (ticks), when it came (s), pixels."""

    ticks: int
    received: float
    pixels: NDArray[Any]


class StampPairing:
    """Pairs depth and colour by the device's stamps: at most half a frame apart."""

    def __init__(self) -> None:
        self._waiting: dict[str, deque[Image]] = {
            'depth': deque(maxlen=3),
            'color': deque(maxlen=3),
        }
        self.unpaired = 0

    def add(self, kind: str, image: Image) -> tuple[Image, Image] | None:
        """Take an image, 'depth' or 'color'; return (depth, color) once a pair is whole."""
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
    """Return 11 bit disparities (H, W) as mm; 0 is no data. 1 / (3.3309 - 0.0030711 raw) m."""
    table = np.zeros(2048)
    steps = np.arange(_RAW_NO_DATA)
    inverse = 3.3309495 - 0.0030711016 * steps
    valid = inverse > 1.0 / (0.001 * _FARTHEST)
    table[:_RAW_NO_DATA][valid] = 1000.0 / inverse[valid]
    millimetres: NDArray[np.uint16] = np.rint(table).astype(np.uint16)[np.minimum(raw, 2047)]
    return millimetres


class Kinect:
    """Reads pairs of colour and registered depth; one thread calls all of it.

    libfreenect is called in a thread of its own: its calls block for ever when the camera is
    pulled out. clock gives the stamps (s).
    """

    def __init__(self, config: CameraConfig, clock: Callable[[], float] = time.time) -> None:
        self.config = config
        self.frames = 0
        self.pairing = StampPairing()
        self._clock = clock
        self._freenect: Any = None
        self._images: queue.Queue[tuple[str, Image] | None] = queue.Queue(maxsize=8)
        self._reader: threading.Thread | None = None
        self._running = threading.Event()
        self._heard = 0.0
        self._published = -math.inf
        center = config.camera_center
        focal = config.camera_focal_length
        self.intrinsics = Intrinsics(WIDTH, HEIGHT, focal, focal, center[0], center[1])

    def connect(self) -> str:
        """Open the camera and start to read; raises VehicleError that says what to do."""
        self.close()
        if self._reader is not None and self._reader.is_alive():
            raise VehicleError(
                f'Kinect {self.config.camera_index}: libfreenect hangs since the camera was lost; '
                'plug it in again and restart the driver'
            )
        self._freenect = _import_freenect()
        if self._freenect.sync_get_depth(self.config.camera_index, self._depth_format()) is None:
            raise VehicleError(
                f'Kinect {self.config.camera_index}: not found or busy; is it plugged in, is its '
                'power supply on, do the udev rules of libfreenect let this user open it?'
            )
        self._images = queue.Queue(maxsize=8)
        self._running = threading.Event()
        self._running.set()
        self._reader = threading.Thread(
            target=self._read, args=(self._running, self._images), name='kinect', daemon=True
        )
        self._reader.start()
        self._heard = time.monotonic()
        return f'Kinect {self.config.camera_index}'

    def _depth_format(self) -> int:
        raw = self.config.camera_depth == 'raw'
        freenect = self._freenect
        return int(freenect.DEPTH_11BIT if raw else freenect.DEPTH_REGISTERED)

    def _read(self, running: threading.Event, images: 'queue.Queue[Any]') -> None:
        freenect, index = self._freenect, self.config.camera_index
        while running.is_set():
            for kind in ('depth', 'color'):
                if kind == 'depth':
                    got = freenect.sync_get_depth(index, self._depth_format())
                else:
                    got = freenect.sync_get_video(index, freenect.VIDEO_RGB)
                if got is None:
                    images.put(None)
                    return
                pixels, ticks = got
                image = Image(int(ticks), self._clock(), np.array(pixels))  # freenect's own buffer
                try:
                    images.put_nowait((kind, image))
                except queue.Full:  # nobody polls: the newest will do
                    continue

    def poll(self, timeout: float) -> list[RgbdFrame]:
        """Return the frames that came within timeout (s), no more than camera_rate of them.

        Raises VehicleError when the camera is lost.
        """
        if self._reader is None:
            raise VehicleError(f'Kinect {self.config.camera_index}: not connected')
        frames: list[RgbdFrame] = []
        try:
            item = self._images.get(timeout=timeout)
            while True:
                if item is None:
                    raise VehicleError(f'Kinect {self.config.camera_index}: lost')
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
            raise VehicleError(f'Kinect {self.config.camera_index}: {text}')
        return frames

    def _frame(self, depth: Image, color: Image) -> list[RgbdFrame]:
        if depth.received - self._published < 0.9 / self.config.camera_rate:
            return []
        self._published = depth.received
        self.frames += 1
        millimetres = depth.pixels.astype(np.uint16)
        if self.config.camera_depth == 'raw':
            millimetres = raw_to_millimetres(millimetres)
        else:
            millimetres[millimetres >= _FARTHEST] = 0
        return [RgbdFrame(depth.received, color.pixels, millimetres, self.intrinsics)]

    def close(self) -> None:
        """End reading; never raises, never blocks for long."""
        self._running.clear()
        if self._reader is None:
            return
        self._reader.join(0.5)
        if not self._reader.is_alive():
            self._freenect.sync_stop()
            self._reader = None


def _import_freenect() -> Any:
    try:
        import freenect
    except ImportError as error:
        raise VehicleError(
            f'the Kinect needs the Python binding of libfreenect ({error}): '
            '`apt install libfreenect-dev`, then `pip install freenect`; '
            'without a Kinect set use_camera to false'
        ) from error
    return freenect
