"""Trajectories with six degrees of freedom: interpolation, gaps, projection onto the plane."""

import numpy as np
import pytest

from explore_slam.errors import EvaluationError
from explore_slam.geometry import rotation_matrix
from explore_slam.results.spatial_trajectory import SpatialTrajectory


def quaternion(angle: float, axis: int) -> np.ndarray:
    found = np.array([0.0, 0.0, 0.0, np.cos(angle / 2)])
    found[axis] = np.sin(angle / 2)
    return found


@pytest.mark.parametrize('axis', range(3))
def test_rotations_follow_the_great_circle_whatever_the_sign_of_the_quaternion(axis):
    ends = [quaternion(0.2, axis), -3.0 * quaternion(1.0, axis)]
    found = SpatialTrajectory([1.0, 2.0], [[0, 0, 0], [4, 2, 0]], ends).at(1.25, max_gap=2.0)
    assert found is not None
    rotation, position = found
    angles = np.zeros(3)
    angles[axis] = 0.4
    np.testing.assert_allclose(rotation, rotation_matrix(*angles), atol=1e-12)
    np.testing.assert_allclose(position, [1.0, 0.5, 0.0])


def test_stamps_outside_and_in_gaps_have_no_pose():
    turn = quaternion(0.0, 2)
    path = SpatialTrajectory([0.0, 0.05, 1.0], np.zeros((3, 3)), [turn] * 3)
    assert path.span == (0.0, 1.0)
    for stamp in (-0.01, 0.5, 1.01):
        assert path.at(stamp) is None
    for stamp in (0.0, 0.02, 0.05, 1.0):
        assert path.at(stamp) is not None


def test_the_projection_has_the_yaw_and_samples_in_order():
    quaternions = [quaternion(0.7, 2), quaternion(-0.3, 2), quaternion(2.0, 2)]
    path = SpatialTrajectory([2.0, 1.0, 2.0], [[2, 1, 9], [0, 0, 9], [5, 5, 5]], quaternions)
    planar = path.planar()
    assert planar.stamps.tolist() == [1.0, 2.0]
    np.testing.assert_allclose(planar.poses, [[0, 0, -0.3], [2, 1, 0.7]], atol=1e-12)


def test_bad_input_is_named():
    with pytest.raises(EvaluationError, match='1 distinct stamps'):
        SpatialTrajectory([1.0, 1.0], np.zeros((2, 3)), [[0, 0, 0, 1]] * 2)
    with pytest.raises(EvaluationError, match=r'quaternions \(2, 3\)'):
        SpatialTrajectory([1.0, 2.0], np.zeros((2, 3)), np.zeros((2, 3)))
