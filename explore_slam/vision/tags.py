"""Image -> tags: markers with a number (AprilTag, ArUco), with poses in the vehicle frame.

1. Find the tags of the family in the image (OpenCV).
2. Fit lines to their edges, which meet at the corners. What finds corners themselves places those
   of a square up to 0.4 px inward, as blurred corners are round: the tag would seem farther away.
3. Leave out those that tags.yaml does not know, and those that are seen twice.
4. Fit the pose of each square to its corners. A flat square has two such poses, mirrored about
   the line of sight (Collins and Bartoli, "Infinitesimal plane-based pose estimation", 2014).
   Where noise could explain the worse one too, the heading lies between them or is unknown.
5. Covariance, to first order, of the noise of the corners and of the scale.
"""

import logging
import math
from functools import cache
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from explore_slam.data import Intrinsics, RgbdFrame, TagObservations
from explore_slam.geometry import Array, wrap_angle
from explore_slam.tags import FAMILIES, TagConfig, TagTable, table_of
from explore_slam.vision.camera_mount import CameraMount
from explore_slam.vision.depth import camera_rays

logger = logging.getLogger(__name__)

# Squared residuals, in variances of a corner, by which the better of two poses must fit better: a
# likelihood ratio of 10⁴. A mirrored pose costs more than a heading that is left out.
_DISTINCT = 18.4
# rad: two poses whose headings differ by more than twice this say nothing of the heading
_WIDEST_HALF = 0.5
# Horizontal part of the normal of a tag below which it lies rather than hangs, and has no heading.
_HANGING = 0.5
_NO_HEADING = math.pi**2 / 3.0  # rad²: variance of a heading of which nothing is known (uniform)
_MINIMUM_DEVIATIONS = np.array([0.003, 0.003, 0.005])  # m, m, rad: of what the camera mount hides
_LARGEST_DEVIATION = 0.5  # m: what is known less well than this is of no use
_STEP = 1e-6  # m, rad: of numeric derivatives
# Lines of the edges: places along each, as shares of its length, away from the round corners;
# reach across, in bits of the pattern, so that no other edge is met, and in px; passes.
_ALONG = np.linspace(0.15, 0.85, 15)
_REACH_BITS, _REACH_PIXELS = 0.75, 3.0
_ACROSS = np.linspace(-1.0, 1.0, 17)
_PASSES = 3
_LARGEST_CORRECTION = 2.0  # px; larger ones are those of a wrong edge


class DetectedTag(NamedTuple):
    """A tag in an image: its number, and its corners (4, 2) px, clockwise from the upper left."""

    tag: int
    corners: Array


class TagDetector:
    """Finds the tags of a table in images; finds none where the table is empty.

    mount: of the camera, for frames without one; by default a camera at the vehicle origin.
    """

    def __init__(self, config: TagConfig, mount: CameraMount | None = None) -> None:
        self._config = config
        self._mount = mount or CameraMount()
        table = table_of(config)
        self.table = table if tags_available() or table.is_empty else _without_aruco()
        self._detector = None if self.table.is_empty else _detector(self.table.family)
        self._twice: set[int] = set()  # tags that a warning has named

    @property
    def is_active(self) -> bool:
        """Whether there is any tag to look for."""
        return self._detector is not None

    def observe(self, frame: RgbdFrame) -> TagObservations:
        """Return the tags in the colour image of a frame, in the vehicle frame."""
        mount = self._mount if frame.mount is None else CameraMount.from_optical(frame.mount)
        image = frame.rgb
        grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) if image.ndim == 3 else image
        return self.observe_image(np.ascontiguousarray(grey), frame.intrinsics, frame.stamp, mount)

    def observe_image(
        self,
        grey: NDArray[np.uint8],
        camera: Intrinsics,
        stamp: float,
        mount: CameraMount | None = None,
    ) -> TagObservations:
        """Return the tags in an image (H, W), in the vehicle frame."""
        ids, poses, covariances = [], [], []
        for found in self.detect(grey):
            size = self.table.size_of(found.tag)
            if size is None:
                continue
            pose = pose_of_tag(found.corners, size, camera, mount or self._mount, self._config)
            if pose is not None:
                ids.append(found.tag)
                poses.append(pose[0])
                covariances.append(pose[1])
        return TagObservations(
            stamp,
            np.array(ids, np.int64),
            np.array(poses).reshape(-1, 3),
            np.array(covariances).reshape(-1, 3, 3),
        )

    def detect(self, grey: NDArray[np.uint8]) -> list[DetectedTag]:
        """Return the tags of the family in an image (H, W), ascending by number.

        A number that is seen twice is no identity: it is left out, and named in a warning once.
        """
        if self._detector is None:
            return []
        corners, ids, _ = self._detector.detectMarkers(grey)
        numbers = [] if ids is None else ids.ravel().tolist()
        bits = FAMILIES[self.table.family][0] + 2
        found = [
            DetectedTag(tag, fit_corners(grey, np.asarray(at, np.float64).reshape(4, 2), bits))
            for tag, at in zip(numbers, corners, strict=True)
        ]
        for tag in sorted({tag for tag in numbers if numbers.count(tag) > 1}):
            if tag not in self._twice and self.table.size_of(tag) is not None:
                self._twice.add(tag)
                places = [tuple(np.rint(f.corners.mean(axis=0))) for f in found if f.tag == tag]
                at = ' and '.join(f'({x:.0f}, {y:.0f})' for x, y in places)
                logger.warning(
                    'tag %d is seen %d times in one image, at the pixels %s, expected each tag of '
                    'the site once: it is left out of such images',
                    tag, len(places), at,
                )  # fmt: skip
        single = [item for item in found if numbers.count(item.tag) == 1]
        return sorted(single, key=lambda item: item.tag)


