"""Pack the painted surfaces of a world into a few large textures."""

from typing import NamedTuple

import numpy as np

from explore_slam.simulation.worlds.paint import paint_surface
from explore_slam.simulation.worlds.posters import Image

PAGE_SIZE = 4096  # pixels per side, which OpenGL implementations in use support
MAX_PAGES = 2  # 100 MB of texture memory
NARROW = 25  # pixels; narrower surfaces get no patch of their own
MARGIN = 2  # pixels between surfaces, so that the first mipmap levels do not blend neighbours


class Surface(NamedTuple):
    """A surface to paint: style, length and height (m)."""

    style: str
    length: float
    height: float


class Patch(NamedTuple):
    """The place of a surface: page, and left, top, right, bottom in pixels of that page."""

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
    """Paint all surfaces at a resolution (m per pixel).

    Each surface has its own random generator (seed, index). Narrow surfaces, and those that do
    not fit on the pages, reuse parts of wider surfaces of the same style.
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
    """Return for each surface its patch and whether the surface owns (paints) that patch.

    Next-fit shelf packing in order of decreasing height: shelves are filled from left to right.
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
    """Return a part with this size of some patch in the pool, smaller if none is large enough."""
    chosen = pool[index % len(pool)]
    if chosen.right - chosen.left < columns or chosen.bottom - chosen.top < rows:
        fitting = [p for p in pool if p.right - p.left >= columns and p.bottom - p.top >= rows]
        chosen = (fitting or pool)[index % len(fitting or pool)]
    left = chosen.left + (index * 131) % max(1, chosen.right - chosen.left - columns)
    right, top = min(left + columns, chosen.right), max(chosen.top, chosen.bottom - rows)
    return Patch(chosen.page, left, top, right, chosen.bottom)
