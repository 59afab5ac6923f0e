"""Vehicles with several lasers and cameras: settings, topics, mounts, what is told apart."""

import logging
import math
from types import SimpleNamespace

import numpy as np
import pytest

from explore_slam import messages
from explore_slam.data import LaserScan
from explore_slam.errors import ConfigError, DataError
from explore_slam.geometry import Pose2, quaternion_from_yaw
from explore_slam.messages.frame_pairing import FRAME
from explore_slam.messages.measurement import VehicleReader
from explore_slam.messages.measurement_kinds import MEASUREMENT_KINDS
from explore_slam.messages.scans import SCAN
from explore_slam.messages.sensor_mounts import SensorMounts
from explore_slam.messages.sweep_status import sweeps_message, sweeps_record
from explore_slam.messages.topics import TopicKind
from explore_slam.messages.transforms import TransformTree
from explore_slam.messages.vehicle_settings import VehicleConfig, vehicle_settings
from explore_slam.recording.rosbags_types import MESSAGES
from explore_slam.sweeps import Sweep

TWO = VehicleConfig(
    scans=('front/scan', 'rear/scan'),
    laser_mount=(0.2, 0.0, 0.0, -0.2, 0.0, math.pi),
    cameras=('left_camera', 'right_camera'),
    camera_mount=(0.1, 0.2, 0.5, 0.0, 0.0, 0.5, 0.1, -0.2, 0.5, 0.0, 0.0, -0.5),
)


def scan(frame):
    record = LaserScan(1.0, -1.0, 0.5, np.ones(5, np.float32), 0.1, 8.0)
    return messages.scan_message(MESSAGES, record, frame)


def tree(**frames):
    made = TransformTree()
    made.add(
        SimpleNamespace(
            transforms=[
                messages.transform_message(
                    MESSAGES, 0.0, 'base_link', name, (pose.x, pose.y, 0.3),
                    quaternion_from_yaw(pose.theta),
                )
                for name, pose in frames.items()
            ]
        )
    )  # fmt: skip
    return made


def test_topics_of_a_vehicle_with_one_laser_and_camera_are_the_usual_ones():
    topics = {kind.name: kind.topics_of(VehicleConfig()) for kind in MEASUREMENT_KINDS}
    assert [tuple(topic) for topic in topics['scan']] == [(TopicKind.SCAN, 'scan', '')]
    assert {(topic.kind.value, topic.sensor) for topic in topics['frame']} == {
        (kind.value, '') for kind in FRAME.topics
    }
    for found in topics.values():
        assert all(topic.name == topic.kind.value for topic in found)
    assert SCAN.topics_of(VehicleConfig(use_laser=False)) == []


def test_topics_of_several_sensors_are_named_after_them():
    both = VehicleConfig(scans=('front/scan',), clouds=('velodyne_points',))
    assert [tuple(topic) for topic in SCAN.topics_of(both)] == [
        (TopicKind.SCAN, 'front/scan', 'front/scan'),
        (TopicKind.CLOUD, 'velodyne_points', 'velodyne_points'),
    ]
    alone = VehicleConfig(scans=('',), clouds=('points',))
    assert [tuple(topic) for topic in SCAN.topics_of(alone)] == [(TopicKind.CLOUD, 'points', '')]
    names = {topic.name: topic.sensor for topic in FRAME.topics_of(TWO)}
    assert names['left_camera/rgb/image_raw'] == 'left_camera'
    assert names['right_camera/depth_registered/image_raw/compressedDepth'] == 'right_camera'
    assert len(names) == 2 * len(FRAME.topics)


@pytest.mark.parametrize(
    ('name', 'value', 'part'),
    [
        ('scans', ['/front/scan'], "scans is ['/front/scan'], expected different names below"),
        ('scans', ['a', 'a'], "scans is ['a', 'a']"),
        ('clouds', ['points/'], "clouds is ['points/']"),
        ('cameras', [''], "cameras is ['']"),
        ('laser_mount', [0.0] * 4, 'expected 3 finite numbers'),
        ('cloud_lowest', 2.0, 'cloud_lowest is 2.0 m and cloud_highest 1.0 m'),
    ],
)
def test_settings_that_do_not_fit_are_named(name, value, part):
    with pytest.raises(ConfigError) as raised:
        vehicle_settings(VehicleConfig(), {f'robot1.{name}': value}, ['robot1'])
    assert part in str(raised.value)


