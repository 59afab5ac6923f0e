"""Records of a simulator beyond those of real vehicles: true poses, events, collisions."""

from typing import NamedTuple

from explore_slam.data import LaserScan, OdometryReading, RgbdFrame
from explore_slam.geometry import Pose2


class TruePose(NamedTuple):
    """True state of a vehicle: pose in the world, speed (m/s) and turn rate (rad/s)."""

    stamp: float
    pose: Pose2
    linear: float
    angular: float


WALL = 'wall'
HAZARD = 'hazard'  # a board that hangs lower than a vehicle is high, or a step down
Record = OdometryReading | LaserScan | RgbdFrame | TruePose


class SimEvent(NamedTuple):
    """A record of a vehicle; stamp: simulated time (s)."""

    stamp: float
    vehicle: str
    record: Record


class Collision(NamedTuple):
    """First contact of a vehicle: obstacle is WALL (any solid), HAZARD or another vehicle."""

    stamp: float
    vehicle: str
    obstacle: str
