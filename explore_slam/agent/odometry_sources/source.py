"""What a source of odometry provides: readings of the trajectory, and priors of matching."""

from abc import ABC, abstractmethod
from typing import NamedTuple

from explore_slam.agent.odometry import OdometryBuffer, Step
from explore_slam.data import ImuReading, LaserScan, OdometryReading
from explore_slam.geometry import Array, Pose2
from explore_slam.registration import ScanMatch, ScanMatcher
from explore_slam.slam import FastSlamConfig
from explore_slam.sweeps import Sweep


class Motion(NamedTuple):
    """A reading for the trajectory of a vehicle.

    step: the motion since the reading before, where it is not the one between the two readings.
    """

    reading: OdometryReading
    step: Step | None = None


class NewScan(NamedTuple):
    """A scan that has just arrived.

    sweep: when its beams were measured; None: at one moment, or unknown. end: time (s) up to which
    its motion must be known. laser: its pose in the vehicle frame.
    """

    scan: LaserScan
    sweep: Sweep | None
    end: float
    laser: Pose2


class MotionPrior(NamedTuple):
    """Where a vehicle is at a stamp by its odometry alone, before the scan there is matched.

    pose: in the frame of the trajectory. covariance (3, 3): of the motion since the last match, in
    the vehicle frame at the pose. still: the vehicle has not moved since then.
    """

    pose: Pose2
    covariance: Array
    still: bool = False


class OdometrySource(ABC):
    """Source of one vehicle's odometry.

    name: as in the settings. uses_imu: whether it takes readings of an IMU. needs_scans: whether
    the motion is unknown without scans.
    weak: its priors are so weak that noise of a scan may outweigh them (ScanMatcher.open_ended).
    """

    name = ''
    uses_imu = False
    needs_scans = False
    weak = False

    @abstractmethod
    def add_odometry(self, reading: OdometryReading) -> list[Motion]:
        """Take a reading of the wheels; return what the trajectory is to be extended by."""

    def add_imu(self, _reading: ImuReading) -> list[Motion]:
        """Take a reading of the IMU; return what the trajectory is to be extended by."""
        return []

    def cover(
        self, _new: NewScan, _trajectory: OdometryBuffer, _matcher: ScanMatcher
    ) -> list[Motion]:
        """Return what extends the trajectory to the end (s) of the sweep of a new scan."""
        return []

    def reckoned(self, reading: OdometryReading) -> OdometryReading:
        """Return a reading of the trajectory as dead reckoning has it, free of corrections."""
        return reading

    @abstractmethod
    def prior(
        self, trajectory: OdometryBuffer, since: float, stamp: float, slam: FastSlamConfig
    ) -> MotionPrior:
        """Return the prior for matching a scan at a stamp (s); since: stamp of the last match."""

    def take_match(
        self, _trajectory: OdometryBuffer, _since: float, _stamp: float,
        prior: MotionPrior, match: ScanMatch, restarted: bool,
    ) -> Array:  # fmt: skip
        """Take a match; return by which covariance (3, 3) the error has grown since the last one.

        trajectory: as it was before the match. restarted: the map of scans began anew in between,
        so that only the prior connects the two matches.
        """
        return match.drift + prior.covariance if restarted else match.drift

    def restart_clock(self) -> None:  # noqa: B027
        """Forget all stamps: the clock has jumped back."""

    def keep_knowledge(self, _other: 'OdometrySource') -> None:  # noqa: B027
        """Take over what a source of the same vehicle has learnt of its sensors."""

    def base_pose(self, trajectory: OdometryBuffer) -> Pose2:
        """Return the newest pose in the odometry frame of the vehicle."""
        return trajectory.reading

    def report(self) -> dict[str, float | str]:
        """Return what has been learnt of the sensors, by name."""
        return {}