def test_each_laser_has_its_mount_from_the_settings_or_from_tf(caplog):
    caplog.set_level(logging.INFO)
    mounts = SensorMounts('r', TransformTree(), TWO)
    reader = VehicleReader(MEASUREMENT_KINDS, mounts)
    found = {
        name: reader.read(TopicKind.SCAN, scan(name.split('/')[0]), name)[1]
        for name in ('rear/scan', 'front/scan')
    }
    assert {name: record.sensor for name, record in found.items()} == {n: n for n in found}
    assert found['front/scan'].mount == Pose2(0.2, 0.0, 0.0)
    assert found['rear/scan'].mount == Pose2(-0.2, 0.0, math.pi)
    left = mounts.optical_pose('left', 'left_camera')
    right = mounts.optical_pose('right', 'right_camera')
    assert (left.position[1], right.position[1]) == (0.2, -0.2)
    # /tf_static goes first
    placed = SensorMounts('r', tree(front=Pose2(0.3, 0.1, 0.0)), VehicleConfig(scans=TWO.scans))
    reader = VehicleReader(MEASUREMENT_KINDS, placed)
    record = reader.read(TopicKind.SCAN, scan('front'), 'front/scan')[1]
    assert record.mount == pytest.approx((0.3, 0.1, 0.0))
    assert 'WARNING' not in [item.levelname for item in caplog.records]
    reader.read(TopicKind.SCAN, scan('rear'), 'rear/scan')
    assert 'no transform leads from base_link to rear' in caplog.text


def test_two_lasers_with_one_frame_are_named_once_and_take_the_settings(caplog):
    frames = tree(laser=Pose2(0.2, 0.0, 0.0))
    reader = VehicleReader(MEASUREMENT_KINDS, SensorMounts('r', frames, TWO))
    for _ in range(3):
        for name in TWO.scans:
            record = reader.read(TopicKind.SCAN, scan('laser'), name)[1]
    assert record.mount == Pose2(-0.2, 0.0, math.pi)
    shared = [item.message for item in caplog.records if 'the same frame' in item.message]
    assert shared == [
        "r: front/scan and rear/scan have the same frame 'laser': r.laser_mount is used"
    ]


def test_transforms_of_two_lasers_that_contradict_each_other_are_named_once(caplog):
    frames = tree(front=Pose2(0.2, 0.0, 0.0), rear=Pose2(0.2, 0.0, 0.0))
    config = VehicleConfig(scans=TWO.scans)
    reader = VehicleReader(MEASUREMENT_KINDS, SensorMounts('r', frames, config))
    for _ in range(3):
        for name in TWO.scans:
            reader.read(TopicKind.SCAN, scan(name.split('/')[0]), name)
    named = [item.message for item in caplog.records if item.levelname == 'WARNING']
    assert named == [
        'r: front/scan (front) and rear/scan (rear) are at the same pose (0.200, 0.000, 0.300, '
        '0.000, 0.000, 0.000) by /tf_static; correct the transforms, or set r.laser_mount'
    ]
    caplog.clear()
    frames = TransformTree()
    for turn in (0.0, 1.0):
        message = messages.transform_message(
            MESSAGES, 0.0, 'base_link', 'rear', (-0.2, 0.0, 0.3), quaternion_from_yaw(turn)
        )
        frames.add(SimpleNamespace(transforms=[message]), shared=True, static=True)
    reader = VehicleReader(MEASUREMENT_KINDS, SensorMounts('r', frames, config))
    for _ in range(3):
        record = reader.read(TopicKind.SCAN, scan('rear'), 'rear/scan')[1]
    named = [item.message for item in caplog.records if item.levelname == 'WARNING']
    assert len(named) == 1
    assert (
        '/tf_static has had different poses of rear (rear/scan); the newest, (-0.200' in named[0]
    )
    assert record.mount.theta == pytest.approx(1.0)


def test_frames_of_two_lasers_on_one_topic_are_one_warning_and_two_mounts(caplog):
    frames = tree(front=Pose2(0.2, 0.0, 0.0), rear=Pose2(-0.2, 0.0, math.pi))
    reader = VehicleReader(MEASUREMENT_KINDS, SensorMounts('r', frames))
    records = [
        reader.read(TopicKind.SCAN, scan(frame))[1] for frame in ('front', 'rear', 'front', 'rear')
    ]
    assert [record.sensor for record in records] == ['', 'scan, rear'] * 2
    assert [record.mount.x for record in records] == pytest.approx([0.2, -0.2] * 2)
    named = [item.message for item in caplog.records if 'have the frames' in item.message]
    assert len(named) == 1
    assert "messages on scan have the frames 'front' and 'rear'" in named[0]


def test_what_was_found_of_sweeps_travels_as_a_message():
    found = {'front/scan': Sweep(0.18, True, True), 'rear/scan': Sweep(0.0)}
    assert sweeps_record(sweeps_message(MESSAGES, 'r', found)) == found
    only = {'': Sweep(0.1, False, True)}
    message = sweeps_message(MESSAGES, 'r', only)
    assert [(pair.key, pair.value) for pair in message.values] == [('scan', '0.1 forward last')]
    assert sweeps_record(message) == only
    for words in ('', 'nan forward first', '0.1 sideways first', '2.5 forward first', '0.1'):
        message.values[0].value = words
        with pytest.raises(DataError, match='sweep of scan is'):
            sweeps_record(message)
