"""Records to messages and back with the real rclpy classes, through real serialisation."""

import math
from dataclasses import replace

import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from scipy.spatial.transform import Rotation

from explore_slam import messages
from explore_slam.data import (
    InterRobotObservation,
    Intrinsics,
    LandmarkObservations,
    LaserScan,
    OdometryReading,
)
from explore_slam.errors import DataError
from explore_slam.geometry import Pose2
from explore_slam.messages.frame_pairing import FramePairing
from explore_slam.mounts import CameraMountConfig
from explore_slam.nodes.ros_types import MESSAGES
from explore_slam.vision import CameraMount

CAMERA = Intrinsics(64, 48, 60.0, 61.0, 31.5, 23.5)


def over_the_wire(message):
    return deserialize_message(serialize_message(message), type(message))


def test_odometry_survives_the_wire():
    reading = OdometryReading(12.345678901, Pose2(1.0, -2.0, 3.0), np.diag([0.1, 0.2, 0.3]))
    message = messages.odometry_message(MESSAGES, reading, 'r/odom', 'r/base_link', (0.4, 0.1))
    back = messages.odometry_record(over_the_wire(message))
    assert back.stamp == pytest.approx(reading.stamp, abs=1e-9)
    assert tuple(back.pose) == pytest.approx(tuple(reading.pose))
    np.testing.assert_array_equal(back.covariance, reading.covariance)


def test_scan_keeps_rep_117_values():
    ranges = np.array([1.0, np.inf, -np.inf, np.nan, 8.0], np.float32)
    scan = LaserScan(1.0, -1.5, 0.75, ranges, 0.05, 8.0)
    back = messages.scan_record(over_the_wire(messages.scan_message(MESSAGES, scan, 'l')))
    np.testing.assert_array_equal(back.ranges, ranges)
    assert back.angle_min == pytest.approx(-1.5)
    assert back.range_max == pytest.approx(8.0)


def test_scan_keeps_the_times_of_its_beams():
    ranges = np.ones(5, np.float32)
    scan = LaserScan(1.0, -1.5, 0.75, ranges, 0.05, 8.0, time_increment=1.9e-4, scan_time=0.18)
    back = messages.scan_record(over_the_wire(messages.scan_message(MESSAGES, scan, 'l')))
    assert back.time_increment == pytest.approx(1.9e-4)
    assert back.scan_time == pytest.approx(0.18)


@pytest.mark.parametrize('encoding', ['rgb8', 'bgr8', 'rgba8', 'mono8'])
def test_colour_encodings(encoding):
    rng = np.random.default_rng(0)
    rgb = rng.integers(0, 255, (48, 64, 3), dtype=np.uint8)
    sent = {
        'rgb8': rgb,
        'bgr8': rgb[:, :, ::-1],
        'rgba8': np.concatenate([rgb, rgb[:, :, :1]], axis=2),
        'mono8': rgb[:, :, 0],
    }[encoding]
    message = messages.image_message(MESSAGES, 1.0, 'c', encoding, sent)
    expected = rgb[:, :, 0] if encoding == 'mono8' else rgb
    np.testing.assert_array_equal(messages.color_array(over_the_wire(message)), expected)


def test_depth_in_mm_and_in_m_and_of_the_other_byte_order():
    mm = np.arange(48 * 64, dtype=np.uint16).reshape(48, 64)
    meters = (mm / 1000).astype(np.float32)
    for encoding, depth in (('16UC1', mm), ('32FC1', meters)):
        message = messages.image_message(MESSAGES, 1.0, 'c', encoding, depth)
        np.testing.assert_array_equal(messages.depth_array(over_the_wire(message)), depth)
    swapped = messages.image_message(MESSAGES, 1.0, 'c', '16UC1', mm.byteswap())
    swapped.is_bigendian = 1
    np.testing.assert_array_equal(messages.depth_array(swapped), mm)


def test_frame_of_another_size_is_refused_with_both_sizes():
    rgb = messages.image_message(MESSAGES, 1.0, 'c', 'rgb8', np.zeros((48, 64, 3), np.uint8))
    depth = messages.image_message(MESSAGES, 1.0, 'c', '16UC1', np.zeros((24, 32), np.uint16))
    info = messages.camera_info_message(MESSAGES, 1.0, 'c', CAMERA)
    pairing = FramePairing()
    pairing.add_camera_info(info)
    pairing.add_color(rgb)
    with pytest.raises(DataError, match=r'depth has shape \(24, 32\), expected \(48, 64\)'):
        pairing.add_depth(depth)


def test_truncated_and_unknown_images_are_refused():
    message = messages.image_message(MESSAGES, 1.0, 'c', 'rgb8', np.zeros((4, 4, 3), np.uint8))
    message.data = message.data[:-1]
    with pytest.raises(DataError, match='47 bytes'):
        messages.color_array(message)
    message.encoding = 'yuv422'
    with pytest.raises(DataError, match='yuv422'):
        messages.color_array(message)
    with pytest.raises(DataError, match='yuv422'):
        messages.depth_array(message)


