"""Inter-robot observations: one vehicle measures the position of another."""

from typing import Any

import numpy as np

from explore_slam.data import InterRobotObservation
from explore_slam.geometry import Pose2
from explore_slam.messages.base import MessageFactory, seconds
from explore_slam.messages.measurement import MeasurementKind, MessageReader
from explore_slam.messages.motion import estimate_message
from explore_slam.messages.topics import TopicKind


def inter_robot_record(message: Any) -> InterRobotObservation:
    """Return a PoseWithCovarianceStamped as an inter-robot observation.

    Its frame_id names the observed vehicle, '<observed>/base_link'; its pose is that of the
    observed vehicle in the base frame of the observer, which the topic's namespace names.
    """
    position = message.pose.pose.position
    covariance = np.asarray(message.pose.covariance, dtype=np.float64).reshape(6, 6)[:2, :2]
    return InterRobotObservation(
        seconds(message.header.stamp),
        message.header.frame_id.split('/')[0],
        np.array([position.x, position.y], dtype=np.float64),
        covariance.copy(),
    )


def inter_robot_message(factory: MessageFactory, observation: InterRobotObservation) -> Any:
    """Return an inter-robot observation as a PoseWithCovarianceStamped; see inter_robot_record."""
    covariance = np.zeros((3, 3))
    covariance[:2, :2] = observation.covariance
    pose = Pose2(float(observation.position[0]), float(observation.position[1]), 0.0)
    frame = f'{observation.vehicle}/base_link'
    return estimate_message(factory, observation.stamp, frame, pose, covariance)


INTER_ROBOT = MeasurementKind(
    name='inter_robot',
    topics=(TopicKind.INTER_ROBOT,),
    reader=lambda _mounts, _sensor: MessageReader(inter_robot_record),
    write=lambda factory, _frames, observation: [
        (TopicKind.INTER_ROBOT, inter_robot_message(factory, observation))
    ],
    queue_limit=100,
)
