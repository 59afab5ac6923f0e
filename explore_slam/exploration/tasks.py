"""The task of a vehicle, and the plan that its right of way allows."""

import math
from dataclasses import dataclass, field

import numpy as np

from explore_slam.data import Plan
from explore_slam.exploration.progress import Progress
from explore_slam.exploration.records import Point
from explore_slam.exploration.scene import Scene
from explore_slam.exploration.traffic import SHORTEST_DRIVE, Grant, RightOfWay, Traveler
from explore_slam.geometry import Array, Pose2
from explore_slam.polyline import arc_lengths, truncated

# Chosen by hand; test_tasks shows what they decide.
SAME_TARGET = 0.5  # m; targets this near to each other are the same


@dataclass
class Task:
    """What a vehicle does.

    target, look_at: where it drives, and what it should face there (m).
    path: (W, 2) m to the target.
    sent: the plan in force, which may lead along a part of the path only.
    right: its right of way when the plan was made.
    switches: how often the vehicle has switched targets since it last reached one.
    patient: the vehicle is to wait at the target, which cannot fail.
    """

    target: Point
    path: Array
    look_at: Point | None
    progress: Progress
    sent: Plan | None = None
    right: RightOfWay = RightOfWay.GO
    switches: int = 0
    patient: bool = False

    def leads_to(self, target: Point) -> bool:
        """Return whether a target (m) is that of the task."""
        return math.dist(self.target, target) <= SAME_TARGET

    def along(self, path: Array, target: Point, look_at: Point | None) -> 'Task':
        """Return the task of reaching practically the same target along another path."""
        sent = None if self.right is RightOfWay.GO else self.sent
        progress = self.progress.restart()
        right, switches = self.right, self.switches
        return Task(target, path, look_at, progress, sent, right, switches, self.patient)


@dataclass
class Orders:
    """What the vehicles are to do in one planning cycle, by name.

    tasks: of those that drive. waiting: why others do not. refused: those whose goal cannot be
    reached.
    """

    tasks: dict[str, Task] = field(default_factory=dict)
    waiting: dict[str, str] = field(default_factory=dict)
    refused: list[str] = field(default_factory=list)


def plan_for(
    scene: Scene, task: Task | None, grant: Grant, traveler: Traveler, retreat: Plan | None
) -> Plan | None:
    """Return the plan that a grant allows: the one in force, if it still applies.

    retreat: the plan by which the vehicle retreated in the last cycle, if it did.
    """
    name = traveler.name
    if grant.right is RightOfWay.RETREAT and grant.retreat is not None:
        if task is not None:
            task.right, task.sent = RightOfWay.RETREAT, None
        end = grant.retreat[-1]
        if retreat is not None and math.dist(retreat.waypoints[-1], end) <= SAME_TARGET:
            return retreat
        return make_plan(scene, name, grant.retreat, None)
    if task is None:
        return None
    if grant.right is RightOfWay.GO:
        if task.right is not RightOfWay.GO or task.sent is None:
            task.right = RightOfWay.GO
            task.sent = make_plan(scene, name, traveler.points, task.look_at)
        return task.sent
    part = truncated(traveler.points, grant.limit)
    if arc_lengths(part)[-1] < SHORTEST_DRIVE:
        task.right, task.sent = RightOfWay.STOP, None
        return None
    unchanged = (
        task.right is RightOfWay.STOP
        and task.sent is not None
        and math.dist(task.sent.waypoints[-1], part[-1]) <= SAME_TARGET
    )
    if not unchanged:
        task.sent = make_plan(scene, name, part, None)
    task.right = RightOfWay.STOP
    return task.sent


def make_plan(scene: Scene, name: str, points: Array, look_at: Point | None) -> Plan:
    """Return a plan along a path (W, 2) m whose goal faces a point (m), or along the path."""
    end = points[-1]
    heading = scene.vehicles[name].pose.theta
    if look_at is not None and math.dist(look_at, end) > 1e-6:
        heading = math.atan2(look_at[1] - end[1], look_at[0] - end[0])
    elif len(points) > 1 and math.dist(points[-2], end) > 1e-6:
        heading = math.atan2(end[1] - points[-2][1], end[0] - points[-2][0])
    goal = Pose2(float(end[0]), float(end[1]), heading)
    return Plan(scene.now, name, goal, np.ascontiguousarray(points))