def tags_available() -> bool:
    """Return whether the installed OpenCV finds tags: 4.7 and newer do."""
    return hasattr(cv2, 'aruco') and hasattr(cv2.aruco, 'ArucoDetector')


@cache
def _without_aruco() -> TagTable:
    logger.warning(
        'OpenCV %s has no cv2.aruco.ArucoDetector, expected 4.7 or newer: tags are not used',
        cv2.__version__,
    )
    return TagTable()


def dictionary_of(family: str) -> Any:
    """Return OpenCV's dictionary of a family."""
    name = family.upper().replace('TAG', 'APRILTAG_')
    if family.startswith('tag'):
        name = name.replace('H', 'h')
    return cv2.aruco.getPredefinedDictionary(vars(cv2.aruco)[f'DICT_{name}'])


def _detector(family: str) -> Any:
    parameters = cv2.aruco.DetectorParameters()
    # to a fraction of a pixel, from where the lines of the edges are fitted
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    # no bit is corrected: a tag that is read wrong costs more than one that is not read
    parameters.errorCorrectionRate = 0.0
    return cv2.aruco.ArucoDetector(dictionary_of(family), parameters)


def fit_corners(grey: NDArray[np.uint8], corners: Array, bits: int) -> Array:
    """Return the corners (4, 2) px of a tag in an image (H, W): where its edges meet.

    corners (4, 2) px: nearby, in order around the tag; they are returned where the edges are not
    clear. bits: across the tag, its black border included.
    """
    found = corners
    for _ in range(_PASSES):
        lines = [_edge_line(grey, found[n], found[(n + 1) % 4], bits) for n in range(4)]
        if any(line is None for line in lines):
            return corners
        meeting = [_intersection(lines[n - 1], lines[n]) for n in range(4)]
        if any(point is None for point in meeting):
            return corners
        found = np.array(meeting)
        if np.abs(found - corners).max() > _LARGEST_CORRECTION:
            return corners
    return found


def _edge_line(
    grey: NDArray[np.uint8], begin: Array, end: Array, bits: int
) -> tuple[Array, Array] | None:
    """Return a point and the direction of the line along an edge that runs near two points (2,).

    None where the image shows no edge there. The edge is where brightness changes: at the mean
    place of its change across the edge.
    """
    length = float(np.hypot(*(end - begin)))
    if length < 1.0:
        return None
    along = (end - begin) / length
    normal = np.array([-along[1], along[0]])
    reach = min(_REACH_BITS * length / bits, _REACH_PIXELS)
    places = begin + _ALONG[:, None] * (end - begin)
    points = places[:, None] + reach * _ACROSS[None, :, None] * normal
    maps = points.astype(np.float32)
    values = cv2.remap(
        grey, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    ).astype(np.float64)
    change = np.diff(values, axis=1)
    sign = np.sign(change.sum())
    change = np.maximum(sign * change, 0.0)
    total = change.sum(axis=1)
    if not (total > 0.0).all():
        return None
    middles = 0.5 * reach * (_ACROSS[1:] + _ACROSS[:-1])
    off = (change @ middles) / total
    at = np.polynomial.polynomial.polyfit(length * (_ALONG - 0.5), off, 1, w=np.sqrt(total))
    point = 0.5 * (begin + end) + at[0] * normal
    return point, along + at[1] * normal


def _intersection(one: Any, other: Any) -> Array | None:
    """Return the point (2,) where two lines, each a point and a direction, meet; None: nowhere."""
    (p, u), (q, v) = one, other
    across = u[0] * v[1] - u[1] * v[0]
    if abs(across) < 1e-3:
        return None
    share = ((q[0] - p[0]) * v[1] - (q[1] - p[1]) * v[0]) / across
    meeting: Array = p + share * u
    return meeting


def corners_of_square(size: float) -> Array:
    """Return the corners (4, 3) m of a tag in its own frame, clockwise from the upper left.

    x right, y up, z out of the tag, as IPPE_SQUARE of OpenCV expects it.
    """
    half = 0.5 * size
    return half * np.array(
        [[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]]
    )


