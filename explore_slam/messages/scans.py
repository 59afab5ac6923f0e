"""Laser scans."""

from typing import Any

import numpy as np

from explore_slam.data import LaserScan
from explore_slam.messages.base import MessageFactory, header, seconds
from explore_slam.messages.measurement import MeasurementKind, MessageReader
from explore_slam.messages.sensor_mounts import SensorMounts
from explore_slam.messages.topics import TopicKind


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


def scan_reader(mounts: SensorMounts | None) -> MessageReader:
    """Return the reader of a vehicle's scans, which get the mount of their laser."""
    if mounts is None:
        return MessageReader(scan_record)
    return MessageReader(
        lambda message: mounts.place_scan(scan_record(message), message.header.frame_id)
    )


SCAN = MeasurementKind(
    name='scan',
    topics=(TopicKind.SCAN,),
    reader=scan_reader,
    write=lambda factory, frames, scan: [
        (TopicKind.SCAN, scan_message(factory, scan, frames.laser))
    ],
    queue_limit=400,
    expected=(TopicKind.SCAN,),
    laser=True,
    clock='scan_time_offset',
)
