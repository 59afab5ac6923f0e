"""Two parallel corridors of equal rooms, joined at their ends: a test of perceptual aliasing.

Every room looks like the next one, so that scans match a whole number of periods away as well as
where they belong. Only the two lobbies at the ends show where a vehicle is. Walls are line
segments; a laser is cast on them exactly.
"""

import itertools
import math
from dataclasses import dataclass

import numpy as np

from explore_slam.errors import SimulationError
from explore_slam.geometry import Array, Pose2, wrap_angle
from explore_slam.simulation.worlds.walls import Point, box, distances_along, line

PERIODS = (3.0, 4.0, 6.0)  # m; of the worlds with seeds 0, 1, 2, 3 ...
ROOMS = 12  # of each corridor
HALF_WIDTH = 1.0  # m, of a corridor
SECOND = 8.0  # m; y of the axis of the second corridor, the first one is at 0
LOBBY = 4.0  # m, depth of the lobbies along x
AISLE = 1.5  # m from the ends of the corridors to where a lap crosses the lobbies


@dataclass(frozen=True)
class TwinCorridors:
    """Walls (n, 4) x0, y0, x1, y1 (m); period (m) of the rooms; length (m) of the corridors."""

    walls: Array
    period: float
    length: float

    def ring(self) -> list[Point]:
        """Return the corners of a lap: east through the first corridor, back by the second."""
        west, east = -AISLE, self.length + AISLE
        return [(west, 0.0), (east, 0.0), (east, SECOND), (west, SECOND)]

    def near_end(self, x: float, reach: float) -> int | None:
        """Return the lobby within reach (m) of x along the corridors: 0 west, 1 east, or None."""
        if x < reach:
            return 0
        return 1 if x > self.length - reach else None

    def ranges(self, pose: Pose2, angles: Array) -> Array:
        """Return the distances (B,) m to the walls along beams at angles (rad); inf: none."""
        return distances_along(self.walls, np.array([[pose.x, pose.y]]), angles + pose.theta)


def twin_corridors(seed: int) -> TwinCorridors:
    """Return the world of a seed; seeds take PERIODS in turn, all else is drawn at random."""
    if seed < 0:
        raise SimulationError(f'seed is {seed}, expected 0 or more')
    random = np.random.default_rng(seed)
    period = PERIODS[seed % len(PERIODS)]
    length = ROOMS * period
    room = _room(period, random)
    parts = []
    for y, side in ((0.0, -1.0), (SECOND, 1.0)):
        inner = y - side * HALF_WIDTH
        parts.append(line((0.0, inner), (length, inner)))
        for number in range(ROOMS):
            at = room.copy()
            at[:, [0, 2]] += number * period
            at[:, [1, 3]] = y + side * at[:, [1, 3]]
            parts.append(at)
    for x, outward in ((0.0, -1.0), (length, 1.0)):
        parts.append(_lobby(x, outward, random))
    return TwinCorridors(np.concatenate(parts), period, length)


def _room(period: float, random: np.random.Generator) -> Array:
    """Return a room along x from 0 to the period, y away from the axis of its corridor."""
    door = random.uniform(0.4, period - 1.6)
    depth = HALF_WIDTH + random.uniform(2.5, 4.0)
    cupboard = random.uniform(0.2, period - 1.0)
    return np.concatenate(
        [
            line((0.0, HALF_WIDTH), (door, HALF_WIDTH)),
            line((door + 1.0, HALF_WIDTH), (period, HALF_WIDTH)),
            line((0.1, HALF_WIDTH), (0.1, depth), (period - 0.1, depth)),
            line((period - 0.1, depth), (period - 0.1, HALF_WIDTH)),
            box(cupboard, depth - 0.5, 0.7, 0.4),
        ]
    )


def _lobby(x: float, outward: float, random: np.random.Generator) -> Array:
    """Return the lobby at the end x of the corridors: an uneven wall, and furniture before it."""
    low, high = -HALF_WIDTH, SECOND + HALF_WIDTH
    corners: list[Point] = [(x, low)]
    y = low
    while y < high:
        far = x + outward * (LOBBY + random.uniform(-0.8, 0.8))
        above = min(y + random.uniform(1.2, 2.8), high)
        corners += [(far, y), (far, above)]
        y = above
    corners.append((x, high))
    parts = [line(*corners), line((x, HALF_WIDTH), (x, SECOND - HALF_WIDTH))]
    for centre in (1.5, 4.0, 6.5):
        near = x + outward * random.uniform(2.4, 2.8)
        bottom = centre + random.uniform(-0.8, 0.4)
        parts.append(box(near - 0.2, bottom, random.uniform(0.3, 0.5), random.uniform(0.3, 0.9)))
    return np.concatenate(parts)


def along(corners: list[Point], step: float, turn: float) -> list[Pose2]:
    """Return poses every step (m) along a line through corners, turning on the spot by turn."""
    poses: list[Pose2] = []
    heading: float | None = None
    for begin, end in itertools.pairwise(corners):
        wanted = math.atan2(end[1] - begin[1], end[0] - begin[0])
        if heading is not None:
            left = wrap_angle(wanted - heading)
            parts = max(math.ceil(abs(left) / turn), 1)
            poses += [Pose2(*begin, heading + left * k / parts) for k in range(1, parts)]
        heading = wanted
        parts = max(math.ceil(math.dist(begin, end) / step), 1)
        for share in np.arange(parts) / parts:
            x = begin[0] + share * (end[0] - begin[0])
            y = begin[1] + share * (end[1] - begin[1])
            poses.append(Pose2(float(x), float(y), heading))
    return poses
