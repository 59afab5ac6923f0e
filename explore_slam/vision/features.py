"""RGB-D frame -> landmark observations: SIFT features with a 3-D position and its covariance."""

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from explore_slam.data import DESCRIPTOR_LENGTH, LandmarkObservations, RgbdFrame
from explore_slam.errors import VisionError
from explore_slam.geometry import Array
from explore_slam.vision.camera_mount import CameraMount
from explore_slam.vision.config import FeatureConfig, VisionConfig
from explore_slam.vision.depth import analyse_depth, back_project, point_covariances


class Features(NamedTuple):
    """SIFT features of one image: pixels (K, 2) (u, v), sizes (K,) px, responses, descriptors."""

    pixels: Array
    sizes: Array
    responses: Array
    descriptors: NDArray[np.float32]

    def take(self, rows: NDArray[Any]) -> 'Features':
        """Return the features of the given rows or mask."""
        return Features(*(column[rows] for column in self))


def normalise(descriptors: NDArray[np.float32], *, root: bool) -> NDArray[np.float32]:
    """Return descriptors (K, 128) of unit length; root gives RootSIFT (Arandjelović, 2012)."""
    raw = np.asarray(descriptors, dtype=np.float32)
    if root:
        sums = np.abs(raw).sum(axis=1, keepdims=True)
        raw = np.sqrt(np.abs(raw) / np.maximum(sums, np.float32(1e-12)), dtype=np.float32)
    lengths = np.linalg.norm(raw, axis=1, keepdims=True)
    return (raw / np.maximum(lengths, np.float32(1e-12))).astype(np.float32)


def spread_over_image(
    pixels: Array, responses: Array, size: tuple[int, int], config: FeatureConfig
) -> NDArray[np.intp]:
    """Return the rows of at most feature_budget features, strongest first in turn by image cell.

    pixels (K, 2), size (width, height). Each cell gives its best, then each its second best and
    so on, so that one textured poster does not use up the budget. Ties go by the order of rows.
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


class FeatureExtractor:
    """Turns RGB-D frames into landmark observations in the vehicle frame.

    The same frame gives the same observations, bit for bit, whatever the number of threads.
    Without a mount the one of the settings is used.
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
        chosen = self.config.features
        # nfeatures 0: OpenCV would keep the strongest of the whole image before it looks at depth
        make_sift: Any = vars(cv2)['SIFT_create']  # its type stub comes and goes with the version
        self._sift = make_sift(0, 3, chosen.sift_contrast_threshold, chosen.sift_edge_threshold)

    def detect(self, image: NDArray[np.uint8], mask: NDArray[np.bool_] | None = None) -> Features:
        """Return all SIFT features of an image (H, W, 3) RGB or (H, W), in a fixed order.

        Only features whose pixel is set in the mask (H, W) are taken.
        """
        grey = _grey(image)
        return self._describe(grey, self._find(grey, mask))

    def _find(self, grey: NDArray[np.uint8], mask: NDArray[np.bool_] | None) -> list[Any]:
        """Return the keypoints wanted by the settings, sorted, so that their order is fixed."""
        chosen = self.config.features
        found = self._sift.detect(grey, None if mask is None else mask.astype(np.uint8))
        if chosen.feature_orientation == 'upright':
            for keypoint in found:
                keypoint.angle = 0.0
        found = sorted(
            (k for k in found if k.size >= chosen.minimum_feature_size),
            key=lambda k: (*k.pt, k.size, k.angle, k.response),
        )
        if chosen.feature_orientation == 'all':
            return found
        return list({(k.pt, k.size): k for k in reversed(found)}.values())[::-1]

    def _describe(self, grey: NDArray[np.uint8], keypoints: list[Any]) -> Features:
        """Return the features of keypoints in their order, without those that show nothing."""
        raw = None
        if keypoints:
            keypoints, raw = self._sift.compute(grey, keypoints)
        if raw is None or not len(keypoints):
            none = np.empty(0)
            return Features(
                np.empty((0, 2)), none, none, np.empty((0, DESCRIPTOR_LENGTH), np.float32)
            )
        table = np.array([(*k.pt, k.size, k.response) for k in keypoints])
        unit = normalise(raw, root=self.config.features.root_sift)
        # a featureless patch has no descriptor to compare
        whole = np.linalg.norm(unit, axis=1) > 0.5
        return Features(table[:, :2], table[:, 2], table[:, 3], unit).take(whole)

    def extract(self, frame: RgbdFrame) -> LandmarkObservations:
        """Return the landmarks seen in a frame: positions and covariances in the vehicle frame."""
        return self.extract_with_pixels(frame)[0]

    def extract_with_pixels(self, frame: RgbdFrame) -> tuple[LandmarkObservations, Features]:
        """Return the observations and, row for row, the image features they come from."""
        config, camera = self.config, frame.intrinsics
        layers = analyse_depth(frame.depth, config.depth)
        mask = layers.depth > 0.0
        if config.depth.depth_edges == 'drop':
            mask &= layers.spread <= config.depth.depth_edge_ratio * layers.depth
        size = (camera.width, camera.height)
        grey = _grey(frame.rgb)
        keypoints = self._find(grey, mask)
        pixels = np.array([k.pt for k in keypoints]).reshape(-1, 2)
        responses = np.array([k.response for k in keypoints])
        columns, rows = _pixel_of(pixels, size)
        inside = np.flatnonzero(mask[rows, columns])
        chosen = inside[
            spread_over_image(pixels[inside], responses[inside], size, config.features)
        ]
        # only those within the budget are described: that costs as much as finding them
        found = self._describe(grey, [keypoints[row] for row in chosen.tolist()])
        columns, rows = _pixel_of(found.pixels, size)
        depths = layers.depth[rows, columns].astype(np.float64)
        spreads = layers.spread[rows, columns].astype(np.float64)
        depth_noise = config.depth.depth_noise * depths**2
        on_edge = spreads > config.depth.depth_edge_ratio * depths
        depth_noise = np.where(on_edge, np.maximum(depth_noise, spreads), depth_noise)
        pixel_noise = np.full(len(depths), config.depth.pixel_noise)
        points = back_project(found.pixels, depths, camera)
        covariances = point_covariances(points, camera, pixel_noise, depth_noise)
        observations = LandmarkObservations(
            frame.stamp,
            self.mount.to_vehicle(points),
            self.mount.rotate_covariances(covariances),
            found.descriptors,
        )
        return observations, found


def _pixel_of(pixels: Array, size: tuple[int, int]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return column and row (K,) of the nearest pixel, inside an image of (width, height)."""
    nearest = np.rint(pixels).astype(np.intp)
    return np.clip(nearest[:, 0], 0, size[0] - 1), np.clip(nearest[:, 1], 0, size[1] - 1)


def _grey(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return an image (H, W, 3) RGB or (H, W) as grey (H, W)."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) if image.ndim == 3 else image
    return np.ascontiguousarray(grey)
