"""What a simulator gives out beside the records that real vehicles give too."""

from typing import NamedTuple

from explore_slam.data import LaserScan, OdometryReading, RgbdFrame
from explore_slam.geometry import Pose2


class TruePose(NamedTuple):
    """Where a vehicle really is: pose in the world, speed (m/s) and turn rate (rad/s)."""

    stamp: float
    pose: Pose2
    linear: float
    angular: float


Record = OdometryReading | LaserScan | RgbdFrame | TruePose


class SimEvent(NamedTuple):
    """One record of one vehicle; the stamp is simulated time (s)."""

    stamp: float
    vehicle: str
    record: Record


class Collision(NamedTuple):
    """A vehicle drove against something: a wall or the vehicle named."""

    stamp: float
    vehicle: str
    obstacle: str
