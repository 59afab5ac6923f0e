"""Events of a recording: a record of a vehicle at a time, and how it is written."""

from typing import Any, NamedTuple

import numpy as np

from explore_slam.data import LaserScan, OdometryReading, RgbdFrame
from explore_slam.errors import RecordingError
from explore_slam.geometry import Pose2, Quaternion
from explore_slam.messages.base import quaternion_message
from explore_slam.messages.frames import FrameNames
from explore_slam.messages.measurement import Record, TopicMessages
from explore_slam.messages.measurement_kinds import KIND_OF_TOPIC
from explore_slam.messages.motion import estimate_message
from explore_slam.messages.odometry import odometry_message
from explore_slam.messages.topics import TopicKind, topic_name
from explore_slam.recording.bag import BagWriter
from explore_slam.recording.rosbags_types import MESSAGES


class TruePose3(NamedTuple):
    """A true pose in space: position (m) and orientation of the vehicle in the map frame."""

    position: tuple[float, float, float]
    quaternion: Quaternion


class Event(NamedTuple):
    """A record of a vehicle at a stamp (s).

    kind: the first topic of the measurement's kind (COLOR for an RGB-D frame), GROUND_TRUTH or
    INITIAL_POSE.
    record: of ground truth and initial pose an OdometryReading in the map frame. A TruePose3 can
    only be written; read again it is a ground truth in the plane.
    """

    stamp: float
    vehicle: str
    kind: TopicKind
    record: Record | TruePose3


def odometry_event(vehicle: str, stamp: float, pose: Pose2) -> Event:
    """Return an odometry event without covariance, so that the filter's motion noise applies."""
    return Event(stamp, vehicle, TopicKind.ODOMETRY, OdometryReading(stamp, pose))


def truth_event(vehicle: str, stamp: float, pose: Pose2) -> Event:
    """Return a ground-truth event; the pose is in the map frame."""
    return Event(stamp, vehicle, TopicKind.GROUND_TRUTH, OdometryReading(stamp, pose))


def start_event(vehicle: str, stamp: float, pose: Pose2) -> Event:
    """Return the event of a vehicle's start pose in the map frame."""
    return Event(stamp, vehicle, TopicKind.INITIAL_POSE, OdometryReading(stamp, pose))


def write_event(writer: BagWriter, event: Event) -> None:
    """Write an event on the topics of its vehicle, logged at its stamp."""
    record = event.record
    sensor = record.sensor if isinstance(record, LaserScan | RgbdFrame) else ''
    for kind, message in _messages(event):
        writer.write_message(
            topic_name(event.vehicle, kind, sensor), kind.message_type, event.stamp, message
        )


def _messages(event: Event) -> TopicMessages:
    frames = FrameNames(event.vehicle)
    if event.kind is TopicKind.GROUND_TRUTH:
        return [(event.kind, _truth_message(event, frames))]
    if event.kind is TopicKind.INITIAL_POSE and isinstance(event.record, OdometryReading):
        pose, covariance = event.record.pose, event.record.covariance
        known = np.zeros((3, 3)) if covariance is None else covariance
        return [(event.kind, estimate_message(MESSAGES, event.stamp, frames.map, pose, known))]
    if event.kind not in KIND_OF_TOPIC:
        raise RecordingError(f'{event.kind.name} cannot hold a {type(event.record).__name__}')
    return KIND_OF_TOPIC[event.kind].write(MESSAGES, frames, event.record)


def _truth_message(event: Event, frames: FrameNames) -> Any:
    record = event.record
    if isinstance(record, OdometryReading):
        return odometry_message(MESSAGES, record, frames.map, frames.base)
    if not isinstance(record, TruePose3):
        raise RecordingError(f'GROUND_TRUTH cannot hold a {type(record).__name__}')
    origin = OdometryReading(event.stamp, Pose2(0.0, 0.0, 0.0))
    message = odometry_message(MESSAGES, origin, frames.map, frames.base)
    x, y, z = record.position
    message.pose.pose.position = MESSAGES.make('geometry_msgs/Point', x=x, y=y, z=z)
    message.pose.pose.orientation = quaternion_message(MESSAGES, record.quaternion)
    return message
