"""Images of tags: as they are printed, and as a camera sees them."""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from explore_slam.data import Intrinsics
from explore_slam.geometry import Array
from explore_slam.tags import FAMILIES
from explore_slam.vision.tags import corners_of_square, dictionary_of

_PIXELS_PER_BIT = 8  # of a drawn tag
_GROUND, _PAPER = 120, 235  # grey of a wall, and of the margin around a tag
_BLUR = 0.7  # px, standard deviation: of a lens that is in focus
_NOISE = 3.0  # grey levels, standard deviation: of a small sensor indoors
_OVERSAMPLING = 4  # pixels of a drawn view per pixel of the image, in both axes


class TagInView(NamedTuple):
    """A tag before a camera: rotation (3, 3) and position (3,) m in the optical frame; edge (m).

    In its own frame, x is to the right of the tag, y up, z out of it.
    """

    tag: int
    size: float
    rotation: Array
    position: Array


def draw_tag(family: str, tag: int, margin: int = 0) -> NDArray[np.uint8]:
    """Return a tag as a grey image (S, S), with its black border; margin: white, in bits."""
    bits = FAMILIES[family][0] + 2
    side = _PIXELS_PER_BIT * bits
    drawn = cv2.aruco.generateImageMarker(dictionary_of(family), tag, side)
    image: NDArray[np.uint8] = np.pad(
        np.minimum(drawn, _PAPER), margin * _PIXELS_PER_BIT, constant_values=_PAPER
    )
    return image


def draw_view(
    family: str, tags: Sequence[TagInView], camera: Intrinsics, random: np.random.Generator
) -> NDArray[np.uint8]:
    """Return the image (H, W) that a camera without distortion takes of tags on a grey ground.

    Every tag has a white margin of one bit. The lens blurs, and the sensor adds noise.
    """
    image = np.full((camera.height, camera.width), _GROUND, np.uint8)
    for item in tags:
        _paste(image, family, item, camera)
    blurred = cv2.GaussianBlur(image.astype(np.float32), (0, 0), _BLUR)
    noisy = blurred + _NOISE * random.standard_normal(image.shape, np.float32)
    view: NDArray[np.uint8] = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
    return view


def corners_in_view(item: TagInView, camera: Intrinsics, scale: float = 1.0) -> Array | None:
    """Return the corners (4, 2) px of a tag in an image; None if one is behind the camera.

    scale: of the square, to include a margin.
    """
    points = scale * corners_of_square(item.size) @ item.rotation.T + item.position
    if (points[:, 2] <= 0.0).any():
        return None
    rays = points[:, :2] / points[:, 2:]
    corners: Array = rays * [camera.fx, camera.fy] + [camera.cx, camera.cy]
    return corners


def _paste(image: NDArray[np.uint8], family: str, item: TagInView, camera: Intrinsics) -> None:
    """Draw a tag into the part of an image (H, W) that it covers."""
    bits = FAMILIES[family][0] + 2
    corners = corners_in_view(item, camera, (bits + 2) / bits)
    if corners is None:
        return
    low = np.maximum(np.floor(corners.min(axis=0)).astype(int) - 1, 0)
    high = np.minimum(np.ceil(corners.max(axis=0)).astype(int) + 2, [camera.width, camera.height])
    width, height = (high - low).tolist()
    if width <= 0 or height <= 0:
        return
    drawn = draw_tag(family, item.tag, margin=1)
    side = drawn.shape[0]
    # pixel centres are whole numbers: the edges of an image lie half a pixel outside
    source = np.array([[0, 0], [side, 0], [side, side], [0, side]], np.float32) - 0.5
    target = _OVERSAMPLING * (corners - low + 0.5) - 0.5
    homography = cv2.getPerspectiveTransform(source, target.astype(np.float32))
    size = (_OVERSAMPLING * width, _OVERSAMPLING * height)
    fine = cv2.warpPerspective(drawn, homography, size, flags=cv2.INTER_LINEAR)
    mask = cv2.warpPerspective(np.full_like(drawn, 255), homography, size)
    share = cv2.resize(mask, (width, height), interpolation=cv2.INTER_AREA) / 255.0
    # where the tag covers a pixel in part, the rest of it is ground
    covered = cv2.resize(fine, (width, height), interpolation=cv2.INTER_AREA).astype(np.float64)
    area = image[low[1] : high[1], low[0] : high[0]]
    area[:] = np.rint(covered + (1.0 - share) * area).astype(np.uint8)
