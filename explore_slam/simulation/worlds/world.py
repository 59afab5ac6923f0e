"""A world: solids for laser and collisions, painted faces for the camera, start poses.

Solids stand upright on the floor z = 0. Boards (table tops, shelves) hang above it, and pits lie
below it: a laser near the floor sees neither. Lengths are metres, angles radians.
"""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.geometry import Array, Pose2


class Block(NamedTuple):
    """A box: centre and half sizes (m), heading of its x axis (rad), height (m)."""

    x: float
    y: float
    half_x: float
    half_y: float
    yaw: float
    height: float


class Pillar(NamedTuple):
    """A cylinder: centre, radius and height (m)."""

    x: float
    y: float
    radius: float
    height: float


class Board(NamedTuple):
    """A box above the floor: centre, half sizes (m), heading (rad), lower and upper side (m)."""

    x: float
    y: float
    half_x: float
    half_y: float
    yaw: float
    bottom: float
    top: float


class Pit(NamedTuple):
    """A rectangle along the axes in which the floor is lower: centre, half sizes, depth (m)."""

    x: float
    y: float
    half_x: float
    half_y: float
    depth: float


class Face(NamedTuple):
    """A vertical rectangle from (x0, y0) to (x1, y1) (m), visible from its right side.

    style: key of paint.STYLES.
    """

    x0: float
    y0: float
    x1: float
    y1: float
    height: float
    style: str

    @property
    def length(self) -> float:
        """Length (m) along the floor."""
        return math.hypot(self.x1 - self.x0, self.y1 - self.y0)


class Top(NamedTuple):
    """A horizontal polygon: counterclockwise corners (P, 2) m, at a height (m)."""

    corners: Array
    height: float
    style: str


@dataclass(frozen=True)
class World:
    """Everything a simulator needs to know of a world.

    bounds: x_min, y_min, x_max, y_max (m) of everything in it.
    starts: suggested start pose of each vehicle by name.
    texture_seed, texture_resolution: seed of the painted surfaces; metres per texture pixel.
    """

    name: str
    bounds: tuple[float, float, float, float]
    blocks: tuple[Block, ...]
    pillars: tuple[Pillar, ...] = ()
    faces: tuple[Face, ...] = ()
    tops: tuple[Top, ...] = ()
    boards: tuple[Board, ...] = ()
    pits: tuple[Pit, ...] = ()
    starts: dict[str, Pose2] = field(default_factory=dict)
    texture_seed: int = 0
    texture_resolution: float = 0.006

    def hazards(self, height: float) -> tuple[Block, ...]:
        """Return the footprints of what stops a vehicle of a height (m), but is no solid.

        These are boards whose lower side is not above it, and pits.
        """
        low = [b for b in self.boards if b.bottom < height]
        return tuple(
            [Block(*board[:5], board.top) for board in low]
            + [Block(pit.x, pit.y, pit.half_x, pit.half_y, 0.0, 0.0) for pit in self.pits]
        )

    def occupied(
        self, resolution: float, height: float = 0.0
    ) -> tuple[NDArray[np.bool_], tuple[float, float]]:
        """Rasterize the solids: return cells (rows along y, columns along x) and the origin (m).

        A cell is solid if its centre lies in a block or pillar. resolution: side of a cell (m).
        height: of a vehicle (m), with which its hazards count as well; 0: what a laser sees.
        """
        x_min, y_min, x_max, y_max = self.bounds
        columns = math.ceil((x_max - x_min) / resolution - 1e-9)
        rows = math.ceil((y_max - y_min) / resolution - 1e-9)
        x = x_min + (np.arange(columns, dtype=np.float64) + 0.5) * resolution
        y = y_min + (np.arange(rows, dtype=np.float64) + 0.5) * resolution
        solid = np.zeros((rows, columns), np.bool_)
        for block in (*self.blocks, *(self.hazards(height) if height > 0.0 else ())):
            reach = math.hypot(block.half_x, block.half_y)
            r, c = _window(y, block.y, reach), _window(x, block.x, reach)
            dx, dy = x[c][None, :] - block.x, y[r][:, None] - block.y
            cos, sin = math.cos(block.yaw), math.sin(block.yaw)
            inside = (np.abs(cos * dx + sin * dy) <= block.half_x) & (
                np.abs(cos * dy - sin * dx) <= block.half_y
            )
            solid[r, c] |= inside
        for pillar in self.pillars:
            r, c = _window(y, pillar.y, pillar.radius), _window(x, pillar.x, pillar.radius)
            dx, dy = x[c][None, :] - pillar.x, y[r][:, None] - pillar.y
            solid[r, c] |= dx**2 + dy**2 <= pillar.radius**2
        return solid, (x_min, y_min)


def _window(axis: Array, center: float, reach: float) -> slice:
    """Return the indices of an ascending axis within reach of the centre."""
    low, high = np.searchsorted(axis, [center - reach, center + reach])
    return slice(int(low), int(high))


def block_corners(block: Block | Board) -> Array:
    """Return the counterclockwise corners (4, 2) m of a block or a board."""
    cos, sin = math.cos(block.yaw), math.sin(block.yaw)
    local = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * (block.half_x, block.half_y)
    turned: Array = local @ np.array([[cos, sin], [-sin, cos]]) + (block.x, block.y)
    return turned


def pillar_corners(pillar: Pillar, sides: int = 16) -> Array:
    """Return the counterclockwise corners (sides, 2) m of the prism drawn for a pillar."""
    angles = 2.0 * np.pi * np.arange(sides) / sides
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return circle * pillar.radius + (pillar.x, pillar.y)


def prism_faces(corners: Array, height: float, style: str) -> tuple[list[Face], Top]:
    """Return side faces and top of the prism over counterclockwise corners (P, 2) m."""
    ends = np.roll(corners, -1, axis=0)
    # the outside lies to the right of counterclockwise edges
    sides = [
        Face(float(a[0]), float(a[1]), float(b[0]), float(b[1]), height, style)
        for a, b in zip(corners, ends, strict=True)
    ]
    return sides, Top(corners, height, style)
