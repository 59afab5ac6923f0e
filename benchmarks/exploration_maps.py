"""Draw maps of unlike kinds for `explore_slam benchmark exploration --map`.

python benchmarks/exploration_maps.py --output FOLDER [--seed 0]

One map_server map (YAML and PGM) of each kind: offices along a corridor, a hall cluttered with
furniture, a warehouse, a maze of narrow corridors, a cave, and a large building whose corridors
are loops. Equal seeds draw equal maps.
"""

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

RESOLUTION = 0.05  # m
Solid = NDArray[np.bool_]


def _cells(metres: float) -> int:
    return round(metres / RESOLUTION)


def _fill(solid: Solid, x: float, y: float, width: float, height: float, value: bool) -> None:
    """Set a rectangle with its lower left corner at (x, y), all in metres."""
    rows = slice(max(_cells(y), 0), max(_cells(y + height), 0))
    solid[rows, max(_cells(x), 0) : max(_cells(x + width), 0)] = value


def _hall(width: float, height: float, wall: float = 0.2) -> Solid:
    """Return an empty hall with outer walls."""
    solid = np.ones((_cells(height), _cells(width)), np.bool_)
    _fill(solid, wall, wall, width - 2.0 * wall, height - 2.0 * wall, False)
    return solid


def offices(random: np.random.Generator) -> Solid:
    """Return rooms of unequal width on both sides of a corridor, each with a door and a desk."""
    width, height, corridor = 30.0, 14.0, 2.0
    solid = _hall(width, height)
    low, high = 0.5 * (height - corridor), 0.5 * (height + corridor)
    for wall_y, room_y, depth in ((low - 0.2, 0.2, low - 0.4), (high, high + 0.2, low - 0.4)):
        _fill(solid, 0.0, wall_y, width, 0.2, True)
        x = 0.2
        while x < width - 2.5:
            room = min(float(random.uniform(3.0, 5.5)), width - 0.2 - x)
            _fill(solid, x + room, room_y, 0.2, depth, True)
            door = float(random.uniform(0.8, 1.0))
            _fill(solid, x + random.uniform(0.3, room - door - 0.3), wall_y, door, 0.2, False)
            desk_x, desk_y = random.uniform(0.8, max(room - 2.2, 0.9)), random.uniform(0.0, 2.0)
            _fill(solid, x + desk_x, room_y + 1.2 + desk_y, 1.4, 0.7, True)
            x += room + 0.2
    return solid


def clutter(random: np.random.Generator) -> Solid:
    """Return two halls full of furniture, some of it with gaps that are just wide enough."""
    solid = _hall(20.0, 14.0)
    _fill(solid, 10.0, 0.2, 0.2, 13.6, True)
    for door in (2.5, 9.5):
        _fill(solid, 10.0, door, 0.2, 1.2, False)
    for _ in range(75):
        width, height = random.uniform(0.2, 1.2, 2)
        _fill(solid, random.uniform(0.4, 18.8), random.uniform(0.4, 12.8), width, height, True)
    for door in (2.5, 9.5):
        _fill(solid, 9.2, door, 1.8, 1.2, False)
    return solid


def warehouse(random: np.random.Generator) -> Solid:
    """Return rows of shelves with cross aisles and some pallets."""
    solid = _hall(24.0, 18.0)
    for x in np.arange(2.2, 22.0, 2.8):
        for y in (2.0, 7.4, 12.8):
            _fill(solid, float(x), y, 1.0, float(random.uniform(3.2, 3.8)), True)
    for _ in range(12):
        _fill(solid, random.uniform(1.0, 22.0), random.uniform(1.0, 16.0), 0.6, 0.6, True)
    return solid


