"""What a vehicle is at, and the plan that its right of way allows."""

import math
from dataclasses import dataclass

import numpy as np

from explore_slam.data import Plan
from explore_slam.exploration.records import Point
from explore_slam.exploration.scene import Scene
from explore_slam.exploration.traffic import Grant, Right, Traveler
from explore_slam.geometry import Array, Pose2
from explore_slam.polyline import truncated

SAME_PLACE = 0.5  # m: targets this near to each other are the same
WORTH = 0.3  # m: shorter paths up to a stop are not worth driving


@dataclass
class Task:
    """What one vehicle is at: target, the path to it, what was sent of it, and how it gets on."""

    target: Point
    path: Array
    look_at: Point | None
    sent: Plan | None = None
    right: Right = Right.GO
    nearest: float = math.inf
    since: float = 0.0
    arrivals: int = 0
    changes: int = 0


def plan_by(
    scene: Scene, task: Task | None, grant: Grant, traveler: Traveler, retreat: Plan | None
) -> Plan | None:
    """Return the plan that a grant allows: the one in force if it still says the same.

    retreat: the plan by which the vehicle got out of the way in the cycle before, if it did.
    """
    name = traveler.name
    if grant.right is Right.RETREAT and grant.retreat is not None:
        if task is not None:
            task.right, task.sent = Right.RETREAT, None
        end = grant.retreat[-1]
        if retreat is not None and math.dist(retreat.waypoints[-1], end) <= SAME_PLACE:
            return retreat
        return make_plan(scene, name, grant.retreat, None)
    if task is None:
        return None
    if grant.right is Right.GO:
        if task.right is not Right.GO or task.sent is None:
            task.right = Right.GO
            task.sent = make_plan(scene, name, traveler.points, task.look_at)
        return task.sent
    part = truncated(traveler.points, grant.limit)
    length = float(np.hypot(*np.diff(part, axis=0).T).sum()) if len(part) > 1 else 0.0
    if length < WORTH:
        task.right, task.sent = Right.STOP, None
        return None
    same = (
        task.right is Right.STOP
        and task.sent is not None
        and math.dist(task.sent.waypoints[-1], part[-1]) <= SAME_PLACE
    )
    if not same:
        task.sent = make_plan(scene, name, part, None)
    task.right = Right.STOP
    return task.sent


def make_plan(scene: Scene, name: str, points: Array, look_at: Point | None) -> Plan:
    """Make a plan of a path (W, 2) m whose goal looks at a point, or along the path."""
    end = points[-1]
    pose = scene.vehicles[name].pose
    heading = pose.theta
    if look_at is not None and math.dist(look_at, end) > 1e-6:
        heading = math.atan2(look_at[1] - end[1], look_at[0] - end[0])
    elif len(points) > 1 and math.dist(points[-2], end) > 1e-6:
        heading = math.atan2(end[1] - points[-2][1], end[0] - points[-2][0])
    goal = Pose2(float(end[0]), float(end[1]), heading)
    return Plan(scene.now, name, goal, np.ascontiguousarray(points))
