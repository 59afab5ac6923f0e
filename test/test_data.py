"""Malformed records raise an error that names the field and the value."""

import math

import numpy as np
import pytest

from explore_slam.data import (
    InterRobotObservation,
    Intrinsics,
    LandmarkObservations,
    LaserScan,
    OdometryReading,
    Plan,
    RgbdFrame,
    TagObservations,
)
from explore_slam.errors import DataError
from explore_slam.geometry import IDENTITY, Pose2, Pose3

CAMERA = Intrinsics(4, 3, 5.0, 5.0, 2.0, 1.5)
RGB, DEPTH = np.zeros((3, 4, 3), np.uint8), np.zeros((3, 4), np.uint16)
RANGES = np.ones(3, np.float32)


@pytest.mark.parametrize(
    ('make', 'message'),
    [
        (lambda: OdometryReading(math.nan, IDENTITY), 'stamp is nan'),
        (lambda: OdometryReading(-1.0, IDENTITY), 'stamp is -1.0'),
        (lambda: OdometryReading(1.0, Pose2(0.0, math.inf, 0.0)), r'pose is \(0.0, inf'),
        (lambda: OdometryReading(1.0, IDENTITY, np.eye(2)), r'covariance has shape \(2, 2\)'),
        (lambda: LaserScan(1.0, 0.0, 0.1, RANGES[:0], 0.0, 8.0), r'shape \(0,\)'),
        (lambda: LaserScan(1.0, 0.0, 0.0, RANGES, 0.0, 8.0), 'angle_increment is 0'),
        (lambda: LaserScan(1.0, math.nan, 0.1, RANGES, 0.0, 8.0), 'angle_min nan'),
        (lambda: LaserScan(1.0, 0.0, 0.1, RANGES, 8.0, 8.0), 'range_min 8.0 and range_max 8.0'),
        (lambda: Intrinsics(0, 3, 5.0, 5.0, 2.0, 1.5), 'image size is 0 x 3'),
        (lambda: Intrinsics(4, 3, 0.0, 5.0, 2.0, 1.5), 'fx, fy'),
        (lambda: RgbdFrame(1.0, RGB[:2], DEPTH, CAMERA), r'rgb has shape \(2, 4, 3\)'),
        (lambda: RgbdFrame(1.0, RGB, DEPTH.astype(np.int32), CAMERA), 'depth is of type int32'),
        (
            lambda: RgbdFrame(1.0, RGB, DEPTH, CAMERA, Pose3((math.nan, 0, 0), (0, 0, 0, 1))),
            'mount is Pose3.*nan.*finite',
        ),
        (
            lambda: LandmarkObservations(
                1.0, np.zeros((1, 3)), np.zeros((1, 3, 3)), np.zeros((2, 128), np.float32)
            ),
            r'descriptors has shape \(2, 128\), expected \(1, length\)',
        ),
        (
            lambda: LandmarkObservations(
                1.0,
                np.full((1, 3), np.nan),
                np.zeros((1, 3, 3)),
                np.zeros((1, 128), np.float32),
            ),
            'positions contains 3 values that are not finite',
        ),
        (
            lambda: InterRobotObservation(1.0, 'r', np.zeros(3), np.eye(2)),
            r'position has shape \(3,\)',
        ),
        (lambda: Plan(1.0, 'r', IDENTITY, np.zeros((2, 3))), r'waypoints has shape \(2, 3\)'),
    ],
)
def test_malformed_records_are_refused(make, message):
    with pytest.raises(DataError, match=message):
        make()


def test_angles_of_a_scan():
    scan = LaserScan(0.0, -1.0, 0.5, RANGES, 0.0, 8.0)
    np.testing.assert_allclose(scan.angles, [-1.0, -0.5, 0.0])


def test_an_empty_observation_has_the_right_shapes():
    empty = LandmarkObservations.empty(1.0)
    assert len(empty) == 0
    assert empty.covariances.shape == (0, 3, 3)


def test_tags_are_checked():
    pose, covariance = np.ones((2, 3)), np.tile(np.eye(3), (2, 1, 1))
    assert len(TagObservations(0.0, np.array([1, 2]), pose, covariance)) == 2
    for ids, poses, P, message in [
        ([3, 3], pose, covariance, r'ids are \[3, 3\], expected each once'),
        ([3], pose, covariance, 'poses has shape'),
        ([3, 4], np.full((2, 3), np.nan), covariance, 'poses contains 6 values'),
        ([3, 4], pose, 0.0 * covariance, 'expected more than 0'),
    ]:
        with pytest.raises(DataError, match=message):
            TagObservations(0.0, np.array(ids), poses, P)
