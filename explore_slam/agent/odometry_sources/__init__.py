"""What the odometry of a vehicle is measured by; another source is a module and a line here."""

from collections.abc import Callable, Mapping

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

_MAKERS: Mapping[str, Callable[[str, OdometryNoise], OdometrySource]] = {
    WheelSource.name: lambda _vehicle, _noise: WheelSource(),
    ScanSource.name: lambda vehicle, _noise: ScanSource(vehicle),
    GyroSource.name: GyroSource,
}
SOURCES = tuple(_MAKERS)


def make_source(kind: str, vehicle: str, noise: OdometryNoise) -> OdometrySource:
    """Return the source of a vehicle's odometry; noise: of its wheels. AgentError if unknown."""
    if kind not in _MAKERS:
        raise AgentError(f'odometry of {vehicle} is {kind!r}, expected one of {SOURCES}')
    return _MAKERS[kind](vehicle, noise)
