"""Procedural surfaces rich in distinctive SIFT features.

A painter of a style returns an image (H, W, 3) uint8, row 0 at the top, at a resolution in m per
pixel. All randomness comes from the generator passed in: equal states paint equal surfaces.
Sizes, colours and contrasts are free choices, judged by the number of features per view
(test_simulator.py::test_most_views_are_rich_in_features).
"""

from collections.abc import Callable

import numpy as np

from explore_slam.simulation.worlds.posters import (
    Color,
    Image,
    fill,
    mottled,
    paint_poster,
    random_color,
    smooth_noise,
)

Shape = tuple[int, int]
Painter = Callable[[Shape, float, np.random.Generator], Image]
LOWEST, HIGHEST = 0.06, 1.95  # m; posters hang between these heights
MOTTLE = 0.38  # contrast of the dead leaves on walls and furniture


def _flat(shape: Shape, color: Color) -> Image:
    return np.full((*shape, 3), np.clip(color, 0, 255), np.uint8)


def _plain(red: float, green: float, blue: float) -> Painter:
    """Return a painter of plastered walls of roughly one colour."""

    def paint(shape: Shape, _: float, rng: np.random.Generator) -> Image:
        color = np.array([red, green, blue], np.float32) * np.float32(rng.uniform(0.92, 1.08))
        return mottled(_flat(shape, color), rng, MOTTLE, 0.06)

    return paint


def _brick(shape: Shape, resolution: float, rng: np.random.Generator) -> Image:
    rows, columns = shape
    height = max(3, round(0.085 / resolution))
    image = _flat(shape, np.array([150, 112, 98], np.float32))
    base = np.array([150, 88, 68], np.float32)
    for top in range(0, rows, height):
        left = -int(rng.integers(0, max(2, height * 2)))
        while left < columns:
            width = max(3, round(height * rng.uniform(1.6, 3.0)))
            tone = base * rng.uniform(0.75, 1.25) + rng.normal(0.0, 5.0, 3)
            fill(image, left, top, width - 1, height - 1, tone)
            left += width
    return mottled(image, rng, 0.42)


def _panel(shape: Shape, resolution: float, rng: np.random.Generator) -> Image:
    rows, columns = shape
    image = np.empty((rows, columns, 3), np.uint8)
    base = np.array([176, 138, 92], np.float32)
    left = 0
    while left < columns:
        width = max(2, round(rng.uniform(0.08, 0.22) / resolution))
        grain = smooth_noise((rows, 1), 14, rng)[:, :1] + smooth_noise((rows, 1), 4, rng)[:, :1]
        tone = base * rng.uniform(0.75, 1.1) * (0.85 + 0.17 * grain)[:, :, None]
        image[:, left : left + width] = np.clip(tone, 0, 255).astype(np.uint8)
        left += width
    return mottled(image, rng, MOTTLE)


def _shelf(shape: Shape, resolution: float, rng: np.random.Generator) -> Image:
    rows, columns = shape
    image = _flat(shape, np.array([70, 52, 38], np.float32))
    board = max(1, round(0.02 / resolution))
    step = max(6, round(0.32 / resolution))
    for bottom in range(rows - board, 0, -step):
        fill(image, 0, bottom, columns, board, (140, 104, 70))
        left = board
        while left < columns - board:
            width = max(2, round(rng.uniform(0.03, 0.09) / resolution))
            height = round((step - board) * rng.uniform(0.6, 0.95))
            fill(image, left, bottom - height, width, height, random_color(rng))
            left += width
    return mottled(image, rng, 0.6, 0.3)


def _cabinet(shape: Shape, resolution: float, rng: np.random.Generator) -> Image:
    rows, columns = shape
    image = mottled(_flat(shape, random_color(rng) * 0.35 + 110), rng, MOTTLE)
    step, wide = max(12, round(0.3 / resolution)), max(12, round(0.4 / resolution))
    for top in range(0, rows, step):
        for left in range(0, columns, wide):
            size = round(wide * rng.uniform(0.4, 0.8)), round(step * rng.uniform(0.4, 0.8))
            _hang(image, (left + wide // 8, top + step // 8, *size), rng)
    return image


def _crate(shape: Shape, resolution: float, rng: np.random.Generator) -> Image:
    rows, columns = shape
    image = _panel(shape, resolution, rng)
    _hang(image, (columns // 5, rows // 5, 3 * columns // 5, 3 * rows // 5), rng)
    return image


def _fabric(shape: Shape, _: float, rng: np.random.Generator) -> Image:
    return mottled(_flat(shape, random_color(rng) * 0.5 + 80), rng, 0.5, 0.3)


def _plant(shape: Shape, resolution: float, rng: np.random.Generator) -> Image:
    rows, columns = shape
    image = _flat(shape, np.array([50, 110, 42], np.float32))
    pot = min(rows, round(0.35 / resolution))
    fill(image, 0, rows - pot, columns, pot, (156, 84, 54))
    return mottled(image, rng, 0.7, 0.2)


def _hang(image: Image, box: tuple[int, int, int, int], rng: np.random.Generator) -> None:
    """Paint a poster into the box (left, top, width, height) of an image, clipped to it."""
    left, top, width, height = box
    width, height = min(width, image.shape[1] - left), min(height, image.shape[0] - top)
    if width >= 8 and height >= 8:
        image[top : top + height, left : left + width] = paint_poster((height, width), rng)


def _with_posters(ground: Painter) -> Painter:
    """Return a painter that adds two rows of posters with irregular sizes and gaps."""

    def paint(shape: Shape, resolution: float, rng: np.random.Generator) -> Image:
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
    'plaster': _with_posters(_plain(190, 185, 172)),
    'concrete': _with_posters(_plain(140, 142, 146)),
    'brick': _with_posters(_brick),
    'panel': _with_posters(_panel),
    'shelf': _shelf,
    'cabinet': _cabinet,
    'wood': _panel,
    'crate': _crate,
    'fabric': _fabric,
    'plant': _plant,
}


def paint_surface(style: str, shape: Shape, resolution: float, rng: np.random.Generator) -> Image:
    """Return a surface (H, W, 3) uint8 of a style in STYLES, at a resolution in m per pixel."""
    return STYLES[style](shape, resolution, rng)


def paint_floor(shape: Shape, resolution: float, rng: np.random.Generator) -> Image:
    """Return carpet tiles (H, W, 3) uint8 in slightly different greys."""
    rows, columns = shape
    tile = max(4, round(0.5 / resolution))
    tones = rng.uniform(90, 112, (rows // tile + 1, columns // tile + 1, 1))
    tones = (tones * np.array([1.0, 0.97, 0.92])).astype(np.uint8)
    tiles = np.repeat(np.repeat(tones, tile, 0), tile, 1)[:rows, :columns]
    return mottled(tiles, rng, 0.6, 0.05)
