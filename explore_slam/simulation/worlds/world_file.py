"""World files: YAML with walls, doors, furniture and start poses, in metres and radians.

Every error is a SimulationError that names the file, the key, the value and what was expected.
The comments of config/worlds/office.yaml document the format.
"""

import difflib
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from explore_slam.errors import SimulationError
from explore_slam.files import read_mapping
from explore_slam.geometry import Pose2, wrap_angle
from explore_slam.simulation.worlds.paint import STYLES
from explore_slam.simulation.worlds.world import (
    Block,
    Board,
    Face,
    Pillar,
    Pit,
    Top,
    World,
    block_corners,
    pillar_corners,
    prism_faces,
)

# kind -> ((size along x, along y, height) m, style); round kinds: ((radius, height) m, style).
# Usual sizes of office furniture; a world file may give others with `size`.
BOX_KINDS: dict[str, tuple[tuple[float, float, float], str]] = {
    'bookshelf': ((1.2, 0.35, 1.8), 'shelf'),
    'cabinet': ((0.8, 0.45, 1.2), 'cabinet'),
    'desk': ((1.4, 0.7, 0.74), 'wood'),
    'sofa': ((1.6, 0.8, 0.7), 'fabric'),
    'crate': ((0.6, 0.6, 0.6), 'crate'),
    'partition': ((1.5, 0.08, 1.5), 'panel'),
}
ROUND_KINDS: dict[str, tuple[tuple[float, float], str]] = {
    'column': ((0.25, 2.2), 'concrete'),
    'bin': ((0.2, 0.6), 'crate'),
    'plant': ((0.3, 1.1), 'plant'),
}
# what a laser near the floor does not see: kind -> (size along x, along y, height of the upper
# side) m; of a step, how much lower the floor is there
HANGING_KINDS: dict[str, tuple[float, float, float]] = {
    'table': (1.4, 0.7, 0.7),
    'wall_shelf': (1.2, 0.3, 0.6),
    'step': (1.2, 1.0, 0.18),
}
_BOARD = 0.03  # m, thickness of table tops and shelves
_LEG, _LEG_INSET = 0.05, 0.05  # m, side of a table's leg and its distance from the edge of the top
_NARROWEST_DOOR = 0.6  # m; a vehicle of radius 0.26 m passes with 0.04 m to spare on each side
_SHORTEST_WALL = 0.05  # m


def read_entries(path: Path) -> dict[str, Any]:
    """Return the mapping in a YAML file."""
    expected = 'a mapping with the keys of a world or of a map_server map'
    return read_mapping(path, SimulationError, expected)


@dataclass(frozen=True)
class Entry:
    """A value of a world file with its location, for error messages that name it."""

    path: Path
    where: str
    value: Any

    def fail(self, expected: str) -> SimulationError:
        """Return the error for a value that is not what was expected."""
        return SimulationError(f'{self.path}: {self.where} is {self.value!r}, expected {expected}')

    def child(self, key: str | int, default: Any = None) -> 'Entry':
        """Return the entry below a key or index."""
        if isinstance(key, int):
            return Entry(self.path, f'{self.where}[{key}]', self.value[key])
        where = f'{self.where}.{key}' if self.where else key
        return Entry(self.path, where, self.value.get(key, default))

    def mapping(self, required: set[str], optional: set[str]) -> 'Entry':
        """Return this entry; raise unless it is a mapping with these keys."""
        if not isinstance(self.value, Mapping):
            raise self.fail(f'a mapping with the keys {sorted(required | optional)}')
        known = required | optional
        for key in self.value:
            if key not in known:
                near = difflib.get_close_matches(str(key), known, n=1)
                hint = f"; did you mean '{near[0]}'?" if near else f', only {sorted(known)}'
                raise SimulationError(
                    f"{self.path}: {self.where or 'the world'} has no key '{key}'{hint}"
                )
        for key in sorted(required):
            if key not in self.value:
                raise SimulationError(f"{self.path}: {self.where or 'the world'} lacks '{key}'")
        return self

    def items(self) -> 'Iterator[Entry]':
        """Yield the entries of a list; a missing value counts as an empty list."""
        if self.value is None:
            return
        if not isinstance(self.value, list):
            raise self.fail('a list')
        for index in range(len(self.value)):
            yield self.child(index)

    def number(self, low: float = -math.inf, high: float = math.inf, unit: str = 'm') -> float:
        """Return a finite number within [low, high]."""
        value = self.value
        numeric = isinstance(value, int | float) and not isinstance(value, bool)
        if not numeric or not math.isfinite(value) or not low <= value <= high:
            bounds = '' if math.isinf(low) and math.isinf(high) else f' from {low:g} to {high:g}'
            raise self.fail(f'a number{bounds} ({unit})')
        return float(value)

    def numbers(self, names: str, low: float = -math.inf, high: float = math.inf) -> list[float]:
        """Return as many numbers as there are names, e.g. 'x y'."""
        count = len(names.split())
        if not isinstance(self.value, list) or len(self.value) != count:
            raise self.fail(f'[{", ".join(names.split())}]')
        return [self.child(index).number(low, high) for index in range(count)]

    def choice(self, known: list[str]) -> str:
        """Return the value; raise unless it is one of the known words."""
        if self.value not in known:
            raise self.fail(f'one of {known}')
        return str(self.value)


