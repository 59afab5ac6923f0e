"""Where the vehicles are, where they have been, and their homes."""

import math
from collections.abc import Mapping

from explore_slam.exploration.records import Point, VehicleSnapshot
from explore_slam.geometry import Pose2

# Chosen by hand; test_vehicle_history shows what they decide.
_TRAIL_LENGTH = 300  # positions per vehicle
_TRAIL_SPACING = 0.05  # m between the positions of a trail
_POSE_JUMP = 3.0  # m between planning cycles; the pose was corrected and the trail is void


class VehicleHistory:
    """Newest pose, home and trail of every vehicle.

    homes: as given by the snapshots, or else the first pose.
    trails: recent positions (m), oldest first.
    """

    def __init__(self) -> None:
        self.poses: dict[str, Pose2] = {}
        self.homes: dict[str, Pose2] = {}
        self.trails: dict[str, list[Point]] = {}

    def update(self, vehicles: Mapping[str, VehicleSnapshot]) -> None:
        """Record the poses of all vehicles; those that are not finite are skipped."""
        for name, snapshot in vehicles.items():
            pose = snapshot.pose
            if not pose.is_finite():
                continue
            self.homes.setdefault(name, snapshot.home or pose)
            self.poses[name] = pose
            trail = self.trails.setdefault(name, [])
            if trail and math.dist(trail[-1], pose[:2]) > _POSE_JUMP:
                trail.clear()
            if not trail or math.dist(trail[-1], pose[:2]) > _TRAIL_SPACING:
                trail.append((pose.x, pose.y))
            del trail[:-_TRAIL_LENGTH]

    def position(self, vehicle: str) -> Point:
        """Return the newest position (m) of a vehicle."""
        pose = self.poses[vehicle]
        return pose.x, pose.y
