"""SE(2): the array functions agree with the scalar ones, and both with the group's laws."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from explore_slam import geometry
from explore_slam.geometry import IDENTITY, Pose2

coordinates = st.floats(-1e3, 1e3)
poses = st.builds(Pose2, coordinates, coordinates, st.floats(-math.pi, math.pi))


def assert_same(a, b):
    assert math.isclose(a.x, b.x, abs_tol=1e-8)
    assert math.isclose(a.y, b.y, abs_tol=1e-8)
    assert abs(geometry.wrap_angle(a.theta - b.theta)) < 1e-9


@given(poses, poses)
def test_between_undoes_compose(a, b):
    assert_same(a.compose(a.between(b)), b)
    assert_same(a.compose(a.inverse()), IDENTITY)


@given(poses, poses)
def test_arrays_agree_with_scalars(a, b):
    assert_same(Pose2(*geometry.compose(a, b)), a.compose(b))
    expected = a.between(b)
    found = geometry.between(np.array([a, a]), np.array([b, b]))
    np.testing.assert_allclose(found[1, :2], expected[:2], atol=1e-9)
    assert abs(geometry.wrap_angle(found[0, 2] - expected.theta)) < 1e-9


@given(st.floats(-1e4, 1e4))
def test_wrapped_angles_lie_in_the_half_open_interval(angle):
    wrapped = geometry.wrap_angle(angle)
    assert -math.pi < wrapped <= math.pi
    assert math.isclose(math.cos(wrapped), math.cos(angle), abs_tol=1e-9)
    both = geometry.wrap_angles(np.array([angle]))[0]
    assert -math.pi < both <= math.pi


@given(poses)
def test_points_move_like_poses(pose):
    moved = geometry.to_world(pose, np.array([[1.0, 2.0, 3.0]]))[0]
    expected = pose.compose(Pose2(1.0, 2.0, 0.0))
    np.testing.assert_allclose(moved, [expected.x, expected.y, 3.0], atol=1e-9)


@given(poses)
def test_planar_rotation_moves_an_increment_into_the_world(pose):
    increment = np.array([1.0, -2.0, 0.3])
    moved = geometry.planar_rotation(pose.theta) @ increment
    expected = pose.compose(Pose2(1.0, -2.0, 0.0))
    np.testing.assert_allclose(moved, [expected.x - pose.x, expected.y - pose.y, 0.3], atol=1e-9)
    turned = geometry.rotated(np.diag([4.0, 1.0, 9.0]), math.pi / 2)
    np.testing.assert_allclose(turned, np.diag([1.0, 4.0, 9.0]), atol=1e-12)


def test_rotation_matrix_of_yaw_turns_left():
    turned = geometry.rotation_matrix(0.0, 0.0, math.pi / 2) @ [1.0, 0.0, 0.0]
    np.testing.assert_allclose(turned, [0.0, 1.0, 0.0], atol=1e-12)
    tilted = geometry.rotation_matrix(0.0, 0.1, 0.0) @ [1.0, 0.0, 0.0]
    assert tilted[2] < 0.0  # positive pitch looks down (REP-103)


@pytest.mark.parametrize(
    ('increment', 'enough'),
    [
        (Pose2(0.3, 0.4, 0.0), True),
        (Pose2(0.3, 0.39, 0.0), False),
        (Pose2(0.0, 0.0, -0.2), True),
        (Pose2(-0.3, 0.0, 0.19), False),
    ],
)
def test_a_distance_or_a_turn_is_motion_enough(increment, enough):
    assert geometry.moved_enough(increment, distance=0.5, heading=0.2) is enough


angles = st.floats(-3.1, 3.1)


@given(angles)
def test_yaw_survives_a_quaternion(yaw):
    quaternion = geometry.quaternion_from_yaw(yaw)
    assert math.isclose(geometry.yaw_from_quaternion(*quaternion), yaw, abs_tol=1e-12)
    longer = [3.0 * part for part in quaternion]
    assert math.isclose(geometry.yaw_from_quaternion(*longer), yaw, abs_tol=1e-12)


@given(angles, st.floats(-1.5, 1.5), angles)
def test_rotations_survive_a_quaternion(roll, pitch, yaw):
    rotation = geometry.rotation_matrix(roll, pitch, yaw)
    quaternion = geometry.quaternion_from_rotation(rotation)
    assert quaternion[3] >= 0.0
    np.testing.assert_allclose(Rotation.from_quat(quaternion).as_matrix(), rotation, atol=1e-9)
    difference = geometry.wrap_angle(geometry.yaw_from_quaternion(*quaternion) - yaw)
    assert abs(difference) < 1e-6


@given(angles, angles, angles, angles)
def test_products_of_quaternions_are_products_of_rotations(a, b, c, d):
    first, second = geometry.rotation_matrix(a, 0.3, b), geometry.rotation_matrix(c, -0.2, d)
    product = geometry.multiply_quaternions(
        geometry.quaternion_from_rotation(first), geometry.quaternion_from_rotation(second)
    )
    found = Rotation.from_quat(product).as_matrix()
    np.testing.assert_allclose(found, first @ second, atol=1e-9)


def test_poses_are_interpolated_along_the_shorter_turn():
    found = geometry.interpolated(
        [[0.0, 0.0, 3.0], [1.0, 1.0, 0.5]], [[2.0, 4.0, -3.0], [1.0, 3.0, 0.5]], [0.5, 0.25]
    )
    assert found[0, :2] == pytest.approx([1.0, 2.0])
    assert abs(found[0, 2]) == pytest.approx(np.pi)
    assert found[1] == pytest.approx([1.0, 1.5, 0.5])
