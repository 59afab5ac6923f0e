"""The simulated Kinect: adds sensor noise to rendered colour and depth."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from explore_slam.data import Intrinsics, RgbdFrame
from explore_slam.simulation.config import SimulatedKinectConfig

# pixels; a Kinect v1 finds the disparity of a pixel by matching a window of 9 x 9 around it
# (Konolige and Mihelich, Technical description of Kinect calibration, 2011)
_MATCHING_WINDOW = 9
_LEAST_SHIFT = 0.01  # pixels, of the last row against the first; features are found to 0.1


def camera_intrinsics(config: SimulatedKinectConfig) -> Intrinsics:
    """Return the pinhole parameters; pixel centres have integer coordinates."""
    width, height = config.simulated_image_width, config.simulated_image_height
    focal = 0.5 * width / math.tan(0.5 * math.radians(config.simulated_camera_angle))
    return Intrinsics(width, height, focal, focal, 0.5 * (width - 1), 0.5 * (height - 1))


class KinectSensor:
    """Noise of a Kinect v1: constant in colour, growing with the square of depth.

    Depth noise after Khoshelham and Elberink (Sensors 12, 2012): the deviation is proportional to
    the squared depth. Neighbouring pixels share most of it, since the windows that they were
    matched by overlap: a median over them removes little. Depth is rounded to mm (uint16); 0 marks
    invalid depth.

    Normal deviates are taken from a precomputed bank at a random offset per frame: a frame needs
    more than a million, and drawing them would take longer than rendering.
    """

    def __init__(self, config: SimulatedKinectConfig, rng: np.random.Generator) -> None:
        self._config = config
        self._rng = rng
        self.intrinsics = camera_intrinsics(config)
        pixels = config.simulated_image_width * config.simulated_image_height
        self._depth_bank = _correlated_normals(
            rng, 2 * config.simulated_image_height, 2 * config.simulated_image_width
        )
        normal = rng.standard_normal(6 * pixels, dtype=np.float32)
        grey_levels = np.rint(normal * np.float32(config.simulated_color_noise))
        self._color_bank = np.clip(grey_levels, -127, 127).astype(np.int16)

    def measure(
        self,
        stamp: float,
        color: NDArray[np.uint8],
        distance: NDArray[np.float32],
        turn_rate: float = 0.0,
    ) -> RgbdFrame:
        """Return the frame for colour (H, W, 3) and depth (H, W) m, both bottom row first.

        turn_rate (rad/s): of the camera to the left. The rows are exposed one after another, the
        middle one at the stamp: while the camera turns, they shift against each other.
        """
        shift = turn_rate * self._config.simulated_readout_time * self.intrinsics.fx
        color, distance = color[::-1], distance[::-1]
        if abs(shift) > _LEAST_SHIFT:
            color, distance = _sheared(color, distance, shift)
        return RgbdFrame(stamp, self._colors(color), self._depths(distance), self.intrinsics)

    def _colors(self, color: NDArray[np.uint8]) -> NDArray[np.uint8]:
        if self._config.simulated_color_noise == 0.0:
            return np.ascontiguousarray(color)
        start = int(self._rng.integers(0, self._color_bank.size - color.size))
        noise = self._color_bank[start : start + color.size].reshape(color.shape)
        noisy = color + noise
        np.clip(noisy, 0, 255, out=noisy)
        return noisy.astype(np.uint8)

    def _depths(self, distance: NDArray[np.float32]) -> NDArray[np.uint16]:
        config = self._config
        height, width = distance.shape
        row, column = self._rng.integers(0, [height, width], endpoint=True)
        noise = self._depth_bank[row : row + height, column : column + width]
        scale = np.float32(1000.0 * config.simulated_depth_noise)
        measured = distance * np.float32(1000.0) + scale * distance * distance * noise
        np.rint(measured, out=measured)
        near, far = 1000.0 * config.simulated_min_depth, 1000.0 * config.simulated_max_depth
        measured[(measured < near) | (measured > far)] = 0.0
        return measured.astype(np.uint16)


def _sheared(
    color: NDArray[np.uint8], distance: NDArray[np.float32], shift: float
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Return images whose rows are moved to the right, the last by a shift (px) against the first.

    The middle row stays. Colour is interpolated; depth is not, since there is none between a thing
    and what is behind it. Beyond the sides, the outermost column is repeated.
    """
    height, width = distance.shape
    margin = math.ceil(0.5 * abs(shift)) + 1
    pixels = np.pad(color, ((0, 0), (margin, margin), (0, 0)), mode='edge').astype(np.float32)
    depths = np.pad(distance, ((0, 0), (margin, margin)), mode='edge')
    sheared, moved = np.empty(color.shape, np.uint8), np.empty(distance.shape, np.float32)
    for row in range(height):
        own = shift * ((row + 0.5) / height - 0.5)
        # each pixel comes from between two pixels, the first one from `left` and the next
        left = margin - math.ceil(own)
        part = np.float32(math.ceil(own) - own)  # of the right one of the two
        before, after = (slice(left + k, left + k + width) for k in (0, 1))
        sheared[row] = np.rint((1.0 - part) * pixels[row, before] + part * pixels[row, after])
        moved[row] = depths[row, after if part > 0.5 else before]
    return sheared, moved


def _correlated_normals(rng: np.random.Generator, rows: int, columns: int) -> NDArray[np.float32]:
    """Return standard normal deviates (rows, columns), means over the matching window."""
    white = rng.standard_normal((rows, columns), dtype=np.float32)
    # of n² deviates, the mean has a deviation of 1/n
    means = uniform_filter(white, _MATCHING_WINDOW, mode='wrap')
    return np.asarray(means * np.float32(_MATCHING_WINDOW), dtype=np.float32)
