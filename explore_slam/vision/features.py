"""RGB-D frame -> landmark observations: features with a position in space and its covariance.

1. Find the valid depth measurements and their edges (analyse_depth).
2. Detect keypoints where depth is valid.
3. Take the strongest of each image cell within the feature budget, and describe these only.
4. Back-project them, with the covariance of pixel and depth noise, into the vehicle frame.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from explore_slam.data import LandmarkObservations, RgbdFrame, TagObservations
from explore_slam.errors import VisionError
from explore_slam.geometry import Array
from explore_slam.vision.camera_mount import CameraMount
from explore_slam.vision.config import VisionConfig
from explore_slam.vision.depth import DepthLayers, analyse_depth, back_project, point_covariances
from explore_slam.vision.detectors import DETECTORS, Features
from explore_slam.vision.rolling_shutter import row_delays
from explore_slam.vision.sections import FeatureConfig
from explore_slam.vision.tags import TagDetector


class FeatureExtractor:
    """Extracts landmark observations in the vehicle frame from RGB-D frames.

    The same frame gives the same observations, bit for bit, whatever the number of threads.

    mount: of the camera, for frames without one; by default that of the settings.
    """

    def __init__(self, config: VisionConfig | None = None, mount: CameraMount | None = None):
        self.config = config or VisionConfig()
        if self.config.depth.min_depth >= self.config.depth.max_depth:
            raise VisionError(
                f'min_depth is {self.config.depth.min_depth} m and max_depth '
                f'{self.config.depth.max_depth} m, expected min_depth < max_depth'
            )
        self.mount = mount or CameraMount.from_config(self.config.mount)
        self.mount.check()
        self._detector = DETECTORS[self.config.feature_detector](self.config.features)
        self._tags = TagDetector(self.config.tags, self.mount)

    def detect(self, image: NDArray[np.uint8], mask: NDArray[np.bool_] | None = None) -> Features:
        """Return all features of an image (H, W, 3) RGB or (H, W), in a fixed order.

        mask (H, W): where features are searched; by default everywhere.
        """
        grey = _grey(image)
        return self._detector.describe(grey, self._detector.find(grey, mask))

    def extract(self, frame: RgbdFrame) -> LandmarkObservations:
        """Return the landmark observations of a frame, in the vehicle frame."""
        return self.extract_with_pixels(frame)[0]

    def observe_tags(self, frame: RgbdFrame) -> TagObservations | None:
        """Return the tags in a frame, in the vehicle frame; None where there are none."""
        if not self._tags.is_active:
            return None
        found = self._tags.observe(frame)
        return found if len(found) else None

    def extract_with_pixels(self, frame: RgbdFrame) -> tuple[LandmarkObservations, Features]:
        """Return the observations and, row by row, the image features from which they come."""
        camera = frame.intrinsics
        depth = analyse_depth(frame.depth, self.config.depth)
        features = self._detect_in_depth(_grey(frame.rgb), depth)
        columns, rows = _nearest_pixels(features.pixels, depth.depth.shape)
        depths = depth.depth[rows, columns].astype(np.float64)
        points = back_project(features.pixels, depths, camera)
        covariances = point_covariances(
            points,
            camera,
            np.full(len(depths), self.config.depth.pixel_noise),
            self._depth_noise(depths, depth.spread[rows, columns].astype(np.float64)),
        )
        mount = self.mount if frame.mount is None else CameraMount.from_optical(frame.mount)
        observations = LandmarkObservations(
            frame.stamp,
            mount.to_vehicle(points),
            mount.rotate_covariances(covariances),
            features.descriptors,
            self._delays(features.pixels, len(depth.depth)),
        )
        return observations, features

    def _delays(self, pixels: Array, height: int) -> Array | None:
        """Return when pixels (K, 2) were exposed (s from the stamp); None: all at once."""
        readout = self.config.depth.camera_readout_time
        return None if readout == 0.0 else row_delays(pixels[:, 1], height, readout)

    def _detect_in_depth(self, grey: NDArray[np.uint8], depth: DepthLayers) -> Features:
        """Return the features of an image (H, W) with valid depth, within the budget."""
        mask = depth.depth > 0.0
        if self.config.depth.depth_edges == 'drop':
            mask &= depth.spread <= self.config.depth.depth_edge_ratio * depth.depth
        keypoints = self._detector.find(grey, mask)
        pixels = np.array([k.pt for k in keypoints]).reshape(-1, 2)
        responses = np.array([k.response for k in keypoints])
        columns, rows = _nearest_pixels(pixels, mask.shape)
        inside = np.flatnonzero(mask[rows, columns])
        size = (mask.shape[1], mask.shape[0])
        chosen = inside[
            spread_over_image(pixels[inside], responses[inside], size, self.config.features)
        ]
        # description costs as much as detection, so that only the chosen ones are described
        return self._detector.describe(grey, [keypoints[row] for row in chosen.tolist()])

    def _depth_noise(self, depths: Array, spreads: Array) -> Array:
        """Return the standard deviation (K,) m of depths (K,) m, wider on depth edges."""
        config = self.config.depth
        noise: Array = config.depth_noise * depths**2
        on_edge = spreads > config.depth_edge_ratio * depths
        return np.where(on_edge, np.maximum(noise, spreads), noise)


def spread_over_image(
    pixels: Array, responses: Array, size: tuple[int, int], config: FeatureConfig
) -> NDArray[np.intp]:
    """Return the rows of at most feature_budget features, the strongest of each image cell.

    pixels (K, 2); responses (K,); size: width and height of the image.
    Each cell contributes its strongest feature, then its second strongest and so on, so that one
    textured poster does not use up the budget. Ties are broken by the order of the rows.
    """
    width, height = size
    column = (pixels[:, 0] * config.feature_grid_columns / width).astype(np.intp)
    row = (pixels[:, 1] * config.feature_grid_rows / height).astype(np.intp)
    column = np.clip(column, 0, config.feature_grid_columns - 1)
    cell = np.clip(row, 0, config.feature_grid_rows - 1) * config.feature_grid_columns + column
    by_cell = np.lexsort((np.arange(len(cell)), -responses, cell))
    starts = np.searchsorted(cell[by_cell], cell[by_cell], side='left')
    rank = np.empty(len(cell), np.intp)
    rank[by_cell] = np.arange(len(cell)) - starts
    order = np.lexsort((np.arange(len(cell)), -responses, rank))
    return order[: config.feature_budget]


def _nearest_pixels(
    pixels: Array, shape: tuple[int, ...]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return columns and rows (K,) of the pixels nearest to places (K, 2), inside an image."""
    nearest = np.rint(pixels).astype(np.intp)
    return np.clip(nearest[:, 0], 0, shape[1] - 1), np.clip(nearest[:, 1], 0, shape[0] - 1)


def _grey(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return an image (H, W, 3) RGB or (H, W) as grey (H, W)."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) if image.ndim == 3 else image
    return np.ascontiguousarray(grey)
