"""Errors over relations: exact on exact poses, right on known errors, at any offset of time."""

import math

import numpy as np
import pytest

from explore_slam.errors import EvaluationError
from explore_slam.geometry import Pose2, between, compose
from explore_slam.results.relations import (
    LoggedOdometry,
    Relations,
    find_offset,
    relation_errors,
)

SECONDS = 120.0
LASER = Pose2(0.2, 0.1, 0.5)


def path_at(times):
    """True vehicle poses on a figure of eight."""
    phase = 2.0 * np.pi * times / 60.0
    x, y = 5.0 * np.sin(phase), 2.5 * np.sin(2.0 * phase)
    heading = np.arctan2(5.0 * np.cos(2.0 * phase), 5.0 * np.cos(phase))
    return np.column_stack([x, y, heading])


@pytest.fixture
def log():
    """Odometry at 10 Hz that turns too much, poses at irregular times, relations between."""
    random = np.random.default_rng(1)
    odometry_times = np.arange(0.0, SECONDS, 0.1)
    increments = between(path_at(odometry_times[:-1]), path_at(odometry_times[1:]))
    increments[:, 2] *= 1.01
    poses = [np.zeros(3)]
    for increment in increments:
        poses.append(compose(poses[-1], increment))
    times = np.sort(random.choice(odometry_times, 150, replace=False))
    ends = random.choice(odometry_times[5:-5], (200, 2))
    laser = compose(path_at(ends.ravel()), np.asarray(LASER)).reshape(200, 2, 3)
    relations = Relations(ends, between(laser[:, 0], laser[:, 1]))
    return times, LoggedOdometry(odometry_times, np.array(poses)), relations


def test_exact_poses_have_hardly_an_error(log):
    times, odometry, relations = log
    errors = relation_errors(relations, times, path_at(times), odometry, 0.0, LASER)
    assert errors.translation.max() < 0.02  # what odometry leaves between the poses
    assert math.degrees(errors.rotation.max()) < 1.0
    assert len(errors.translation) + errors.left_out == len(relations)


def test_a_scaled_trajectory_has_the_error_of_its_scale(log):
    times, odometry, relations = log
    poses = path_at(times)
    poses[:, :2] *= 1.1
    errors = relation_errors(relations, times, poses, odometry, 0.0, LASER)
    expected = 0.1 * np.hypot(
        *between(path_at(relations.times[:, 0]), path_at(relations.times[:, 1]))[:, :2].T
    )
    assert errors.translation.mean() == pytest.approx(expected.mean(), rel=0.03)


def test_the_pose_of_the_sensor_matters(log):
    times, odometry, relations = log
    errors = relation_errors(relations, times, path_at(times), odometry, 0.0)
    assert errors.translation.mean() > 0.1


def test_order_of_times_does_not_matter(log):
    times, odometry, relations = log
    shuffled = np.random.default_rng(2).permutation(len(odometry.times))
    mixed = LoggedOdometry(odometry.times[shuffled], odometry.poses[shuffled])
    back = slice(None, None, -1)
    one = relation_errors(relations, times, path_at(times), odometry, 0.0, LASER)
    other = relation_errors(relations, times[back], path_at(times)[back], mixed, 0.0, LASER)
    np.testing.assert_array_equal(one.translation, other.translation)


def test_figures_separate_loops(log):
    times, odometry, relations = log
    poses = path_at(times)
    poses[times > 60.0, 0] += 1.0  # a loop that was not closed
    errors = relation_errors(relations, times, poses, odometry, 0.0, LASER)
    figures = errors.figures()
    across = (relations.times < 60.0).sum(axis=1) == 1
    apart = np.abs(np.diff(relations.times, axis=1)[:, 0]) > 20.0
    assert figures['loops_m'] == pytest.approx((across & apart).sum() / apart.sum(), rel=0.05)
    assert figures['near_m'] < figures['translation_mean_m'] < figures['loops_m']


@pytest.mark.parametrize('offset', [0.0, 976052857.337, -3.2])
def test_the_offset_is_found(log, offset):
    times, odometry, relations = log
    moved = Relations(relations.times + offset, relations.poses)
    assert find_offset(moved, odometry, LASER) == pytest.approx(offset, abs=2e-3)
    found = find_offset(moved, odometry, LASER)
    errors = relation_errors(moved, times, path_at(times), odometry, found, LASER)
    assert errors.translation.max() < 0.02


def test_relations_of_another_log_are_refused(log):
    times, odometry, _ = log
    random = np.random.default_rng(3)
    other = Relations(random.uniform(0.0, 100.0, (300, 2)), np.zeros((300, 3)))
    with pytest.raises(EvaluationError, match='--offset'):
        find_offset(other, LoggedOdometry(random.uniform(0.0, 110.0, 300), np.zeros((300, 3))))
    longer = Relations(np.array([[0.0, 900.0]]), np.zeros((1, 3)))
    with pytest.raises(EvaluationError, match='not of this log'):
        find_offset(longer, odometry)
    with pytest.raises(EvaluationError, match='no usable times'):
        find_offset(longer, LoggedOdometry(np.full(5, np.nan), np.zeros((5, 3))))
    with pytest.raises(EvaluationError, match='none of 1 relations lies within'):
        relation_errors(
            Relations(np.array([[800.0, 900.0]]), np.zeros((1, 3))),
            times,
            path_at(times),
            odometry,
            0.0,
        )


def test_files_of_relations(tmp_path, recordings):
    (tmp_path / 'two').write_text('1 2 0.5 0.1 0 0 0 0.2\n3 4 1 0 0 0 0 -0.1\n')
    relations = Relations.load(tmp_path / 'two')
    np.testing.assert_array_equal(relations.times, [[1, 2], [3, 4]])
    np.testing.assert_array_equal(relations.poses, [[0.5, 0.1, 0.2], [1.0, 0.0, -0.1]])
    for content in ('', '1 2 3\n', '1 2 0 0 0 0 0 nan\n', 'a b c d e f g h\n'):
        (tmp_path / 'bad').write_text(content)
        with pytest.raises(EvaluationError, match='bad holds'):
            Relations.load(tmp_path / 'bad')
    assert len(Relations.load(recordings('carmen') / 'intel.relations')) == 2984