def maze(random: np.random.Generator) -> Solid:
    """Return a maze of corridors 1.2 m wide with a few loops (randomized depth-first search)."""
    rows, cols, pitch, corridor = 9, 13, 1.4, 1.2
    solid = np.ones((_cells(rows * pitch + 0.2), _cells(cols * pitch + 0.2)), np.bool_)

    def open_between(a: tuple[int, int], b: tuple[int, int]) -> None:
        (r, c), (s, d) = min(a, b), max(a, b)
        width, height = corridor + (d - c) * pitch, corridor + (s - r) * pitch
        _fill(solid, 0.2 + c * pitch, 0.2 + r * pitch, width, height, False)

    path, seen = [(0, 0)], {(0, 0)}
    while path:
        row, col = path[-1]
        around = [(row + 1, col), (row - 1, col), (row, col + 1), (row, col - 1)]
        inside = [(r, c) for r, c in around if 0 <= r < rows and 0 <= c < cols]
        fresh = [cell for cell in inside if cell not in seen]
        if random.random() < 0.06:
            open_between((row, col), inside[random.integers(len(inside))])
        if not fresh:
            path.pop()
            continue
        chosen = fresh[random.integers(len(fresh))]
        open_between((row, col), chosen)
        seen.add(chosen)
        path.append(chosen)
    return solid


def cave(random: np.random.Generator) -> Solid:
    """Return a cave: smoothed noise, its largest connected part."""
    noise = ndimage.gaussian_filter(random.normal(size=(_cells(16.0), _cells(22.0))), 16.0)
    free = noise > np.quantile(noise, 0.35)
    free[:4], free[-4:], free[:, :4], free[:, -4:] = False, False, False, False
    labels, _ = ndimage.label(free)
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    solid: Solid = labels != sizes.argmax()
    return solid


def loops(random: np.random.Generator) -> Solid:
    """Return two loops of corridors, 70 m each, around blocks of rooms with a door each."""
    block_width, block_height, corridor = 22.0, 13.0, 2.0
    solid = _hall(2.0 * block_width + 3.0 * corridor + 0.4, block_height + 2.0 * corridor + 0.4)
    low, depth = 0.2 + corridor, 0.5 * (block_height - 0.6)
    for left in (0.2 + corridor, 0.2 + block_width + 2.0 * corridor):
        _fill(solid, left, low, block_width, block_height, True)
        for y, door_y in ((low + 0.2, low), (low + depth + 0.4, low + block_height - 0.2)):
            x = left + 0.2
            while x < left + block_width - 2.5:
                room = min(float(random.uniform(4.0, 7.0)), left + block_width - 0.2 - x)
                _fill(solid, x, y, room, depth, False)
                _fill(solid, x + random.uniform(0.4, room - 1.5), door_y, 1.1, 0.2, False)
                desk = float(random.uniform(0.5, room - 1.9))
                _fill(solid, x + desk, y + 0.5 * depth, 1.4, 0.7, True)
                x += room + 0.2
    return solid


KINDS: dict[str, Callable[[np.random.Generator], Solid]] = {
    'offices': offices, 'clutter': clutter, 'warehouse': warehouse, 'maze': maze, 'cave': cave,
    'loops': loops,
}  # fmt: skip


def save(solid: Solid, folder: Path, name: str) -> Path:
    """Write a map (H, W), row 0 at the lowest y, as YAML and PGM; return the path of the YAML."""
    pixels = np.where(solid, 0, 254).astype(np.uint8)[::-1]
    header = f'P5\n{pixels.shape[1]} {pixels.shape[0]}\n255\n'.encode()
    (folder / f'{name}.pgm').write_bytes(header + pixels.tobytes())
    path = folder / f'{name}.yaml'
    path.write_text(
        f'image: {name}.pgm\nresolution: {RESOLUTION}\norigin: [0.0, 0.0, 0.0]\nnegate: 0\n'
        'occupied_thresh: 0.65\nfree_thresh: 0.196\n',
        encoding='utf-8',
    )
    return path


def main() -> None:
    """Draw one map of each kind."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--output', type=Path, required=True)
    parser.add_argument('--seed', type=int, default=0)
    arguments = parser.parse_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    for index, (name, draw) in enumerate(KINDS.items()):
        random = np.random.default_rng([arguments.seed, index])
        print(save(draw(random), arguments.output, name))


if __name__ == '__main__':
    main()
