"""NEES of published estimates: known cases, statistics, estimates that do not count."""

import math

import numpy as np
import pytest

from explore_slam.errors import EvaluationError
from explore_slam.results.consistency import (
    PoseEstimates,
    consistency_metrics,
    estimation_errors,
    nees,
)
from explore_slam.results.trajectory import Trajectory

STAMPS = np.arange(0.0, 10.01, 0.1)
TRUTH = Trajectory(STAMPS, np.column_stack([0.5 * STAMPS, 0.1 * STAMPS, 0.3 * STAMPS]))
COVARIANCE = np.diag([0.04, 0.01, 0.0025])


def estimates(stamps, errors, covariance=COVARIANCE) -> PoseEstimates:
    stamps = np.asarray(stamps, dtype=np.float64)
    poses = np.column_stack([0.5 * stamps, 0.1 * stamps, 0.3 * stamps]) + errors
    return PoseEstimates(stamps, poses, np.broadcast_to(covariance, (len(stamps), 3, 3)))


def test_a_known_error_has_the_known_nees():
    # one standard deviation in each coordinate
    found = consistency_metrics(estimates([2.03, 5.0], [0.2, -0.1, 0.05]), TRUTH)
    assert found == {
        'pose_nees_mean': pytest.approx(3.0),
        'pose_nees_median': pytest.approx(3.0),
        'position_nees_mean': pytest.approx(2.0),
        'position_in_95': 1.0,
    }
    # just inside and just outside of the ellipse along x
    radius = 0.2 * math.sqrt(5.991)
    errors = [[0.999 * radius, 0.0, 0.0], [1.001 * radius, 0.0, 0.0]]
    assert consistency_metrics(estimates([2.0, 5.0], errors), TRUTH)['position_in_95'] == 0.5


def test_correlated_errors_are_measured_along_their_axes():
    covariance = np.array([[1.0, 0.9, 0.0], [0.9, 1.0, 0.0], [0.0, 0.0, 1.0]])
    along, across = nees(np.array([[1.0, 1.0, 0.0], [1.0, -1.0, 0.0]]), np.stack([covariance] * 2))
    assert along == pytest.approx(2.0 / 1.9)
    assert across == pytest.approx(2.0 / 0.1)


def test_consistent_estimates_have_the_nees_of_chi_square():
    rng = np.random.default_rng(4)
    root = rng.normal(size=(3, 3)) * [0.1, 0.02, 0.01]
    covariance = root.T @ root
    errors = rng.multivariate_normal(np.zeros(3), covariance, 5000)
    found = consistency_metrics(estimates(np.linspace(1, 9, 5000), errors, covariance), TRUTH)
    assert found['pose_nees_mean'] == pytest.approx(3.0, rel=0.05)
    assert found['pose_nees_median'] == pytest.approx(2.366, rel=0.05)
    assert found['position_nees_mean'] == pytest.approx(2.0, rel=0.05)
    assert found['position_in_95'] == pytest.approx(0.95, abs=0.01)


def test_headings_are_interpolated_and_compared_on_the_circle():
    truth = Trajectory(np.array([0.0, 1.0]), np.array([[0.0, 0.0, 3.1], [0.0, 0.0, -3.1]]))
    one = PoseEstimates(np.array([0.5]), np.array([[0.0, 0.0, -math.pi]]), COVARIANCE[None])
    assert estimation_errors(one, truth).errors[0] == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)


def test_a_singular_covariance_counts_as_infinite():
    flat = np.array([[0.04, 0.02, 0.0], [0.02, 0.01, 0.0], [0.0, 0.0, 0.0025]])
    found = consistency_metrics(
        PoseEstimates(
            np.array([1.0, 2.0, 3.0, 4.0]),
            TRUTH.at([1.0, 2.0, 3.0, 4.0])[0],
            np.stack([COVARIANCE, flat, np.zeros((3, 3)), np.full((3, 3), np.nan)]),
        ),
        TRUTH,
    )
    assert found['pose_nees_mean'] == math.inf
    assert found['pose_nees_median'] == math.inf
    assert found['position_in_95'] == 0.25


def test_units_do_not_make_a_covariance_singular():
    small = np.diag([1e4, 1e-4, 1e-14])
    assert nees(np.array([[100.0, 0.0, 1e-7]]), small[None])[0] == pytest.approx(2.0)


def test_the_given_start_pose_and_times_without_truth_are_left_out():
    truth = Trajectory(np.array([1.0, 2.0, 8.0, 9.0]), np.zeros((4, 3)))
    zero = 1e-32 * np.eye(3)  # the rounding error of a mean over particles
    all_of_them = PoseEstimates(
        np.array([1.0, 1.5, 1.8, 5.0, 8.5, 9.5]),
        np.zeros((6, 3)),
        np.stack([zero, COVARIANCE, zero, COVARIANCE, COVARIANCE, COVARIANCE]),
    )
    found = estimation_errors(all_of_them, truth, max_gap=1.0)
    assert found.stamps.tolist() == [1.5, 1.8, 8.5]
    assert consistency_metrics(estimates([50.0], np.zeros((1, 3))), TRUTH) == {}
    assert consistency_metrics(PoseEstimates.empty(), TRUTH) == {}


def test_a_vehicle_has_started_once_it_is_uncertain_or_has_moved():
    standing = 1e-16 * np.eye(3)  # wheels that stand still report nanometres
    stamps = np.array([1.0, 2.0, 3.0, 4.0])
    published = np.stack([standing, standing, standing, COVARIANCE])
    still = Trajectory(stamps, np.zeros((4, 3)))
    found = estimation_errors(PoseEstimates(stamps, np.zeros((4, 3)), published), still)
    assert found.stamps.tolist() == [4.0]
    moving = Trajectory(stamps, np.array([[0.0] * 3, [0.005, 0, 0], [0.5, 0, 0], [1.0, 0, 0]]))
    found = estimation_errors(PoseEstimates(stamps, np.zeros((4, 3)), published), moving)
    assert found.stamps.tolist() == [3.0, 4.0]


def test_wrong_shapes_are_refused():
    with pytest.raises(EvaluationError, match=r'expected \(T,\), \(T, 3\) and \(T, 3, 3\)'):
        PoseEstimates(np.zeros(2), np.zeros((2, 3)), np.zeros((2, 2, 2)))
