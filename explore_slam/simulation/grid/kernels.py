"""Compiled loops of the grid simulator: laser beams, collision checks, path following.

Arrays of cells have row = y index, col = x index. Lengths are metres, angles radians.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.simulation.worlds.grid_world import GLASS, SOLID

Floats = NDArray[np.float64]

_PARALLEL = 1e-12  # smaller direction components count as zero: the beam crosses no such edge
_CLEARANCE_ROUNDING = 1e-6  # m; clearance that falls by less counts as unchanged (float32 field)
_TURN_GAIN = 2.5  # 1/s, turn rate per heading error
_TURN_IN_PLACE = 0.25 * math.pi  # rad; at a larger heading error the vehicle turns on the spot


class Cells(NamedTuple):
    """Cells of a world: values (H, W) FREE, SOLID or GLASS, side (m), corner x, y (m)."""

    values: NDArray[np.int8]
    resolution: float
    origin: Floats


class ClearanceField(NamedTuple):
    """Clearance at cell centres: values (H, W) m, side of a cell (m), corner x, y (m)."""

    values: NDArray[np.float32]
    resolution: float
    origin: Floats


class Sweep(NamedTuple):
    """A scan to take: sensor pose (B, 3) and angle (B,) in its frame of each beam, range (m)."""

    poses: Floats
    angles: Floats
    max_range: float


class Coverage(NamedTuple):
    """Cells seen so far.

    reachable: (H, W) cells that count for coverage. seen: (H, W) one bit per vehicle, updated.
    bit: the bit of the vehicle that scans.
    """

    reachable: NDArray[np.bool_]
    seen: NDArray[np.uint32]
    bit: np.uint32


class Pursuit(NamedTuple):
    """Parameters of pure pursuit: m, m, m/s, rad/s, m/s²."""

    lookahead: float
    tolerance: float
    max_speed: float
    max_turn_rate: float
    braking: float


@kernel
def distance_to_disc(
    x: float, y: float, dx: float, dy: float, cx: float, cy: float, radius: float
) -> float:
    """Return the distance along the unit direction (dx, dy) to a disc; inf where it is missed.

    Returns 0 from inside the disc if its centre lies ahead.
    """
    ax, ay = cx - x, cy - y
    along = ax * dx + ay * dy
    across = ax * dy - ay * dx
    inside = radius * radius - across * across
    if along <= 0.0 or inside <= 0.0:
        return np.inf
    return max(0.0, along - math.sqrt(inside))


@kernel
def cast_beams(
    cells: Cells, laser: Sweep, bodies: Floats, coverage: Coverage, ranges: Floats
) -> tuple[int, int]:
    """Cast the beams of a scan; return the numbers of newly seen reachable cells.

    bodies: (V, 3) discs x, y, radius of other vehicles, which stop beams too.
    ranges: (B,) is filled with the measured ranges; +inf is no return.
    The two counts are cells new to this vehicle and cells new to the team. A hit lies at the
    middle of the beam's chord through the solid cell; all cells crossed before it become seen.
    Grid traversal after Amanatides and Woo, "A fast voxel traversal algorithm", 1987.
    """
    values, resolution, origin = cells.values, cells.resolution, cells.origin
    max_range = laser.max_range
    reachable, seen, bit = coverage.reachable, coverage.seen, coverage.bit
    height, width = values.shape
    new_own, new_team = 0, 0
    for beam in range(laser.angles.size):
        pose, angle = laser.poses[beam], laser.poses[beam, 2] + laser.angles[beam]
        dx, dy = math.cos(angle), math.sin(angle)
        limit = max_range
        hit_body = False
        for other in range(bodies.shape[0]):
            reach = distance_to_disc(
                pose[0], pose[1], dx, dy, bodies[other, 0], bodies[other, 1], bodies[other, 2]
            )
            if reach < limit:
                limit = reach
                hit_body = True
        px, py = (pose[0] - origin[0]) / resolution, (pose[1] - origin[1]) / resolution
        col, row = math.floor(px), math.floor(py)
        step_x, step_y = (1 if dx > 0.0 else -1), (1 if dy > 0.0 else -1)
        along_x, along_y = abs(dx) > _PARALLEL, abs(dy) > _PARALLEL
        delta_x = resolution / abs(dx) if along_x else np.inf
        delta_y = resolution / abs(dy) if along_y else np.inf
        next_x = ((col + 1 - px) if dx > 0.0 else (px - col)) * delta_x if along_x else np.inf
        next_y = ((row + 1 - py) if dy > 0.0 else (py - row)) * delta_y if along_y else np.inf
        entered = 0.0
        ranges[beam] = limit if hit_body else np.inf
        while entered <= limit:
            if row < 0 or row >= height or col < 0 or col >= width:
                break
            kind = values[row, col]
            leaving = min(next_x, next_y)
            if kind == SOLID:
                distance = 0.5 * (entered + leaving)
                ranges[beam] = distance if distance <= max_range else np.inf
                break
            if kind == GLASS:
                ranges[beam] = np.inf
                break
            before = seen[row, col]
            if before & bit == 0:
                seen[row, col] = before | bit
                if reachable[row, col]:
                    new_own += 1
                    if before == 0:
                        new_team += 1
            entered = leaving
            if next_x < next_y:
                col += step_x
                next_x += delta_x
            else:
                row += step_y
                next_y += delta_y
    return new_own, new_team


@kernel
def sample_field(field: ClearanceField, x: float, y: float) -> float:
    """Return the clearance (m) at a point, bilinear between cell centres; 0 outside the world."""
    values = field.values
    fx = (x - field.origin[0]) / field.resolution - 0.5
    fy = (y - field.origin[1]) / field.resolution - 0.5
    col, row = math.floor(fx), math.floor(fy)
    if row < 0 or col < 0 or row + 1 >= values.shape[0] or col + 1 >= values.shape[1]:
        return 0.0
    a, b = fx - col, fy - row
    low: float = (1.0 - a) * values[row, col] + a * values[row, col + 1]
    high: float = (1.0 - a) * values[row + 1, col] + a * values[row + 1, col + 1]
    value: float = (1.0 - b) * low + b * high
    return value


@kernel
def free_distance(field: ClearanceField, pose: Floats, needed: float, reach: float) -> float:
    """Return how far a disc can move straight ahead with clearance `needed` (m), at most reach.

    A disc that starts with less clearance may move as long as its clearance does not fall.
    """
    dx, dy = math.cos(pose[2]), math.sin(pose[2])
    step = 0.5 * field.resolution
    last = sample_field(field, pose[0], pose[1])
    needed = min(needed, last)
    travelled = 0.0
    while travelled < reach:
        ahead = travelled + step
        clearance = sample_field(field, pose[0] + ahead * dx, pose[1] + ahead * dy)
        if clearance < needed and clearance < last - _CLEARANCE_ROUNDING:
            return travelled
        last = clearance
        travelled = ahead
    return reach


@kernel
def pursue(
    waypoints: Floats, segment: int, pose: Floats, pursuit: Pursuit
) -> tuple[float, float, int, bool]:
    """Return speed (m/s), turn rate (rad/s), segment and arrival for a path (W, 2).

    Pure pursuit (Coulter, 1992) of the point `lookahead` further along the path. The vehicle turns
    on the spot where that point lies more than 45° aside, and brakes in time for the end.
    segment: index of the path's segment followed last.
    """
    tolerance = pursuit.tolerance
    count = waypoints.shape[0]
    x, y = pose[0], pose[1]
    to_goal = math.hypot(waypoints[count - 1, 0] - x, waypoints[count - 1, 1] - y)
    share = 0.0
    while segment < count - 1:
        ax, ay = waypoints[segment, 0], waypoints[segment, 1]
        bx, by = waypoints[segment + 1, 0] - ax, waypoints[segment + 1, 1] - ay
        square = bx * bx + by * by
        share = 1.0 if square == 0.0 else ((x - ax) * bx + (y - ay) * by) / square
        share = max(share, 0.0)
        near_end = math.hypot(ax + bx - x, ay + by - y) < 0.5 * tolerance
        if share < 1.0 and not (near_end and segment < count - 2):
            break
        if segment == count - 2:
            share = 1.0
            break
        segment += 1
    if to_goal <= tolerance and segment >= count - 2:
        return 0.0, 0.0, segment, True
    index, rest = segment, pursuit.lookahead
    tx, ty = waypoints[count - 1, 0], waypoints[count - 1, 1]
    start_share = share
    remaining = 0.0
    while index < count - 1:
        ax, ay = waypoints[index, 0], waypoints[index, 1]
        bx, by = waypoints[index + 1, 0] - ax, waypoints[index + 1, 1] - ay
        length = math.hypot(bx, by)
        left = (1.0 - start_share) * length
        remaining += left
        if left >= rest >= 0.0:
            part = start_share + rest / length if length > 0.0 else 1.0
            tx, ty = ax + part * bx, ay + part * by
            rest = -1.0
        elif rest >= 0.0:
            rest -= left
        start_share = 0.0
        index += 1
    error = math.atan2(ty - y, tx - x) - pose[2]
    error = math.atan2(math.sin(error), math.cos(error))
    max_turn = pursuit.max_turn_rate
    turn = min(max_turn, max(-max_turn, _TURN_GAIN * error))
    if abs(error) > _TURN_IN_PLACE:
        return 0.0, turn, segment, False
    stop = max(remaining, to_goal)
    speed = min(pursuit.max_speed * math.cos(error) ** 2, math.sqrt(2.0 * pursuit.braking * stop))
    return speed, turn, segment, False


@kernel
def smallest_gap(poses: Floats, radii: Floats, index: int, x: float, y: float) -> float:
    """Return the gap (m) between a vehicle, moved to a point, and the nearest other one.

    poses (V, 3), radii (V,) m: of the discs. It is negative if they overlap.
    """
    smallest = np.inf
    for other in range(poses.shape[0]):
        if other != index:
            between = math.hypot(poses[other, 0] - x, poses[other, 1] - y)
            smallest = min(smallest, between - (radii[index] + radii[other]))
    return smallest


@kernel
def distance_to_others(poses: Floats, radii: Floats, index: int, margin: float) -> float:
    """Return how far a vehicle can move ahead until it is within a margin (m) of another.

    poses (V, 3), radii (V,) m: of the discs.
    """
    x, y, theta = poses[index, 0], poses[index, 1], poses[index, 2]
    dx, dy = math.cos(theta), math.sin(theta)
    distance = np.inf
    for other in range(poses.shape[0]):
        if other != index:
            apart = radii[index] + radii[other] + margin
            distance = min(
                distance, distance_to_disc(x, y, dx, dy, poses[other, 0], poses[other, 1], apart)
            )
    return distance


def warm_up() -> None:
    """Compile all kernels on small inputs, so that no run waits for the compiler."""
    origin, pose = np.zeros(2), np.array([0.15, 0.15, 0.0])
    free = np.zeros((6, 6), np.int8)
    field = ClearanceField(np.ones((6, 6), np.float32), 0.05, origin)
    cast_beams(
        Cells(free, 0.05, origin),
        Sweep(np.stack([pose, pose]), np.zeros(2), 1.0),
        np.zeros((0, 3)),
        Coverage(free == SOLID, np.zeros((6, 6), np.uint32), np.uint32(1)),
        np.zeros(2),
    )
    sample_field(field, 0.1, 0.1)
    free_distance(field, pose, 0.1, 0.2)
    path = np.array([[0.15, 0.15], [0.2, 0.2]])
    pursue(path, 0, pose, Pursuit(0.3, 0.1, 0.5, 1.0, 1.0))
    smallest_gap(pose[None], np.array([0.2]), 0, 0.0, 0.0)
    distance_to_others(pose[None], np.array([0.2]), 0, 0.2)
