"""One thing that a recording holds: a record of a vehicle, and the messages that carry it."""

from typing import Any, NamedTuple

import numpy as np

from explore_slam import messages
from explore_slam.data import (
    InterRobotObservation,
    LandmarkObservations,
    LaserScan,
    OdometryReading,
    RgbdFrame,
)
from explore_slam.geometry import Array, Pose2
from explore_slam.messages.topics import MESSAGE_TYPES, TopicKind, topic_name
from explore_slam.recording.bag import BagWriter
from explore_slam.recording.messages import MESSAGES


class TruePose3(NamedTuple):
    """A true pose in space: position (m) and quaternion (x, y, z, w) of the vehicle in the map."""

    position: tuple[float, float, float]
    quaternion: tuple[float, float, float, float]


Record = (
    OdometryReading
    | LaserScan
    | RgbdFrame
    | LandmarkObservations
    | InterRobotObservation
    | TruePose3
)


class Event(NamedTuple):
    """A record of a vehicle at a stamp (s); the kind tells odometry from truth and start pose.

    Odometry, ground truth and initial pose are OdometryReading; a frame has the kind COLOR.
    TruePose3 is written only; read again it is a ground truth in the plane.
    """

    stamp: float
    vehicle: str
    kind: TopicKind
    record: Record


def odometry_event(vehicle: str, stamp: float, pose: Pose2) -> Event:
    """Make an odometry event without covariance: the filter's own motion noise applies."""
    return Event(stamp, vehicle, TopicKind.ODOMETRY, OdometryReading(stamp, pose))


def truth_event(vehicle: str, stamp: float, pose: Pose2) -> Event:
    """Make a ground truth event, the pose in the map frame."""
    return Event(stamp, vehicle, TopicKind.GROUND_TRUTH, OdometryReading(stamp, pose))


def start_event(vehicle: str, stamp: float, pose: Pose2) -> Event:
    """Make the event that tells where in the map a vehicle starts."""
    return Event(stamp, vehicle, TopicKind.INITIAL_POSE, OdometryReading(stamp, pose))


def write_event(writer: BagWriter, event: Event) -> None:
    """Write an event on the topics of its vehicle, logged at its stamp."""
    for kind, message in _messages(event):
        writer.write_message(
            topic_name(event.vehicle, kind), MESSAGE_TYPES[kind], event.stamp, message
        )


def _messages(event: Event) -> list[tuple[TopicKind, Any]]:
    vehicle, record = event.vehicle, event.record
    base = f'{vehicle}/base_link'
    if isinstance(record, OdometryReading):
        if event.kind is TopicKind.INITIAL_POSE:
            message = messages.estimate_message(
                MESSAGES, record.stamp, 'map', record.pose, _known(record.covariance)
            )
        else:
            truth = event.kind is TopicKind.GROUND_TRUTH
            frame = 'map' if truth else f'{vehicle}/odom'
            message = messages.odometry_message(MESSAGES, record, frame, base)
        return [(event.kind, message)]
    if isinstance(record, LaserScan):
        return [(event.kind, messages.scan_message(MESSAGES, record, f'{vehicle}/laser'))]
    if isinstance(record, LandmarkObservations):
        return [(event.kind, messages.landmarks_message(MESSAGES, record, base))]
    if isinstance(record, InterRobotObservation):
        return [(event.kind, messages.sighting_message(MESSAGES, record))]
    if isinstance(record, TruePose3):
        return [(event.kind, _true_message(event.stamp, record, base))]
    return _frame_messages(record, f'{vehicle}/camera_optical_frame')


def _true_message(stamp: float, record: TruePose3, base: str) -> Any:
    message = messages.odometry_message(
        MESSAGES, OdometryReading(stamp, Pose2(0.0, 0.0, 0.0)), 'map', base
    )
    pose, (x, y, z) = message.pose.pose, record.position
    pose.position = MESSAGES.make('geometry_msgs/Point', x=x, y=y, z=z)
    x, y, z, w = record.quaternion
    pose.orientation = MESSAGES.make('geometry_msgs/Quaternion', x=x, y=y, z=z, w=w)
    return message


def _known(covariance: Array | None) -> Array:
    return np.zeros((3, 3)) if covariance is None else covariance


def _frame_messages(record: RgbdFrame, frame: str) -> list[tuple[TopicKind, Any]]:
    color = 'mono8' if record.rgb.ndim == 2 else 'rgb8'
    depth = '16UC1' if record.depth.dtype.kind == 'u' else '32FC1'
    stamp = record.stamp
    return [
        (
            TopicKind.CAMERA_INFO,
            messages.camera_info_message(MESSAGES, stamp, frame, record.intrinsics),
        ),
        (
            TopicKind.COLOR,
            messages.image_message(MESSAGES, stamp, frame, color, record.rgb),
        ),
        (
            TopicKind.DEPTH,
            messages.image_message(MESSAGES, stamp, frame, depth, record.depth),
        ),
    ]
