"""Measurement kinds: written as messages and read again, records are the same."""

import dataclasses

import numpy as np
import pytest

from explore_slam.agent import Agent, AgentConfig
from explore_slam.data import (
    ImuReading,
    InterRobotObservation,
    Intrinsics,
    LandmarkObservations,
    LaserScan,
    ObstacleView,
    OdometryReading,
    RgbdFrame,
    TagObservations,
)
from explore_slam.errors import DataError
from explore_slam.geometry import Pose2
from explore_slam.messages.frames import FrameNames
from explore_slam.messages.measurement import VehicleReader
from explore_slam.messages.measurement_kinds import KIND_OF_TOPIC, MEASUREMENT_KINDS
from explore_slam.messages.topics import TopicKind
from explore_slam.messages.vehicle_settings import VehicleConfig
from explore_slam.nodes.ros_types import MESSAGES as ROS_MESSAGES
from explore_slam.nodes.ros_types import message_class
from explore_slam.recording.rosbags_types import MESSAGES as BAG_MESSAGES

RECORDS = {
    'odometry': OdometryReading(2.5, Pose2(1.0, -2.0, 0.0), np.diag([0.1, 0.2, 0.3])),
    'imu': ImuReading(2.5, (0.1, -0.2, 0.3)),
    'scan': LaserScan(2.5, -1.5, 0.75, np.array([1.0, np.inf, np.nan], np.float32), 0.25, 8.0),
    'frame': RgbdFrame(
        2.5,
        np.full((6, 8, 3), (10, 120, 240), np.uint8),
        np.full((6, 8), 1500, np.uint16),
        Intrinsics(8, 6, 10.0, 10.0, 4.0, 3.0),
    ),
    'landmarks': LandmarkObservations(
        2.5, np.full((1, 3), 0.5), np.eye(3)[None], np.eye(1, 128, dtype=np.float32)
    ),
    'tags': TagObservations(
        2.5,
        np.array([3, 2319]),
        np.array([[1.0, 0.5, 3.0]] * 2),
        np.tile(np.eye(3) / 4, (2, 1, 1)),
    ),
    'obstacles': ObstacleView(
        2.5,
        np.array([[20, -3], [21, 5], [-30, 0]], np.int16),
        np.array([1 << 6, 0, 1 << 15], np.uint16),
        np.array([3, 1 << 15 | 1, 0], np.uint16),
    ),
    'inter_robot': InterRobotObservation(
        2.5, 'robot2', np.array([1.0, 0.5]), np.diag([0.25, 0.5])
    ),
}


@pytest.mark.parametrize('factory', [ROS_MESSAGES, BAG_MESSAGES], ids=['rclpy', 'rosbags'])
@pytest.mark.parametrize('kind', MEASUREMENT_KINDS, ids=lambda kind: kind.name)
def test_written_and_read_again_a_record_is_the_same(kind, factory):
    record, reader = RECORDS[kind.name], VehicleReader(MEASUREMENT_KINDS)
    written = kind.write(factory, FrameNames('robot1'), record)
    found = [reader.read(topic, message) for topic, message in written]
    assert found[:-1] == [None] * (len(written) - 1)
    assert found[-1][0] is kind
    for item in dataclasses.fields(record):
        np.testing.assert_array_equal(getattr(found[-1][1], item.name), getattr(record, item.name))


def test_the_agent_takes_records_of_every_kind():
    agent = Agent(AgentConfig(), {'robot1': Pose2(0, 0, 0), 'robot2': Pose2(1, 0, 0)})
    for kind in MEASUREMENT_KINDS:
        agent.add('robot1', RECORDS[kind.name])


def test_every_topic_of_a_measurement_belongs_to_one_kind():
    assert sum(len(kind.topics) for kind in MEASUREMENT_KINDS) == len(KIND_OF_TOPIC)
    assert set(TopicKind) - set(KIND_OF_TOPIC) == {TopicKind.GROUND_TRUTH, TopicKind.INITIAL_POSE}
    for kind in MEASUREMENT_KINDS:
        assert set(kind.expected) <= set(kind.topics)
        assert kind.queue_limit > 0


def test_frames_and_landmarks_are_expected_where_vision_runs():
    expected = {
        vision: {
            kind.name
            for kind in MEASUREMENT_KINDS
            if kind.is_expected(VehicleConfig(vision=vision))
        }
        for vision in ('agent', 'vehicle', 'none')
    }
    assert expected['agent'] - expected['vehicle'] == {'frame'}
    assert expected['vehicle'] - expected['agent'] == {'landmarks', 'obstacles'}
    assert expected['none'] == expected['agent'] & expected['vehicle']


def test_a_vehicle_without_laser_and_camera_needs_odometry_alone():
    bare = VehicleConfig(vision='none', use_laser=False)
    kinds = [kind for kind in MEASUREMENT_KINDS if kind.is_expected(bare) and kind.expected]
    assert [kind.name for kind in kinds] == ['odometry']
    accepted = {kind.name for kind in MEASUREMENT_KINDS if kind.is_accepted(bare)}
    assert accepted == {'odometry', 'tags', 'inter_robot'}


def test_losses_are_counted_per_vehicle():
    reader = VehicleReader(MEASUREMENT_KINDS)
    written = dict(KIND_OF_TOPIC[TopicKind.COLOR].write(
        BAG_MESSAGES, FrameNames('robot1'), RECORDS['frame']
    ))  # fmt: skip
    reader.read(TopicKind.DEPTH, written[TopicKind.DEPTH])
    assert reader.read(TopicKind.COLOR, written[TopicKind.COLOR]) is None
    assert reader.losses() == {'unpaired_images': 0, 'frames_without_camera_info': 1}


def test_a_malformed_message_is_refused():
    empty = message_class('sensor_msgs/msg/LaserScan')(range_max=8.0, angle_increment=0.1)
    with pytest.raises(DataError, match='at least one beam'):
        VehicleReader(MEASUREMENT_KINDS).read(TopicKind.SCAN, empty)


def test_tags_that_cannot_be_are_refused():
    read = VehicleReader(MEASUREMENT_KINDS).read
    (written,) = KIND_OF_TOPIC[TopicKind.TAGS].write(
        BAG_MESSAGES, FrameNames('robot1'), RECORDS['tags']
    )
    topic, message = written
    without = dataclasses.replace(message, fields=message.fields[:-1])
    with pytest.raises(DataError, match="field 'id' has 0 values, expected 1"):
        read(topic, without)
    data = message.data.copy()
    data[message.point_step - 4 : message.point_step] = np.array([2319.0], '<f4').view(np.uint8)
    with pytest.raises(DataError, match=r'ids are \[2319, 2319\], expected each once'):
        read(topic, dataclasses.replace(message, data=data))
    data[message.point_step - 4 : message.point_step] = np.array([-1.0], '<f4').view(np.uint8)
    with pytest.raises(DataError, match='expected whole numbers from 0'):
        read(topic, dataclasses.replace(message, data=data))