@dataclass
class _Parts:
    """The parts of a world read so far."""

    blocks: list[Block]
    pillars: list[Pillar]
    faces: list[Face]
    tops: list[Top]
    boards: list[Board]
    pits: list[Pit]

    def add_block(self, block: Block, style: str) -> None:
        self.blocks.append(block)
        sides, top = prism_faces(block_corners(block), block.height, style)
        self.faces.extend(sides)
        self.tops.append(top)

    def add_pillar(self, pillar: Pillar, style: str) -> None:
        self.pillars.append(pillar)
        sides, top = prism_faces(pillar_corners(pillar), pillar.height, style)
        self.faces.extend(sides)
        self.tops.append(top)


def world_of_file(path: Path, content: dict[str, Any]) -> World:
    """Return the world described by the content of a world file."""
    root = Entry(path, '', content).mapping(
        {'size'}, {'name', 'walls', 'furniture', 'starts', 'textures'}
    )
    width, depth = root.child('size').numbers('width depth', 1.0, 500.0)
    textures = root.child('textures', {}).mapping(set(), {'seed', 'resolution'})
    walls = root.child('walls', {}).mapping(set(), {'height', 'thickness', 'style', 'inner'})
    height = walls.child('height', 2.2).number(0.5, 10.0)
    thickness = walls.child('thickness', 0.1).number(0.02, 1.0)
    style = walls.child('style', 'plaster').choice(sorted(STYLES))
    parts = _Parts([], [], [], [], [], [])
    _outer_walls(parts, width, depth, height, thickness, style)
    for entry in walls.child('inner').items():
        _inner_wall(parts, entry, (width, depth), (height, thickness, style))
    for entry in root.child('furniture').items():
        _furniture(parts, entry, (width, depth))
    t = thickness
    return World(
        name=str(root.child('name', path.stem).value),
        bounds=(-t, -t, width + t, depth + t),
        blocks=tuple(parts.blocks),
        pillars=tuple(parts.pillars),
        faces=tuple(parts.faces),
        tops=tuple(parts.tops),
        boards=tuple(parts.boards),
        pits=tuple(parts.pits),
        starts=_starts(root.child('starts', {}), width, depth),
        texture_seed=_seed(textures.child('seed', 0)),
        texture_resolution=textures.child('resolution', 0.006).number(0.001, 0.1, 'm per pixel'),
    )


def _seed(entry: Entry) -> int:
    if not isinstance(entry.value, int) or isinstance(entry.value, bool) or entry.value < 0:
        raise entry.fail('an integer >= 0')
    return entry.value


def _outer_walls(
    parts: _Parts, width: float, depth: float, height: float, t: float, style: str
) -> None:
    """Add the four walls around [0, width] x [0, depth]; only their inner faces are painted."""
    corners = [(0.0, 0.0), (0.0, depth), (width, depth), (width, 0.0)]
    for a, b in zip(corners, [*corners[1:], corners[0]], strict=True):
        parts.faces.append(Face(*a, *b, height, style))
    half = 0.5 * t
    for block in (
        Block(-half, depth / 2, half, depth / 2 + t, 0.0, height),
        Block(width / 2, depth + half, width / 2, half, 0.0, height),
        Block(width + half, depth / 2, half, depth / 2 + t, 0.0, height),
        Block(width / 2, -half, width / 2, half, 0.0, height),
    ):
        parts.blocks.append(block)
        parts.tops.append(Top(block_corners(block), height, style))


def _inner_wall(
    parts: _Parts,
    entry: Entry,
    size: tuple[float, float],
    defaults: tuple[float, float, str],
) -> None:
    """Add a straight wall with openings for its doors: [distance from the wall's start, width]."""
    entry.mapping({'from', 'to'}, {'doors', 'style', 'height', 'thickness'})
    height = entry.child('height', defaults[0]).number(0.3, 10.0)
    thickness = entry.child('thickness', defaults[1]).number(0.02, 1.0)
    style = entry.child('style', defaults[2]).choice(sorted(STYLES))
    x0, y0 = _point(entry.child('from'), size)
    x1, y1 = _point(entry.child('to'), size)
    length, yaw = math.hypot(x1 - x0, y1 - y0), math.atan2(y1 - y0, x1 - x0)
    if length < _SHORTEST_WALL:
        raise entry.child('to').fail(f"a point at least {_SHORTEST_WALL} m from 'from'")
    start = 0.0
    for door in entry.child('doors').items():
        at, opening = door.numbers('distance width', 0.0, length)
        if at < start or at + opening > length + 1e-9:
            raise door.fail(
                f'a door between {start:g} and {length:g} m along the wall, in ascending order'
            )
        if opening < _NARROWEST_DOOR:
            raise door.fail(f'a width of at least {_NARROWEST_DOOR} m for vehicles to pass')
        _wall_piece(parts, (x0, y0, yaw), (start, at), (thickness, height), style)
        start = at + opening
    _wall_piece(parts, (x0, y0, yaw), (start, length), (thickness, height), style)


