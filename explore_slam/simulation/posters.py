"""What hangs on the walls: text sheets, pictures, mosaics, charts, notice boards; all random."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

Image = NDArray[np.uint8]
Color = NDArray[np.float32]


def random_color(rng: np.random.Generator) -> Color:
    """Return a colour (3,) of 0..255, from dark to light."""
    return rng.uniform(15, 240, 3).astype(np.float32)


def fill(
    image: Image, left: int, top: int, width: int, height: int, color: ArrayLike | Sequence[int]
) -> None:
    """Paint a rectangle, cut at the border of the image."""
    area = image[max(0, top) : max(0, top + height), max(0, left) : max(0, left + width)]
    area[:] = np.clip(np.asarray(color), 0, 255).astype(np.uint8)


def smooth_noise(shape: tuple[int, int], cell: int, rng: np.random.Generator) -> Color:
    """Return value noise (H, W) in 0..1 with features of about cell pixels."""
    rows, columns = shape
    grid = rng.random((rows // cell + 2, columns // cell + 2), dtype=np.float32)

    def stretched(values: Color, count: int) -> Color:
        at = np.arange(count, dtype=np.float32) / np.float32(cell)
        low = at.astype(np.intp)
        part = (at - low)[:, None]
        mixed: Color = values[low] * (1 - part) + values[low + 1] * part
        return mixed

    return stretched(stretched(grid, rows).T, columns).T


def _text(shape: tuple[int, int], rng: np.random.Generator) -> Image:
    """Paint lines of letters, each letter a random pattern of 3 x 5 dots."""
    rows, columns = shape
    paper = rng.uniform(205, 245, 3)
    image = np.full((rows, columns, 3), paper, np.uint8)
    top = rows // 14 + 1
    while top < rows - 8:
        dot = int(rng.integers(2, max(3, rows // 26 + 2)))
        ink = random_color(rng) * np.float32(0.5)
        letters = max(1, (columns - 4 * dot) // (4 * dot))
        pattern = rng.random((5, letters, 4)) < 0.55
        pattern[:, :, 3] = False
        pattern[:, rng.random(letters) < 0.15] = False  # spaces between words
        dots = np.repeat(np.repeat(pattern.reshape(5, -1), dot, 0), dot, 1)
        area = image[top : top + len(dots), 2 * dot : 2 * dot + dots.shape[1]]
        mask = dots[: area.shape[0], : area.shape[1]]
        area[mask] = np.clip(ink, 0, 255).astype(np.uint8)
        top += 5 * dot + int(rng.integers(dot, 4 * dot + 1))
    return image


def _shapes(shape: tuple[int, int], rng: np.random.Generator) -> Image:
    """Paint a picture of rectangles, discs and wedges."""
    rows, columns = shape
    image = np.full((rows, columns, 3), random_color(rng), np.float32)
    y, x = np.mgrid[:rows, :columns].astype(np.float32)
    for _ in range(int(rng.integers(14, 30))):
        cx, cy = rng.uniform(0, columns), rng.uniform(0, rows)
        size = rng.uniform(0.04, 0.22) * min(rows, columns) + 2
        angle = rng.uniform(0, np.pi)
        u = np.cos(angle) * (x - cx) + np.sin(angle) * (y - cy)
        v = np.cos(angle) * (y - cy) - np.sin(angle) * (x - cx)
        kind = int(rng.integers(0, 4))
        if kind == 0:
            mask = u**2 + v**2 < size**2
        elif kind == 1:
            mask = (np.abs(u) < size) & (np.abs(v) < size * rng.uniform(0.2, 1.0))
        elif kind == 2:
            mask = (u > 0) & (u < 2 * size) & (np.abs(v) < 0.5 * u)
        else:
            mask = np.abs(np.sqrt(u**2 + v**2) - size) < 0.25 * size
        image[mask] = random_color(rng)
    return np.clip(image, 0, 255).astype(np.uint8)


def _mosaic(shape: tuple[int, int], rng: np.random.Generator) -> Image:
    """Paint cells of random sizes and colours."""
    rows, columns = shape
    cuts_y = np.cumsum(rng.integers(5, 18, rows // 5))
    cuts_x = np.cumsum(rng.integers(5, 18, columns // 5))
    row = np.searchsorted(cuts_y, np.arange(rows))
    column = np.searchsorted(cuts_x, np.arange(columns))
    colors = rng.uniform(15, 240, (row[-1] + 1, column[-1] + 1, 3))
    image: Image = colors[row][:, column].astype(np.uint8)
    return image


def _landscape(shape: tuple[int, int], rng: np.random.Generator) -> Image:
    """Paint cloudy bands in a few colours with hard borders, like a contour map."""
    noise = smooth_noise(shape, 24, rng) + 0.5 * smooth_noise(shape, 9, rng)
    noise += 0.25 * smooth_noise(shape, 4, rng)
    levels = int(rng.integers(4, 9))
    palette = rng.uniform(15, 240, (levels + 1, 3))
    index = np.clip(noise / 1.75 * levels, 0, levels).astype(np.intp)
    image: Image = palette[index].astype(np.uint8)
    return image


def _chart(shape: tuple[int, int], rng: np.random.Generator) -> Image:
    """Paint bars over a grid with a headline."""
    rows, columns = shape
    image = np.full((rows, columns, 3), rng.uniform(190, 240, 3), np.uint8)
    for line in range(rows // 4, rows, max(4, rows // 8)):
        fill(image, 0, line, columns, 1, (120, 120, 120))
    left = 3
    while left < columns - 4:
        width = int(rng.integers(3, max(4, columns // 9) + 1))
        height = int(rng.integers(2, max(3, 3 * rows // 4)))
        fill(image, left, rows - 3 - height, width, height, random_color(rng))
        left += width + int(rng.integers(2, 6))
    head = _text((max(9, rows // 5), columns), rng)
    image[: head.shape[0]] = head[:rows]
    return image


def _board(shape: tuple[int, int], rng: np.random.Generator) -> Image:
    """Paint a notice board: cork with sheets pinned all over it."""
    rows, columns = shape
    cork = np.array([168, 122, 74]) * (0.8 + 0.4 * smooth_noise(shape, 3, rng))[:, :, None]
    image: Image = np.clip(cork, 0, 255).astype(np.uint8)
    for _ in range(int(rng.integers(6, 14))):
        height = int(rng.integers(max(8, rows // 6), max(9, rows // 3) + 1))
        width = int(rng.integers(max(8, columns // 7), max(9, columns // 3) + 1))
        if height >= rows or width >= columns:
            continue
        top, left = int(rng.integers(0, rows - height)), int(rng.integers(0, columns - width))
        painter = SHEETS[int(rng.integers(0, len(SHEETS)))]
        image[top : top + height, left : left + width] = painter((height, width), rng)
        fill(image, left + width // 2, top + 1, 3, 3, random_color(rng))
    return image


SHEETS: tuple[Callable[[tuple[int, int], np.random.Generator], Image], ...] = (
    _text,
    _shapes,
    _mosaic,
    _landscape,
    _chart,
)


def paint_poster(shape: tuple[int, int], rng: np.random.Generator) -> Image:
    """Return a poster (H, W, 3) uint8 with a thin frame; shape (H, W) is at least (8, 8)."""
    painters = (*SHEETS, _board)
    image = painters[int(rng.integers(0, len(painters)))](shape, rng).copy()
    frame = np.clip(random_color(rng) * np.float32(0.4), 0, 255).astype(np.uint8)
    edge = 1 if min(shape) < 40 else 2
    image[:edge], image[-edge:], image[:, :edge], image[:, -edge:] = frame, frame, frame, frame
    return image