@pytest.mark.parametrize('compact', [False, True])
def test_landmarks_survive_the_wire(compact):
    rng = np.random.default_rng(1)
    descriptors = np.abs(rng.normal(size=(5, 128))).astype(np.float32)
    descriptors /= np.linalg.norm(descriptors, axis=1, keepdims=True)
    root = rng.normal(size=(5, 3, 3))
    observations = LandmarkObservations(
        3.5, rng.normal(size=(5, 3)), root @ root.transpose(0, 2, 1), descriptors
    )
    message = messages.landmarks_message(MESSAGES, observations, 'r/base_link', compact)
    back = messages.landmarks_record(over_the_wire(message))
    np.testing.assert_allclose(back.positions, observations.positions, rtol=1e-6)
    np.testing.assert_allclose(back.covariances, observations.covariances, rtol=1e-6)
    np.testing.assert_allclose(back.descriptors, descriptors, atol=2e-3 if compact else 1e-6)


def test_when_landmarks_were_exposed_survives_the_wire():
    delays = np.array([-0.013, 0.0, 0.0117])
    observations = LandmarkObservations(
        3.5,
        np.ones((3, 3)),
        np.repeat(np.eye(3)[None], 3, axis=0),
        np.eye(3, 128, dtype=np.float32),
        delays,
    )
    message = messages.landmarks_message(MESSAGES, observations, 'r/base_link', compact=True)
    back = messages.landmarks_record(over_the_wire(message))
    np.testing.assert_allclose(back.delays, delays, atol=1e-8)
    without = messages.landmarks_message(MESSAGES, replace(observations, delays=None), 'r')
    assert messages.landmarks_record(over_the_wire(without)).delays is None
    broken = replace(observations, delays=np.zeros(3))
    object.__setattr__(broken, 'delays', np.full(3, np.nan))
    with pytest.raises(DataError, match='delays'):
        messages.landmarks_record(messages.landmarks_message(MESSAGES, broken, 'r'))


def test_no_landmarks_and_wrong_landmarks():
    empty = messages.landmarks_message(MESSAGES, LandmarkObservations.empty(1.0), 'r')
    assert len(messages.landmarks_record(over_the_wire(empty))) == 0
    wrong = messages.cloud_message(
        MESSAGES, 1.0, 'r', [(axis, np.zeros(2, np.float32)) for axis in 'xyz']
    )
    with pytest.raises(DataError, match="'covariance' has 0 values, expected 6"):
        messages.landmarks_record(wrong)


def test_landmarks_with_descriptors_of_other_kinds():
    bits = np.arange(64, dtype=np.uint8).reshape(2, 32)
    numbers = np.eye(2, 256, dtype=np.float32)
    for descriptors in (bits, numbers):
        observations = LandmarkObservations(
            1.0, np.ones((2, 3)), np.repeat(np.eye(3)[None], 2, axis=0), descriptors
        )
        message = messages.landmarks_message(MESSAGES, observations, 'r', compact=True)
        back = messages.landmarks_record(over_the_wire(message))
        np.testing.assert_array_equal(back.descriptors, descriptors)
        assert back.descriptors.dtype == descriptors.dtype


def test_landmarks_without_or_with_zero_descriptors_are_refused():
    columns = [(axis, np.zeros(2, np.float32)) for axis in 'xyz']
    columns.append(('covariance', np.zeros((2, 6))))
    cloud = messages.cloud_message(MESSAGES, 1.0, 'r', columns)
    with pytest.raises(DataError, match="neither field 'descriptor' nor 'binary_descriptor'"):
        messages.landmarks_record(cloud)
    for name, words in (('descriptor', 'all zero'), ('binary_descriptor', 'expected uint8')):
        described = [*columns, (name, np.zeros((2, 4), np.float32))]
        with pytest.raises(DataError, match=words):
            messages.landmarks_record(messages.cloud_message(MESSAGES, 1.0, 'r', described))


def test_path_and_plan():
    points = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 2.0]])
    message = over_the_wire(messages.path_message(MESSAGES, 2.0, 'map', points))
    plan = messages.plan_record(message, 'robot1')
    np.testing.assert_allclose(plan.waypoints, points)
    assert plan.goal.theta == pytest.approx(math.pi / 2)
    stop = messages.plan_record(
        messages.path_message(MESSAGES, 2.0, 'map', np.empty((0, 2))), 'robot1'
    )
    assert len(stop.waypoints) == 0


def test_an_inter_robot_observation_names_the_observed_vehicle():
    observation = InterRobotObservation(1.0, 'robot2', np.array([1.0, 0.5]), np.diag([0.01, 0.02]))
    back = messages.inter_robot_record(
        over_the_wire(messages.inter_robot_message(MESSAGES, observation))
    )
    assert back.vehicle == 'robot2'
    np.testing.assert_array_equal(back.covariance, observation.covariance)


@pytest.mark.parametrize('w', [0.0, 1e-200, 1e200, math.inf, math.nan])
def test_a_pose_without_rotation_is_refused(w):
    message = messages.pose_message(MESSAGES, Pose2(0.0, 0.0, 0.0))
    message.orientation.w = w
    with pytest.raises(DataError, match='not a rotation'):
        messages.planar_pose(message)


def test_the_camera_transform_is_the_mount_that_vision_uses():
    config = CameraMountConfig(0.2, -0.1, 0.6, camera_roll=0.1, camera_pitch=0.4, camera_yaw=-2.0)
    message = messages.camera_transform_message(MESSAGES, 2.5, 'r/base_link', 'r/camera', config)
    back = over_the_wire(message)
    assert (back.header.frame_id, back.child_frame_id) == ('r/base_link', 'r/camera')
    turn, move = back.transform.rotation, back.transform.translation
    mount = CameraMount.from_config(config)
    rotation = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix()
    np.testing.assert_allclose(rotation, mount.rotation, atol=1e-12)
    np.testing.assert_allclose([move.x, move.y, move.z], mount.translation)