def _wall_piece(
    parts: _Parts,
    origin: tuple[float, float, float],
    span: tuple[float, float],
    section: tuple[float, float],
    style: str,
) -> None:
    (x, y, yaw), (start, end), (thickness, height) = origin, span, section
    if end - start < 1e-6:
        return
    middle = 0.5 * (start + end)
    center = (x + math.cos(yaw) * middle, y + math.sin(yaw) * middle)
    block = Block(*center, 0.5 * (end - start), 0.5 * thickness, yaw, height)
    parts.add_block(block, style)


def _furniture(parts: _Parts, entry: Entry, size: tuple[float, float]) -> None:
    entry.mapping({'kind', 'at'}, {'size', 'yaw', 'style'})
    kind = entry.child('kind').choice(sorted([*BOX_KINDS, *ROUND_KINDS, *HANGING_KINDS]))
    x, y = _point(entry.child('at'), size)
    if kind in HANGING_KINDS:
        _hanging(parts, entry, kind, (x, y))
        return
    if kind in ROUND_KINDS:
        (radius, height), usual = ROUND_KINDS[kind]
        if 'size' in entry.value:
            radius, height = entry.child('size').numbers('radius height', 0.02, 20.0)
        style = entry.child('style', usual).choice(sorted(STYLES))
        parts.add_pillar(Pillar(x, y, radius, height), style)
        return
    dimensions, usual = BOX_KINDS[kind]
    if 'size' in entry.value:
        a, b, c = entry.child('size').numbers('length depth height', 0.02, 100.0)
        dimensions = (a, b, c)
    yaw = wrap_angle(entry.child('yaw', 0.0).number(unit='rad'))
    style = entry.child('style', usual).choice(sorted(STYLES))
    half_x, half_y = 0.5 * dimensions[0], 0.5 * dimensions[1]
    parts.add_block(Block(x, y, half_x, half_y, yaw, dimensions[2]), style)


def _hanging(parts: _Parts, entry: Entry, kind: str, at: tuple[float, float]) -> None:
    """Add a table, a shelf on a wall or a step down."""
    a, b, c = HANGING_KINDS[kind]
    if 'size' in entry.value:
        name = 'depth' if kind == 'step' else 'height'
        a, b, c = entry.child('size').numbers(f'length width {name}', 0.05, 100.0)
    yaw = wrap_angle(entry.child('yaw', 0.0).number(unit='rad'))
    if 'style' in entry.value:
        raise entry.child('style').fail(f'no style: a {kind} has none')
    if kind == 'step':
        if yaw != 0.0:
            raise entry.child('yaw').fail('0: a step lies along the axes')
        parts.pits.append(Pit(*at, 0.5 * a, 0.5 * b, c))
        return
    parts.boards.append(Board(*at, 0.5 * a, 0.5 * b, yaw, c - _BOARD, c))
    if kind == 'wall_shelf':
        return
    cos, sin = math.cos(yaw), math.sin(yaw)
    inset = _LEG_INSET + 0.5 * _LEG
    for across in (-1.0, 1.0):
        for along in (-1.0, 1.0):
            u, v = along * (0.5 * a - inset), across * (0.5 * b - inset)
            x, y = at[0] + cos * u - sin * v, at[1] + sin * u + cos * v
            leg = Block(x, y, 0.5 * _LEG, 0.5 * _LEG, yaw, c - _BOARD)
            parts.add_block(leg, 'wood')


def _point(entry: Entry, size: tuple[float, float]) -> tuple[float, float]:
    x, y = entry.numbers('x y')
    if not (0.0 <= x <= size[0] and 0.0 <= y <= size[1]):
        raise entry.fail(f'a point within the world of {size[0]:g} x {size[1]:g} m')
    return x, y


def _starts(entry: Entry, width: float, depth: float) -> dict[str, Pose2]:
    if not isinstance(entry.value, Mapping):
        raise entry.fail('a mapping: vehicle: [x, y, theta]')
    starts = {}
    for name in entry.value:
        pose = entry.child(str(name))
        x, y, theta = pose.numbers('x y theta')
        if not (0.0 <= x <= width and 0.0 <= y <= depth):
            raise pose.fail(f'x, y within the world of {width:g} x {depth:g} m')
        starts[str(name)] = Pose2(x, y, wrap_angle(theta))
    return starts