class _Fit(NamedTuple):
    """A pose of a square in the optical frame: rotation (3, 3), position (3,) m, and its error.

    cost: sum of squared residuals of the corners, in variances.
    """

    rotation: Array
    position: Array
    cost: float


def pose_of_tag(
    corners: Array, size: float, camera: Intrinsics, mount: CameraMount, config: TagConfig
) -> tuple[Array, Array] | None:
    """Return pose (3,) and covariance (3, 3) of a tag in the vehicle frame: m, m, rad.

    corners (4, 2) px, clockwise from the upper left; size: edge (m). None where the corners are
    not those of a square before the camera, or say too little of where it is.
    """
    deviation = config.tag_corner_noise / math.sqrt(camera.fx * camera.fy)
    fits = _fits(camera_rays(corners, camera), size, deviation)
    if not fits:
        return None
    best = fits[0]
    pose, covariance = _in_vehicle(best, size, deviation, mount)
    for other in fits[1:]:
        if other.cost - best.cost < _DISTINCT:
            second, _ = _in_vehicle(other, size, deviation, mount)
            pose, covariance = _between(pose, second, covariance)
    # errors that all frames share: of the distance, and of the mount
    along = pose[:2] - mount.translation[:2]
    covariance[:2, :2] += config.tag_scale_error**2 * np.outer(along, along)
    covariance += np.diag(_MINIMUM_DEVIATIONS**2)
    if np.linalg.eigvalsh(covariance[:2, :2])[-1] > _LARGEST_DEVIATION**2:
        return None
    return pose, covariance


def _fits(rays: Array, size: float, deviation: float) -> list[_Fit]:
    """Return the poses that fit the corners at rays (4, 2), the better one first."""
    square = corners_of_square(size)
    try:
        _, turns, places, _ = cv2.solvePnPGeneric(
            square, rays.reshape(4, 1, 2), np.eye(3), None, flags=cv2.SOLVEPNP_IPPE_SQUARE
        )
    except cv2.error:  # the corners are in line
        return []
    fits = []
    for turn, place in zip(turns, places, strict=True):
        rotation = np.asarray(cv2.Rodrigues(turn)[0], np.float64)
        position = np.asarray(place, np.float64).ravel()
        points = square @ rotation.T + position
        if not np.isfinite(points).all() or (points[:, 2] <= 0.0).any():
            continue
        off = (points[:, :2] / points[:, 2:] - rays) / deviation
        fits.append(_Fit(rotation, position, float((off**2).sum())))
    return sorted(fits, key=lambda fit: fit.cost)


def _in_vehicle(
    fit: _Fit, size: float, deviation: float, mount: CameraMount
) -> tuple[Array, Array]:
    """Return pose (3,) and covariance (3, 3) of a fit in the plane of the vehicle."""
    square, turn = corners_of_square(size), mount.rotation

    def moved(step: Array) -> tuple[Array, Array]:
        small = np.asarray(cv2.Rodrigues(step[3:])[0], np.float64)
        return small @ fit.rotation, fit.position + step[:3]

    def rays(step: Array) -> Array:
        rotation, position = moved(step)
        points = square @ rotation.T + position
        return (points[:, :2] / points[:, 2:]).ravel()

    def pose(step: Array) -> Array:
        rotation, position = moved(step)
        normal = turn @ rotation[:, 2]
        place = turn @ position + mount.translation
        return np.array([place[0], place[1], math.atan2(normal[1], normal[0])])

    steps = _STEP * np.eye(6)
    J = np.stack([(rays(step) - rays(-step)) / (2.0 * _STEP) for step in steps], axis=1)
    G = np.stack([pose(step) - pose(-step) for step in steps], axis=1)
    G[2] = (G[2] + np.pi) % (2.0 * np.pi) - np.pi
    G /= 2.0 * _STEP
    covariance = deviation**2 * G @ np.linalg.pinv(J.T @ J) @ G.T
    found = pose(np.zeros(6))
    horizontal = float(np.hypot(*(turn @ fit.rotation[:, 2])[:2]))
    if horizontal < _HANGING or covariance[2, 2] > _NO_HEADING:
        covariance = _without_heading(covariance)
    return found, covariance


def _between(pose: Array, other: Array, covariance: Array) -> tuple[Array, Array]:
    """Return a pose between two that fit alike, and its covariance, which reaches to both."""
    off = other - pose
    off[2] = wrap_angle(float(off[2]))
    half = 0.5 * off
    middle = pose + half
    middle[2] = wrap_angle(float(middle[2]))
    if abs(half[2]) > _WIDEST_HALF:
        half[2] = 0.0
        spread = covariance + np.outer(half, half)
        return middle, _without_heading(spread)
    return middle, covariance + np.outer(half, half)


def _without_heading(covariance: Array) -> Array:
    """Return a covariance (3, 3) of a pose of whose heading nothing is known."""
    marginal = np.zeros((3, 3))
    marginal[:2, :2] = covariance[:2, :2]
    marginal[2, 2] = _NO_HEADING
    return marginal
