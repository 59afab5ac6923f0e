"""What the odometry of a vehicle is measured by; another source is a module and a line here."""

from explore_slam.agent.odometry_sources.gyro import GyroSource
from explore_slam.agent.odometry_sources.scans import ScanSource
from explore_slam.agent.odometry_sources.slip import SlipMonitor
from explore_slam.agent.odometry_sources.source import (
    Motion,
    MotionPrior,
    NewScan,
    OdometrySource,
)
from explore_slam.agent.odometry_sources.wheels import WheelSource
from explore_slam.errors import AgentError
from explore_slam.slam import OdometryNoise

__all__ = [
    'SOURCES',
    'Motion',
    'MotionPrior',
    'NewScan',
    'OdometrySource',
    'SlipMonitor',
    'WheelSource',
    'make_source',
]

SOURCES = ('wheels', 'scan', 'wheels+gyro')


def make_source(kind: str, vehicle: str, noise: OdometryNoise) -> OdometrySource:
    """Return the source of a vehicle's odometry; noise: of its wheels. AgentError if unknown."""
    if kind == 'wheels':
        return WheelSource()
    if kind == 'wheels+gyro':
        return GyroSource(vehicle, noise)
    if kind == 'scan':
        return ScanSource(vehicle)
    raise AgentError(f'odometry of {vehicle} is {kind!r}, expected one of {SOURCES}')
