"""Random posters: abstract pictures, mosaics, contour maps, notice boards."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from explore_slam.simulation.worlds.leaves import leaf_gains

Image = NDArray[np.uint8]
Color = NDArray[np.float32]
Shape = tuple[int, int]


def random_color(rng: np.random.Generator) -> Color:
    """Return a random colour (3,), channels in 15..240."""
    return rng.uniform(15, 240, 3).astype(np.float32)


def fill(
    image: Image, left: int, top: int, width: int, height: int, color: ArrayLike | Sequence[int]
) -> None:
    """Paint a rectangle, clipped to the image."""
    area = image[max(0, top) : max(0, top + height), max(0, left) : max(0, left + width)]
    area[:] = np.clip(np.asarray(color), 0, 255).astype(np.uint8)


def mottled(
    image: NDArray[np.uint8] | Color, rng: np.random.Generator, contrast: float, color: float = 0.1
) -> Image:
    """Return an image (H, W, 3) multiplied by dead leaves of this contrast."""
    gains = leaf_gains((image.shape[0], image.shape[1]), rng, contrast, color)
    gains *= image
    painted: Image = np.clip(gains, 0, 255, out=gains).astype(np.uint8)
    return painted


def smooth_noise(shape: Shape, cell: int, rng: np.random.Generator) -> Color:
    """Return value noise (H, W) in 0..1, interpolated between nodes `cell` pixels apart."""
    rows, columns = shape
    grid = rng.random((rows // cell + 2, columns // cell + 2), dtype=np.float32)

    def stretched(values: Color, count: int) -> Color:
        at = np.arange(count, dtype=np.float32) / np.float32(cell)
        low = at.astype(np.intp)
        part = (at - low)[:, None]
        mixed: Color = values[low] * (1 - part) + values[low + 1] * part
        return mixed

    return stretched(stretched(grid, rows).T, columns).T


def _abstract(shape: Shape, rng: np.random.Generator) -> Image:
    """Paint dead leaves of all colours."""
    ground = np.full((*shape, 3), rng.uniform(100, 150, 3), np.float32)
    return mottled(ground, rng, 0.8, 0.6)


def _mosaic(shape: Shape, rng: np.random.Generator) -> Image:
    """Paint cells of random sizes and colours."""
    rows, columns = shape
    row = np.searchsorted(np.cumsum(rng.integers(5, 18, rows // 5)), np.arange(rows))
    column = np.searchsorted(np.cumsum(rng.integers(5, 18, columns // 5)), np.arange(columns))
    colors = rng.uniform(15, 240, (row[-1] + 1, column[-1] + 1, 3)).astype(np.uint8)
    return mottled(colors[row][:, column], rng, 0.25)


def _contours(shape: Shape, rng: np.random.Generator) -> Image:
    """Paint level sets of noise in a few colours, like a contour map."""
    noise = smooth_noise(shape, 24, rng) + 0.5 * smooth_noise(shape, 9, rng)
    noise += 0.25 * smooth_noise(shape, 4, rng)
    levels = int(rng.integers(4, 9))
    palette = rng.uniform(15, 240, (levels + 1, 3)).astype(np.uint8)
    index = np.clip(noise / 1.75 * levels, 0, levels).astype(np.intp)
    return mottled(palette[index], rng, 0.25)


SHEETS: tuple[Callable[[Shape, np.random.Generator], Image], ...] = (
    _abstract,
    _mosaic,
    _contours,
)


def _board(shape: Shape, rng: np.random.Generator) -> Image:
    """Paint a notice board: cork with sheets pinned on it."""
    rows, columns = shape
    image = mottled(np.full((rows, columns, 3), (168, 122, 74), np.uint8), rng, 0.3)
    for _ in range(int(rng.integers(6, 14))):
        height = int(rng.integers(max(8, rows // 6), max(9, rows // 3) + 1))
        width = int(rng.integers(max(8, columns // 7), max(9, columns // 3) + 1))
        if height >= rows or width >= columns:
            continue
        top, left = int(rng.integers(0, rows - height)), int(rng.integers(0, columns - width))
        painter = SHEETS[int(rng.integers(0, len(SHEETS)))]
        image[top : top + height, left : left + width] = painter((height, width), rng)
    return image


def paint_poster(shape: Shape, rng: np.random.Generator) -> Image:
    """Return a poster (H, W, 3) uint8 with a thin frame; shape (H, W) is at least (8, 8)."""
    painters = (*SHEETS, _board)
    image = painters[int(rng.integers(0, len(painters)))](shape, rng)
    frame = np.clip(random_color(rng) * np.float32(0.4), 0, 255).astype(np.uint8)
    image[:1], image[-1:], image[:, :1], image[:, -1:] = frame, frame, frame, frame
    return image
