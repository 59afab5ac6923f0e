"""What a world consists of: solids for laser and collisions, faces for the camera, start poses."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.errors import SimulationError
from explore_slam.geometry import Array, Pose2

MAP_KEY = 'image'  # a YAML file with this key is a map of map_server, else it is a world


class Block(NamedTuple):
    """An upright box on the floor: centre and half sizes (m), heading of its x axis (rad)."""

    x: float
    y: float
    half_x: float
    half_y: float
    yaw: float
    height: float


class Pillar(NamedTuple):
    """An upright cylinder on the floor (m)."""

    x: float
    y: float
    radius: float
    height: float


class Face(NamedTuple):
    """An upright rectangle on the floor from (x0, y0) to (x1, y1) (m), seen from its right side.

    style names how it is painted (see paint.STYLES).
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
    """A level polygon, corners (P, 2) m against the clock, at a height (m)."""

    corners: Array
    height: float
    style: str


@dataclass(frozen=True)
class World:
    """A world, in metres; bounds are x_min, y_min, x_max, y_max of all that is in it.

    starts: vehicle name -> start pose that the world suggests.
    """

    name: str
    bounds: tuple[float, float, float, float]
    blocks: tuple[Block, ...]
    pillars: tuple[Pillar, ...] = ()
    faces: tuple[Face, ...] = ()
    tops: tuple[Top, ...] = ()
    starts: dict[str, Pose2] = field(default_factory=dict)
    texture_seed: int = 0
    texture_resolution: float = 0.006

    @classmethod
    def load(cls, path: Path | str) -> 'World':
        """Read a world file or a map_server map (both YAML); else a SimulationError."""
        from explore_slam.simulation.worlds.world_file import read_yaml, world_of_file

        path = Path(path)
        if path.suffix.lower() in {'.pgm', '.png', '.bmp'}:
            raise SimulationError(
                f'{path} is the picture of a map; name its YAML file, which holds the resolution'
            )
        content = read_yaml(path)
        if MAP_KEY not in content:
            return world_of_file(path, content)
        from explore_slam.simulation.worlds.map_world import world_of_map

        return world_of_map(path)

    def occupied(self, resolution: float) -> tuple[NDArray[np.bool_], tuple[float, float]]:
        """Return what is solid as a bool grid (rows along y, columns along x) and its origin (m).

        A cell is solid when its centre lies in a block or pillar.
        """
        x_min, y_min, x_max, y_max = self.bounds
        columns = math.ceil((x_max - x_min) / resolution - 1e-9)
        rows = math.ceil((y_max - y_min) / resolution - 1e-9)
        x = x_min + (np.arange(columns, dtype=np.float64) + 0.5) * resolution
        y = y_min + (np.arange(rows, dtype=np.float64) + 0.5) * resolution
        solid = np.zeros((rows, columns), np.bool_)
        for block in self.blocks:
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


def world_path(name: str) -> Path:
    """Return the file of a world: a path as it is, else a world of the package by its name."""
    given = Path(name)
    if given.suffix or given.exists():
        return given
    known: dict[str, Path] = {}
    for parent in Path(__file__).resolve().parents:
        for folder in (parent / 'config/worlds', parent / 'share/explore_slam/config/worlds'):
            for path in sorted(folder.glob('*.yaml')):
                known.setdefault(path.stem, path)
    if name not in known:
        raise SimulationError(
            f'there is no world {name!r}: expected a YAML file or one of {sorted(known)}'
        )
    return known[name]


def _window(axis: Array, center: float, reach: float) -> slice:
    """Return the part of an ascending axis within reach of the centre."""
    low, high = np.searchsorted(axis, [center - reach, center + reach])
    return slice(int(low), int(high))


def block_corners(block: Block) -> Array:
    """Return the corners (4, 2) m of a block against the clock."""
    cos, sin = math.cos(block.yaw), math.sin(block.yaw)
    local = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * (block.half_x, block.half_y)
    turned: Array = local @ np.array([[cos, sin], [-sin, cos]]) + (block.x, block.y)
    return turned


def pillar_corners(pillar: Pillar, sides: int = 16) -> Array:
    """Return the corners (sides, 2) m of the prism drawn for a pillar, against the clock."""
    angles = 2.0 * np.pi * np.arange(sides) / sides
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return circle * pillar.radius + (pillar.x, pillar.y)


def prism_faces(corners: Array, height: float, style: str) -> tuple[list[Face], Top]:
    """Return the side faces and the top of a prism over corners (P, 2) m against the clock."""
    ends = np.roll(corners, -1, axis=0)
    # walked against the clock the outside lies to the right
    sides = [
        Face(float(a[0]), float(a[1]), float(b[0]), float(b[1]), height, style)
        for a, b in zip(corners, ends, strict=True)
    ]
    return sides, Top(corners, height, style)
