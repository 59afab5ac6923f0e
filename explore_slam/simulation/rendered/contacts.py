"""Collision checks in the plane against walls, furniture and other vehicles."""

import math
from collections.abc import Mapping

from explore_slam.errors import SimulationError
from explore_slam.geometry import Pose2
from explore_slam.simulation.records import HAZARD, WALL
from explore_slam.simulation.worlds.obstacles import Obstacles
from explore_slam.simulation.worlds.world import World

BISECTIONS = 6  # the free part of an increment is found to 1/64 of it
Poses = Mapping[str, Pose2]


class Contacts:
    """Collision checks for vehicles that are discs with one radius and height (m).

    Boards that hang lower than that touch a vehicle, and so do the edges of pits.
    """

    def __init__(self, world: World, radius: float, height: float) -> None:
        self._world = world
        self._solids = Obstacles(world)
        self._obstacles = Obstacles(world, height)
        self._radius = radius

    def check_poses(self, starts: Poses) -> None:
        """Raise SimulationError for a pose outside the world, in a solid or in another vehicle."""
        radius = self._radius
        x0, y0, x1, y1 = self._world.bounds
        for index, (name, pose) in enumerate(starts.items()):
            where = f'pose of {name!r} ({pose.x:g}, {pose.y:g}, {pose.theta:g})'
            if not pose.is_finite() or not (x0 <= pose.x <= x1 and y0 <= pose.y <= y1):
                raise SimulationError(
                    f'{where} lies outside world {self._world.name!r}, '
                    f'expected x in {x0:g}..{x1:g} and y in {y0:g}..{y1:g} m'
                )
            clearance = self._obstacles.clearance(pose.x, pose.y)
            if clearance < radius:
                place = 'inside a wall' if clearance <= 0.0 else f'{clearance:.2f} m from a wall'
                raise SimulationError(f'{where} lies {place}, expected at least {radius:g} m')
            for other, there in list(starts.items())[:index]:
                gap = _distance(pose, there)
                if gap < 2.0 * radius:
                    raise SimulationError(
                        f'{where} lies {gap:.2f} m from that of {other!r}, '
                        f'expected at least {2.0 * radius:g} m'
                    )

    def obstacle_between(self, pose: Pose2, wanted: Pose2, others: Poses) -> str:
        """Return the obstacle of a motion between two poses: WALL, HAZARD, a vehicle, or ''.

        A vehicle that already touches an obstacle is stopped by it only when it comes closer.
        """
        clearance = self._obstacles.clearance(wanted.x, wanted.y)
        if clearance < self._radius and clearance < self._obstacles.clearance(pose.x, pose.y):
            solid = self._solids.clearance(wanted.x, wanted.y) < self._radius
            return WALL if solid else HAZARD
        for name, other in others.items():
            gap = _distance(wanted, other)
            if gap < 2.0 * self._radius and gap < _distance(pose, other):
                return name
        return ''

    def shortened(self, pose: Pose2, increment: Pose2, others: Poses) -> Pose2:
        """Return an increment with its translation shortened to the free part, same rotation."""
        free, blocked = 0.0, 1.0
        for _ in range(BISECTIONS):
            part = 0.5 * (free + blocked)
            tried = Pose2(part * increment.x, part * increment.y, increment.theta)
            if self.obstacle_between(pose, pose.compose(tried), others):
                blocked = part
            else:
                free = part
        return Pose2(free * increment.x, free * increment.y, increment.theta)

    def clearance(self, pose: Pose2, others: Poses) -> float:
        """Return the clearance (m) between a vehicle's body and the nearest obstacle."""
        gaps = [_distance(pose, other) - self._radius for other in others.values()]
        return min([self._obstacles.clearance(pose.x, pose.y), *gaps]) - self._radius


def _distance(a: Pose2, b: Pose2) -> float:
    return math.hypot(a.x - b.x, a.y - b.y)
