"""What a vehicle runs into: walls, furniture and other vehicles, all seen from above."""

import math
from collections.abc import Mapping

from explore_slam.errors import SimulationError
from explore_slam.geometry import Pose2
from explore_slam.simulation.worlds.obstacles import Obstacles
from explore_slam.simulation.worlds.world import World

BISECTIONS = 6  # the way up to a contact is found to 1/64 of a step
WALL = 'wall'
Poses = Mapping[str, Pose2]


class Contacts:
    """Contacts of vehicles, which are circles of one radius (m), in a world."""

    def __init__(self, world: World, radius: float) -> None:
        self._world = world
        self._obstacles = Obstacles(world)
        self._radius = radius

    def check_poses(self, starts: Poses) -> None:
        """Raise SimulationError for a pose outside of the world, in a wall or a vehicle."""
        radius = self._radius
        x0, y0, x1, y1 = self._world.bounds
        for index, (name, pose) in enumerate(starts.items()):
            where = f'pose of {name!r} ({pose.x:g}, {pose.y:g}, {pose.theta:g})'
            if not pose.is_finite() or not (x0 <= pose.x <= x1 and y0 <= pose.y <= y1):
                raise SimulationError(
                    f'{where} lies outside of world {self._world.name!r}, '
                    f'expected x in {x0:g}..{x1:g} and y in {y0:g}..{y1:g} m'
                )
            room = self._obstacles.clearance(pose.x, pose.y)
            if room < radius:
                place = 'inside a wall' if room <= 0.0 else f'{room:.2f} m from a wall'
                raise SimulationError(f'{where} lies {place}, expected at least {radius:g} m')
            for other, there in list(starts.items())[:index]:
                gap = _distance(pose, there)
                if gap < 2.0 * radius:
                    raise SimulationError(
                        f'{where} lies {gap:.2f} m from that of {other!r}, '
                        f'expected at least {2.0 * radius:g} m'
                    )

    def in_the_way(self, pose: Pose2, wanted: Pose2, others: Poses) -> str:
        """Return what stands between two poses, 'wall' or a vehicle, or an empty text.

        What is already touched is in the way only of what comes nearer to it.
        """
        room = self._obstacles.clearance(wanted.x, wanted.y)
        if room < self._radius and room < self._obstacles.clearance(pose.x, pose.y):
            return WALL
        for name, other in others.items():
            gap = _distance(wanted, other)
            if gap < 2.0 * self._radius and gap < _distance(pose, other):
                return name
        return ''

    def up_to_contact(self, pose: Pose2, increment: Pose2, others: Poses) -> Pose2:
        """Return the increment with as much of its way as is free; turning always is."""
        free, blocked = 0.0, 1.0
        for _ in range(BISECTIONS):
            part = 0.5 * (free + blocked)
            tried = Pose2(part * increment.x, part * increment.y, increment.theta)
            if self.in_the_way(pose, pose.compose(tried), others):
                blocked = part
            else:
                free = part
        return Pose2(free * increment.x, free * increment.y, increment.theta)

    def room(self, pose: Pose2, others: Poses) -> float:
        """Return the free distance (m) between the body of a vehicle and the nearest thing."""
        gaps = [_distance(pose, other) - self._radius for other in others.values()]
        return min([self._obstacles.clearance(pose.x, pose.y), *gaps]) - self._radius


def _distance(a: Pose2, b: Pose2) -> float:
    return math.hypot(a.x - b.x, a.y - b.y)
