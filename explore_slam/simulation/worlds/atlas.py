"""Puts the painted surfaces of a world side by side on few large textures."""

from typing import NamedTuple

import numpy as np

from explore_slam.simulation.worlds.paint import paint_surface
from explore_slam.simulation.worlds.posters import Image

PAGE_SIZE = 4096  # pixels; every OpenGL in use offers that much
MAX_PAGES = 2
NARROW = 25  # pixels; what is less wide gets no patch of its own
MARGIN = 2  # pixels between surfaces, so that a coarser mipmap does not mix them at once


class Surface(NamedTuple):
    """A surface to paint: style, length and height (m)."""

    style: str
    length: float
    height: float


class Patch(NamedTuple):
    """Where a surface lies: page, and left, top, right, bottom in pixels of that page."""

    page: int
    left: int
    top: int
    right: int
    bottom: int


class Atlas(NamedTuple):
    """Texture pages (H, W, 3) uint8 and the patch of each surface."""

    pages: list[Image]
    patches: list[Patch]


def build_atlas(surfaces: list[Surface], resolution: float, seed: int) -> Atlas:
    """Paint the surfaces at a resolution (m per pixel).

    Each surface has a generator of its own (seed and index). Narrow surfaces, and those left over
    when all pages are full, show parts of wider ones of their style.
    """
    sizes = [_pixels(surface, resolution) for surface in surfaces]
    patches = _arrange(surfaces, sizes)
    pages: list[Image] = []
    for page in range(1 + max((patch.page for patch, _ in patches), default=-1)):
        mine = [patch for patch, own in patches if own and patch.page == page]
        height = max(patch.bottom for patch in mine)
        width = max(patch.right for patch in mine)
        pages.append(np.full((height + MARGIN, width + MARGIN, 3), 128, np.uint8))
    for index, (patch, own) in enumerate(patches):
        if own:
            shape = (patch.bottom - patch.top, patch.right - patch.left)
            rng = np.random.default_rng((seed, index))
            pages[patch.page][patch.top : patch.bottom, patch.left : patch.right] = paint_surface(
                surfaces[index].style, shape, resolution, rng
            )
    return Atlas(pages, [patch for patch, _ in patches])


def _pixels(surface: Surface, resolution: float) -> tuple[int, int]:
    """Return columns and rows of a surface."""
    limit = PAGE_SIZE - MARGIN
    columns = min(limit, max(2, round(surface.length / resolution)))
    return columns, min(limit, max(2, round(surface.height / resolution)))


def _arrange(surfaces: list[Surface], sizes: list[tuple[int, int]]) -> list[tuple[Patch, bool]]:
    """Return for each surface its patch and whether it is the one that paints it.

    Rows of patches, the highest first (the first-fit shelf method).
    """
    widest = {surface.style: 0 for surface in surfaces}
    for surface, size in zip(surfaces, sizes, strict=True):
        widest[surface.style] = max(widest[surface.style], size[0])
    order = sorted(range(len(sizes)), key=lambda i: (-sizes[i][1], -sizes[i][0], i))
    placed: dict[int, tuple[Patch, bool]] = {}
    donors: dict[str, list[Patch]] = {}
    later: list[int] = []
    page = left = top = row_height = 0
    for index in order:
        columns, rows = sizes[index]
        style = surfaces[index].style
        if columns < NARROW <= widest[style]:
            later.append(index)
            continue
        if left + columns + MARGIN > PAGE_SIZE:
            left, top, row_height = 0, top + row_height, 0
        if top + rows + MARGIN > PAGE_SIZE and page < MAX_PAGES:
            page, left, top, row_height = page + 1, 0, 0, 0
        if page >= MAX_PAGES:
            later.append(index)
            continue
        patch = Patch(page, left, top, left + columns, top + rows)
        left, row_height = left + columns + MARGIN, max(row_height, rows + MARGIN)
        donors.setdefault(style, []).append(patch)
        placed[index] = (patch, True)
    everything = [patch for patch, _ in placed.values()]
    for index in later:
        pool = donors.get(surfaces[index].style) or everything
        placed[index] = (_share(pool, *sizes[index], index), False)
    return [placed[index] for index in range(len(sizes))]


def _share(pool: list[Patch], columns: int, rows: int, index: int) -> Patch:
    """Return a part of a patch in the pool that is as large as asked, if there is one."""
    chosen = pool[index % len(pool)]
    if chosen.right - chosen.left < columns or chosen.bottom - chosen.top < rows:
        fitting = [p for p in pool if p.right - p.left >= columns and p.bottom - p.top >= rows]
        chosen = (fitting or pool)[index % len(fitting or pool)]
    left = chosen.left + (index * 131) % max(1, chosen.right - chosen.left - columns)
    right, top = min(left + columns, chosen.right), max(chosen.top, chosen.bottom - rows)
    return Patch(chosen.page, left, top, right, chosen.bottom)
