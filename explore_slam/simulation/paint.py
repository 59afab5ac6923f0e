"""Procedural surfaces, rich in corners and never the same twice, so that SIFT sees something.

A style paints an image (H, W, 3) uint8, row 0 at the top, at a resolution in m per pixel. All
of it comes from the generator given: the same generator paints the same surface.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from explore_slam.simulation.posters import (
    Image,
    fill,
    paint_poster,
    random_color,
    smooth_noise,
)

Painter = Callable[[tuple[int, int], float, np.random.Generator], Image]
LOWEST, HIGHEST = 0.06, 1.95  # posters hang between these heights (m)
SPECKS = 250.0  # dots per m²


def _tinted(
    shape: tuple[int, int], color: NDArray[np.float32], depth: float, rng: np.random.Generator
) -> Image:
    """Return a surface of one colour with cloudy stains and fine grain."""
    rows, columns = shape
    clouds = smooth_noise(shape, 60, rng) + 0.5 * smooth_noise(shape, 9, rng)
    grain = rng.random((min(rows, 97), columns), dtype=np.float32)
    grain = np.resize(grain, shape)
    shade = 1.0 + depth * (clouds - 0.75) + 0.5 * depth * (grain - 0.5)
    return np.clip(color * shade[:, :, None], 0, 255).astype(np.uint8)


def _speckle(image: Image, resolution: float, rng: np.random.Generator) -> None:
    """Strew dots of 6 to 18 mm: what is left to see from near where no poster hangs."""
    rows, columns = image.shape[:2]
    count = round(SPECKS * rows * columns * resolution**2)
    top, left = rng.integers(0, rows, count), rng.integers(0, columns, count)
    tones = rng.uniform(0.35, 1.35, (count, 1)) * image[top, left]
    size = rng.integers(1, 4, count)
    for down in range(3):
        for right in range(3):
            mine = (size > down) & (size > right)
            r, c = top[mine] + down, left[mine] + right
            inside = (r < rows) & (c < columns)
            image[r[inside], c[inside]] = np.clip(tones[mine][inside], 0, 255).astype(np.uint8)


def _plain(color: NDArray[np.float32], depth: float = 0.1) -> Painter:
    def paint(shape: tuple[int, int], resolution: float, rng: np.random.Generator) -> Image:
        image = _tinted(shape, color * (0.92 + 0.16 * rng.random()), depth, rng)
        _speckle(image, resolution, rng)
        return image

    return paint


def _brick(shape: tuple[int, int], resolution: float, rng: np.random.Generator) -> Image:
    rows, columns = shape
    height = max(3, round(0.085 / resolution))
    image = _tinted(shape, np.array([172, 165, 155], np.float32), 0.12, rng)
    base = np.array([150, 82, 62], np.float32)
    for top in range(0, rows, height):
        left = -int(rng.integers(0, max(2, height * 2)))
        while left < columns:
            width = max(3, round(height * (1.6 + 1.4 * rng.random())))
            tone = base * (0.6 + 0.7 * rng.random()) + rng.normal(0.0, 6.0, 3)
            fill(image, left, top, width - 1, height - 1, tone)
            left += width
    _speckle(image, resolution, rng)
    return image


def _panel(shape: tuple[int, int], resolution: float, rng: np.random.Generator) -> Image:
    rows, columns = shape
    image = np.empty((rows, columns, 3), np.uint8)
    base = np.array([176, 138, 92], np.float32)
    left = 0
    while left < columns:
        width = max(2, round((0.08 + 0.14 * rng.random()) / resolution))
        plank = image[:, left : left + width]
        grain = smooth_noise((rows, 1), 14, rng)[:, :1] + smooth_noise((rows, 1), 4, rng)[:, :1]
        tone = base * (0.7 + 0.45 * rng.random())
        plank[:] = np.clip(tone * (0.85 + 0.17 * grain)[:, :, None], 0, 255).astype(np.uint8)
        fill(image, left, 0, 1, rows, (60, 45, 30))
        for _ in range(int(rng.integers(1, 4))):  # knots
            size = max(2, round(0.02 / resolution))
            top = int(rng.integers(0, max(1, rows - size)))
            fill(image, left + width // 3, top, size, size, tone * 0.45)
        left += width
    _speckle(image, resolution, rng)
    return image


def _shelf(shape: tuple[int, int], resolution: float, rng: np.random.Generator) -> Image:
    rows, columns = shape
    image = np.full((rows, columns, 3), (70, 52, 38), np.uint8)
    board = max(1, round(0.02 / resolution))
    step = max(6, round(0.32 / resolution))
    for bottom in range(rows - board, 0, -step):
        fill(image, 0, bottom, columns, board, (140, 104, 70))
        left = board
        while left < columns - board:
            width = max(2, round((0.02 + 0.045 * rng.random()) / resolution))
            height = round((step - board) * (0.6 + 0.35 * rng.random()))
            color = random_color(rng)
            fill(image, left, bottom - height, width - 1, height, color)
            for _ in range(int(rng.integers(1, 4))):  # title and bands on the spine
                at = bottom - height + int(rng.integers(0, max(1, height - 3)))
                mark = int(rng.integers(1, max(2, height // 4)))
                fill(image, left, at, width - 1, mark, random_color(rng))
            left += width
    return image


def _cabinet(shape: tuple[int, int], resolution: float, rng: np.random.Generator) -> Image:
    rows, columns = shape
    image = _tinted(shape, random_color(rng) * np.float32(0.35) + np.float32(110), 0.08, rng)
    _speckle(image, resolution, rng)
    edge = max(1, round(0.012 / resolution))
    step = max(8, round(0.3 / resolution))
    for top in range(0, rows, step):
        fill(image, 0, top, columns, edge, (40, 40, 44))
        for left in range(0, columns, max(8, round(0.4 / resolution))):
            fill(image, left, top, edge, step, (40, 40, 44))
            label = (left + step // 3, top + step // 3, step // 2, step // 4)
            _hang(image, label, rng)
    return image


def _crate(shape: tuple[int, int], resolution: float, rng: np.random.Generator) -> Image:
    rows, columns = shape
    image = _panel(shape, resolution, rng)
    edge = max(1, round(0.03 / resolution))
    for box in ((0, 0, columns, edge), (0, rows - edge, columns, edge)):
        fill(image, *box, (110, 84, 52))
    for box in ((0, 0, edge, rows), (columns - edge, 0, edge, rows)):
        fill(image, *box, (110, 84, 52))
    _hang(image, (columns // 5, rows // 5, 3 * columns // 5, 3 * rows // 5), rng)
    return image


def _fabric(shape: tuple[int, int], resolution: float, rng: np.random.Generator) -> Image:
    rows, columns = shape
    image = _tinted(shape, random_color(rng), 0.15, rng)
    for _ in range(rows * columns // max(4, round((0.07 / resolution) ** 2))):
        size = max(2, round((0.015 + 0.05 * rng.random()) / resolution))
        left, top = int(rng.integers(0, columns)), int(rng.integers(0, rows))
        fill(image, left, top, size, max(2, size // 2), random_color(rng))
    return image


def _plant(shape: tuple[int, int], resolution: float, rng: np.random.Generator) -> Image:
    rows, columns = shape
    image = np.full((rows, columns, 3), (24, 46, 20), np.uint8)
    size = max(2, round(0.05 / resolution))
    for _ in range(2 * rows * columns // size**2):
        left, top = int(rng.integers(-size, columns)), int(rng.integers(-size, rows))
        green = np.array([40, 110, 36]) * (0.5 + rng.random())
        fill(
            image, left, top, int(rng.integers(2, size + 2)), int(rng.integers(2, size + 2)), green
        )
    pot = min(rows, round(0.35 / resolution))
    fill(image, 0, rows - pot, columns, pot, (156, 84, 54))
    return image


def _hang(image: Image, box: tuple[int, int, int, int], rng: np.random.Generator) -> None:
    """Paint a poster into the box (left, top, width, height) of an image, cut at its border."""
    left, top, width, height = box
    width, height = min(width, image.shape[1] - left), min(height, image.shape[0] - top)
    if width >= 8 and height >= 8:
        image[top : top + height, left : left + width] = paint_poster((height, width), rng)


def _with_posters(ground: Painter) -> Painter:
    """Return a painter that hangs posters on a ground, in two rows of uneven places."""

    def paint(shape: tuple[int, int], resolution: float, rng: np.random.Generator) -> Image:
        image = ground(shape, resolution, rng)
        rows, columns = shape
        low, high = round(LOWEST / resolution), round(HIGHEST / resolution)
        middle = (low + high) // 2
        for bottom, top in ((low, middle), (middle, min(high, rows))):
            left = round(rng.uniform(0.05, 0.3) / resolution)
            while left < columns:
                width = round(rng.uniform(0.35, 0.95) / resolution)
                height = min(round(rng.uniform(0.45, 0.85) / resolution), top - bottom)
                above = bottom + int(rng.integers(0, max(1, top - bottom - height)))
                if left + width <= columns and height > 0 and rows - above - height >= 0:
                    _hang(image, (left, rows - above - height, width, height), rng)
                left += width + round(rng.uniform(0.05, 0.45) / resolution)
        return image

    return paint


STYLES: dict[str, Painter] = {
    'plaster': _with_posters(_plain(np.array([205, 200, 188], np.float32))),
    'concrete': _with_posters(_plain(np.array([140, 142, 146], np.float32), 0.35)),
    'brick': _with_posters(_brick),
    'panel': _with_posters(_panel),
    'shelf': _shelf,
    'cabinet': _cabinet,
    'wood': _panel,
    'crate': _crate,
    'fabric': _fabric,
    'plant': _plant,
}


def paint_surface(
    style: str, shape: tuple[int, int], resolution: float, rng: np.random.Generator
) -> Image:
    """Return a surface (H, W, 3) uint8 of a style from STYLES, at a resolution in m per pixel."""
    return STYLES[style](shape, resolution, rng)


def paint_floor(shape: tuple[int, int], resolution: float, rng: np.random.Generator) -> Image:
    """Return a carpet of tiles in slightly different greys with scattered flecks."""
    rows, columns = shape
    tile = max(4, round(0.5 / resolution))
    tones = rng.uniform(86, 118, (rows // tile + 1, columns // tile + 1)).astype(np.float32)
    base = np.repeat(np.repeat(tones, tile, 0), tile, 1)[:rows, :columns]
    base = base * (0.9 + 0.2 * smooth_noise(shape, 5, rng))
    tinted = base[:, :, None] * np.array([1.0, 0.97, 0.92])
    image: Image = np.clip(tinted, 0, 255).astype(np.uint8)
    for _ in range(round(14.0 * rows * columns * resolution**2)):
        size = max(2, round(rng.uniform(0.03, 0.12) / resolution))
        left, top = int(rng.integers(0, columns)), int(rng.integers(0, rows))
        tone = rng.uniform(55, 165) * np.array([1.0, 0.97, 0.92])
        fill(image, left, top, size, max(2, size // 2), tone)
    return image
