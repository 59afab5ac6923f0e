"""Trajectory errors: known cases, and equality with evo."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from explore_slam.errors import EvaluationError, RecordingError
from explore_slam.geometry import Pose2, compose, to_world
from explore_slam.results.trajectory import (
    Trajectory,
    align,
    heading_errors,
    load_tum,
    pairs,
    position_errors,
    relative_errors,
    save_tum,
    trajectory_metrics,
)


def wander(seed: int, count: int = 300, noise: float = 0.0) -> Trajectory:
    rng = np.random.default_rng(seed)
    poses = [np.zeros(3)]
    for turn in rng.normal(0.0, 0.1, count - 1):
        step = np.array([0.0533, 0.0, turn]) + noise * rng.normal(0.0, 1.0, 3)
        poses.append(compose(poses[-1], step))
    return Trajectory(100.0 + 0.1 * np.arange(count), np.array(poses))


def evo_path(trajectory: Trajectory):
    from evo.core.trajectory import PoseTrajectory3D

    x, y, theta = trajectory.poses.T
    zero = np.zeros(len(trajectory))
    return PoseTrajectory3D(
        np.column_stack([x, y, zero]),
        np.column_stack([np.cos(theta / 2), zero, zero, np.sin(theta / 2)]),
        trajectory.stamps,
    )


@pytest.mark.parametrize('seed', range(3))
def test_errors_are_those_of_evo(seed):
    from evo.core import metrics
    from evo.core.geometry import umeyama_alignment

    truth, estimated = wander(seed), wander(seed, noise=0.01)
    found = trajectory_metrics(estimated, truth)
    reference, other = evo_path(truth), evo_path(estimated)

    absolute = metrics.APE(metrics.PoseRelation.translation_part)
    absolute.process_data((reference, other))
    expected = absolute.get_all_statistics()
    assert found['position_rms'] == pytest.approx(expected['rmse'])
    assert found['position_mean'] == pytest.approx(expected['mean'])
    assert found['position_median'] == pytest.approx(expected['median'])
    assert found['position_max'] == pytest.approx(expected['max'])

    heading = metrics.APE(metrics.PoseRelation.rotation_angle_rad)
    heading.process_data((reference, other))
    assert found['heading_rms'] == pytest.approx(
        heading.get_statistic(metrics.StatisticsType.rmse)
    )

    for name, relation in (
        ('relative_translation_rms', metrics.PoseRelation.translation_part),
        ('relative_rotation_rms', metrics.PoseRelation.rotation_angle_rad),
    ):
        relative = metrics.RPE(relation, 1.0, metrics.Unit.meters, pairs_from_reference=True)
        relative.process_data((reference, other))
        assert found[name] == pytest.approx(relative.get_statistic(metrics.StatisticsType.rmse))

    # evo's trajectories are in space, where a planar path may be turned over: align in the plane
    x, y = estimated.poses[:, :2].T, truth.poses[:, :2].T
    rotation, translation, _ = umeyama_alignment(x, y)
    rest = rotation @ x + translation[:, None] - y
    assert found['position_rms_aligned'] == pytest.approx(np.sqrt(np.mean(np.sum(rest**2, 0))))


@settings(deadline=None)
@given(st.floats(-50, 50), st.floats(-50, 50), st.floats(-3.1, 3.1), st.integers(0, 5))
def test_alignment_undoes_any_rigid_motion(x, y, theta, seed):
    poses = wander(seed, 30).poses
    moved = compose(np.array([x, y, theta]), poses)
    back = align(moved, poses)
    np.testing.assert_allclose(back[:, :2], poses[:, :2], atol=1e-8)
    np.testing.assert_allclose(heading_errors(back, poses), 0.0, atol=1e-8)


def test_a_known_offset():
    truth = wander(1)
    estimated = Trajectory(truth.stamps, truth.poses + np.array([0.3, 0.4, 0.1]))
    found = trajectory_metrics(estimated, truth)
    assert found['position_rms'] == pytest.approx(0.5)
    assert found['heading_rms'] == pytest.approx(0.1)
    assert found['position_rms_aligned'] == pytest.approx(0.0, abs=1e-9)
    assert found['poses'] == 300


def test_heading_errors_go_the_short_way():
    a, b = np.array([[0.0, 0.0, math.pi - 0.01]]), np.array([[0.0, 0.0, -math.pi + 0.01]])
    assert heading_errors(a, b) == pytest.approx([-0.02])


def test_interpolates_and_leaves_gaps_out():
    truth = Trajectory(
        np.array([0.0, 1.0, 2.0, 10.0]),
        np.array([[0.0, 0.0, 3.1], [1.0, 0.0, -3.1], [1.0, 1.0, 0.0], [1.0, 2.0, 0.0]]),
    )
    poses, valid = truth.at([0.5, 2.0, 5.0, 10.0, 11.0, -1.0], max_gap=1.5)
    assert valid.tolist() == [True, True, False, True, False, False]
    assert poses[0, :2] == pytest.approx([0.5, 0.0])
    assert abs(poses[0, 2]) == pytest.approx(math.pi)
    stamps, _, true = pairs(Trajectory.of([0.5, 5.0], [[0, 0, 0], [9, 9, 9]]), truth)
    assert stamps.tolist() == [0.5]
    assert len(true) == 1


def test_ground_truth_that_is_slow_throughout_has_no_gaps():
    stamps = np.r_[0.0:60.0:1.2, 90.0:100.0:1.2]
    truth = Trajectory(stamps, np.column_stack([stamps, 0.0 * stamps, 0.0 * stamps]))
    assert truth.largest_gap == pytest.approx(3.0)
    poses, valid = truth.at([30.6, 75.0, 90.5])
    assert valid.tolist() == [True, False, True]
    assert poses[0, 0] == pytest.approx(30.6)
    fast = Trajectory(stamps / 120.0, truth.poses)
    assert fast.largest_gap == 1.0


def test_relative_errors_ignore_a_common_offset():
    truth = wander(2)
    moved = compose(np.array([3.0, -1.0, 0.7]), truth.poses)
    translations, rotations = relative_errors(moved, truth.poses)
    assert translations.size > 5
    np.testing.assert_allclose(translations, 0.0, atol=1e-9)
    np.testing.assert_allclose(rotations, 0.0, atol=1e-9)


def test_odometry_is_moved_to_its_start():
    path = wander(3)
    start = Pose2(1.0, 2.0, 0.5)
    moved = path.from_start(start)
    assert moved.poses[0] == pytest.approx(start)
    expected = to_world(start, np.column_stack([path.poses[:, :2]]))
    np.testing.assert_allclose(moved.poses[:, :2], expected, atol=1e-12)
    assert moved.length == pytest.approx(path.length)


def test_samples_in_any_order_and_repeated_stamps():
    path = Trajectory.of([2.0, 1.0, 2.0], [[2, 0, 0], [1, 0, 0], [3, 0, 0]])
    assert path.stamps.tolist() == [1.0, 2.0]
    assert path.poses[:, 0].tolist() == [1.0, 3.0]
    assert len(Trajectory.of([], [])) == 0


def test_tum_files_round_trip(tmp_path):
    from evo.tools import file_interface

    path = wander(4)
    save_tum(tmp_path / 'a.tum', path)
    again = load_tum(tmp_path / 'a.tum')
    np.testing.assert_allclose(again.poses, path.poses, atol=2e-6)
    np.testing.assert_allclose(again.stamps, path.stamps, atol=1e-8)
    other = file_interface.read_tum_trajectory_file(str(tmp_path / 'a.tum'))
    np.testing.assert_allclose(other.positions_xyz[:, :2], path.poses[:, :2], atol=2e-6)
    save_tum(tmp_path / 'empty.tum', Trajectory.of([], []))
    assert len(load_tum(tmp_path / 'empty.tum')) == 0


def test_bad_input_is_named(tmp_path):
    with pytest.raises(EvaluationError, match='strictly increasing'):
        Trajectory(np.array([1.0, 1.0]), np.zeros((2, 3)))
    with pytest.raises(EvaluationError, match='not finite'):
        Trajectory(np.array([1.0]), np.full((1, 3), np.nan))
    with pytest.raises(EvaluationError, match='do not overlap'):
        trajectory_metrics(wander(1), Trajectory.of([1.0, 2.0], np.zeros((2, 3))))
    with pytest.raises(EvaluationError, match=r'2 stamps for 1 poses'):
        Trajectory.of([1.0, 2.0], np.zeros((1, 3)))
    (tmp_path / 'bad.tum').write_text('1 2 3\n')
    with pytest.raises(RecordingError, match='3 columns, expected 8'):
        load_tum(tmp_path / 'bad.tum')
    (tmp_path / 'bad.tum').write_text('one two\n')
    with pytest.raises(RecordingError, match=r'bad\.tum is not a TUM'):
        load_tum(tmp_path / 'bad.tum')


def test_position_errors_are_distances():
    errors = position_errors(np.array([[3.0, 4.0, 0.0]]), np.zeros((1, 3)))
    assert errors.tolist() == [5.0]
