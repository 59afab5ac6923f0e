"""Laser scans."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from explore_slam.data import LaserScan
from explore_slam.messages.base import MessageFactory, header, seconds
from explore_slam.messages.measurement import MeasurementKind
from explore_slam.messages.sensor_mounts import SensorMounts
from explore_slam.messages.topics import TopicKind
from explore_slam.messages.transforms import TransformTree


def scan_record(message: Any) -> LaserScan:
    """Return a sensor_msgs/LaserScan as a record."""
    return LaserScan(
        seconds(message.header.stamp),
        float(message.angle_min),
        float(message.angle_increment),
        np.array(message.ranges, dtype=np.float32),
        float(message.range_min),
        float(message.range_max),
        time_increment=float(message.time_increment),
        scan_time=float(message.scan_time),
    )


def scan_message(factory: MessageFactory, scan: LaserScan, frame: str) -> Any:
    """Return a sensor_msgs/LaserScan (REP-117 values are kept as they are)."""
    count = scan.ranges.size
    return factory.make(
        'sensor_msgs/LaserScan',
        header=header(factory, scan.stamp, frame),
        angle_min=float(scan.angle_min),
        angle_max=float(scan.angle_min + scan.angle_increment * (count - 1)),
        angle_increment=float(scan.angle_increment),
        time_increment=float(scan.time_increment),
        scan_time=float(scan.scan_time),
        range_min=float(scan.range_min),
        range_max=float(scan.range_max),
        ranges=factory.sequence(scan.ranges.astype(np.float32, copy=False)),
        intensities=factory.sequence(np.empty(0, np.float32)),
    )


class ScanReader:
    """Converts the scans of one laser, or the clouds of one 3-D lidar, which get its mount.

    sensor: which of the vehicle's lasers it is; '' is the only one.
    """

    def __init__(self, mounts: SensorMounts | None, sensor: str = '') -> None:
        self._mounts, self._sensor = mounts, sensor

    def read(self, topic: TopicKind, message: Any) -> LaserScan:
        """Return the scan; DataError if the message is malformed."""
        if topic is TopicKind.CLOUD:
            mounts = self._mounts or SensorMounts('', TransformTree())
            return mounts.place_cloud(message, self._sensor)
        scan = scan_record(message)
        if self._mounts is None:
            return scan
        return self._mounts.place_scan(scan, message.header.frame_id, self._sensor)

    def losses(self) -> Mapping[str, int]:
        """Return nothing: no message waits for another."""
        return {}

    def explanations(self) -> Mapping[str, str]:
        """Return nothing: there are no losses."""
        return {}


SCAN = MeasurementKind(
    name='scan',
    topics=(TopicKind.SCAN, TopicKind.CLOUD),
    reader=ScanReader,
    write=lambda factory, frames, scan: [
        (TopicKind.SCAN, scan_message(factory, scan, frames.laser_frame(scan.sensor)))
    ],
    queue_limit=400,
    expected=(TopicKind.SCAN,),
    laser=True,
    clock='scan_time_offset',
)
