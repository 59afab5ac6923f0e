"""Compiled loops of the grid world: beams, motion of discs, path following.

Cells are (H, W) int8 with row = y index, col = x index: FREE, SOLID (stops and reflects) or GLASS
(stops a vehicle, gives no return). Lengths are metres, angles radians.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel

FREE, SOLID, GLASS = 0, 1, 2

Floats = NDArray[np.float64]


@kernel
def distance_to_disc(
    x: float, y: float, dx: float, dy: float, cx: float, cy: float, radius: float
) -> float:
    """Return how far along the unit direction (dx, dy) a disc begins; inf where it is missed."""
    ax, ay = cx - x, cy - y
    along = ax * dx + ay * dy
    across = ax * dy - ay * dx
    inside = radius * radius - across * across
    if along <= 0.0 or inside <= 0.0:
        return np.inf
    return max(0.0, along - math.sqrt(inside))


@kernel
def cast_beams(
    cells: NDArray[np.int8],
    resolution: float,
    origin: Floats,
    pose: Floats,
    angles: Floats,
    max_range: float,
    bodies: Floats,
    bit: np.uint32,
    reachable: NDArray[np.bool_],
    seen: NDArray[np.uint32],
    ranges: Floats,
) -> tuple[int, int]:
    """Fill ranges (B,) with what a laser at pose (3,) measures; +inf is no return.

    angles (B,) are in the laser frame; bodies (V, 3) are discs x, y, radius of other vehicles.
    A hit lies in the middle of the beam's chord through the solid cell. Every cell a beam crosses
    gets `bit` in seen (H, W). Returns how many reachable cells are new to this vehicle and how
    many are new to the team. Traversal after Amanatides and Woo (1987).
    """
    height, width = cells.shape
    new_own, new_team = 0, 0
    for beam in range(angles.size):
        angle = pose[2] + angles[beam]
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
        along_x, along_y = abs(dx) > 1e-12, abs(dy) > 1e-12
        delta_x = resolution / abs(dx) if along_x else np.inf
        delta_y = resolution / abs(dy) if along_y else np.inf
        next_x = ((col + 1 - px) if dx > 0.0 else (px - col)) * delta_x if along_x else np.inf
        next_y = ((row + 1 - py) if dy > 0.0 else (py - row)) * delta_y if along_y else np.inf
        entered = 0.0
        ranges[beam] = limit if hit_body else np.inf
        while entered <= limit:
            if row < 0 or row >= height or col < 0 or col >= width:
                break
            kind = cells[row, col]
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
def sample_field(
    field: NDArray[np.float32], resolution: float, origin: Floats, x: float, y: float
) -> float:
    """Return the clearance field (H, W) at a point, bilinear between cell centers; 0 outside."""
    fx = (x - origin[0]) / resolution - 0.5
    fy = (y - origin[1]) / resolution - 0.5
    col, row = math.floor(fx), math.floor(fy)
    if row < 0 or col < 0 or row + 1 >= field.shape[0] or col + 1 >= field.shape[1]:
        return 0.0
    a, b = fx - col, fy - row
    low: float = (1.0 - a) * field[row, col] + a * field[row, col + 1]
    high: float = (1.0 - a) * field[row + 1, col] + a * field[row + 1, col + 1]
    value: float = (1.0 - b) * low + b * high
    return value


@kernel
def free_distance(
    field: NDArray[np.float32],
    resolution: float,
    origin: Floats,
    pose: Floats,
    needed: float,
    reach: float,
) -> float:
    """Return how far a disc may go straight on, keeping `needed` from obstacles; at most reach.

    From a place that is already too tight it may go where the clearance grows or is no less.
    """
    dx, dy = math.cos(pose[2]), math.sin(pose[2])
    step = 0.5 * resolution
    last = sample_field(field, resolution, origin, pose[0], pose[1])
    needed = min(needed, last)
    travelled = 0.0
    while travelled < reach:
        ahead = travelled + step
        clearance = sample_field(
            field, resolution, origin, pose[0] + ahead * dx, pose[1] + ahead * dy
        )
        if clearance < needed and clearance < last - 1e-6:
            return travelled
        last = clearance
        travelled = ahead
    return reach


@kernel
def pursue(
    waypoints: Floats,
    segment: int,
    pose: Floats,
    lookahead: float,
    tolerance: float,
    max_speed: float,
    max_turn: float,
    braking: float,
) -> tuple[float, float, int, bool]:
    """Return speed (m/s), turn rate (rad/s), segment and arrival of a vehicle on its path (W, 2).

    Pure pursuit of the point `lookahead` further along the path, turning on the spot when it
    lies more than 45 degrees aside, slowing down in time for the end.
    """
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
    index, rest = segment, lookahead
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
    turn = min(max_turn, max(-max_turn, 2.5 * error))
    if abs(error) > 0.25 * math.pi:
        return 0.0, turn, segment, False
    stop = max(remaining, to_goal)
    speed = min(max_speed * math.cos(error) ** 2, math.sqrt(2.0 * braking * stop))
    return speed, turn, segment, False


@kernel
def nearest_other(poses: Floats, index: int, x: float, y: float) -> float:
    """Return the distance from a point to the nearest vehicle other than `index`."""
    nearest = np.inf
    for other in range(poses.shape[0]):
        if other != index:
            nearest = min(nearest, math.hypot(poses[other, 0] - x, poses[other, 1] - y))
    return nearest


@kernel
def room_before_others(poses: Floats, index: int, apart: float) -> float:
    """Return how far a vehicle may go straight on before its center is `apart` from another's."""
    x, y, theta = poses[index, 0], poses[index, 1], poses[index, 2]
    dx, dy = math.cos(theta), math.sin(theta)
    room = np.inf
    for other in range(poses.shape[0]):
        if other != index:
            room = min(
                room, distance_to_disc(x, y, dx, dy, poses[other, 0], poses[other, 1], apart)
            )
    return room


def compile_kernels() -> dict[str, Any]:
    """Compile every kernel on small input, so that no run pays for it; returns the results."""
    origin = np.zeros(2)
    pose = np.array([0.15, 0.15, 0.0])
    cells = np.zeros((6, 6), np.int8)
    field = np.ones((6, 6), np.float32)
    found = cast_beams(
        cells,
        0.05,
        origin,
        pose,
        np.zeros(2),
        1.0,
        np.zeros((0, 3)),
        np.uint32(1),
        cells == FREE,
        np.zeros((6, 6), np.uint32),
        np.zeros(2),
    )
    path = np.array([[0.15, 0.15], [0.2, 0.2]])
    return {
        'cast_beams': found,
        'free_distance': free_distance(field, 0.05, origin, pose, 0.1, 0.2),
        'pursue': pursue(path, 0, pose, 0.3, 0.1, 0.5, 1.0, 1.0),
        'nearest_other': nearest_other(pose[None], 0, 0.0, 0.0),
        'room_before_others': room_before_others(pose[None], 0, 0.6),
    }
