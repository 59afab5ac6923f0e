"""Conditioning on an inter-robot observation against plain NumPy."""

import math

import numpy as np
import pytest

from explore_slam.data import InterRobotObservation
from explore_slam.slam import FastSlamConfig
from explore_slam.slam.update.inter_robot import _GATE, condition_on_observation

M = 7
WEIGHTS = np.arange(1.0, M + 1.0) / np.arange(1.0, M + 1.0).sum()


def rotation(heading):
    c, s = math.cos(heading), math.sin(heading)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def spd(random, scale, size):
    A = scale * random.standard_normal((size, size))
    return A @ A.T + 0.2 * scale**2 * np.eye(size)


class Meeting:
    """Two vehicles about 3 m apart whose errors are correlated among their coordinates."""

    def __init__(self, seed, error=(0.0, 0.0)):
        random = np.random.default_rng(seed)
        self.observer = random.normal(0.0, 0.05, (M, 3)) + [1.0, 2.0, 0.7]
        self.target = random.normal(0.0, 0.05, (M, 3)) + [3.5, 3.0, -1.2]
        self.P, self.Q = spd(random, 0.1, 3), spd(random, 0.2, 3)
        R = spd(random, 0.05, 2)
        position = rotation(-0.7)[:2, :2] @ [2.5, 1.0] + [0.05, -0.08] + np.array(error)
        self.observation = InterRobotObservation(0.0, 'b', position, R)

    def condition(self, normals=None):
        """Return observer, target, log-likelihoods and the covariance that remains."""
        observer, target = self.observer.copy(), self.target.copy()
        found = condition_on_observation(
            (observer, self.P), (target, self.Q), self.observation, FastSlamConfig(),
            np.zeros((M, 3)) if normals is None else normals, WEIGHTS,
        )  # fmt: skip
        return observer, target, *found

    def model(self, m):
        """Return innovation (2,) and the Jacobians (2, 3) of both vehicles, in their frames."""
        turn = rotation(self.observer[m, 2])[:2, :2].T
        expected = turn @ (self.target[m, :2] - self.observer[m, :2])
        first = np.array([[-1.0, 0.0, expected[1]], [0.0, -1.0, -expected[0]]])
        second = np.zeros((2, 3))
        second[:, :2] = rotation(self.target[m, 2] - self.observer[m, 2])[:2, :2]
        return self.observation.position - expected, first, second


@pytest.mark.parametrize('seed', range(3))
def test_both_poses_are_conditioned_as_by_the_dense_filter(seed):
    meeting = Meeting(seed)
    observer, target, log_likelihoods, remaining = meeting.condition()
    P, Q, R = meeting.P, meeting.Q, meeting.observation.covariance
    expected = np.zeros((3, 3))
    for m in range(M):
        nu, first, second = meeting.model(m)
        S = first @ P @ first.T + second @ Q @ second.T + R
        delta = P @ first.T @ np.linalg.solve(S, nu)
        moved = meeting.observer[m] + rotation(meeting.observer[m, 2]) @ delta
        np.testing.assert_allclose(observer[m], moved, atol=1e-12)
        left = second @ Q @ second.T + R
        gain = Q @ second.T @ np.linalg.inv(left)
        delta = gain @ (nu - first @ delta)
        moved = meeting.target[m] + rotation(meeting.target[m, 2]) @ delta
        np.testing.assert_allclose(target[m], moved, atol=1e-12)
        expected += WEIGHTS[m] * (Q - gain @ second @ Q)
        cost = nu @ np.linalg.solve(S, nu) + np.linalg.slogdet(S)[1]
        assert log_likelihoods[m] == pytest.approx(-0.5 * cost)
    np.testing.assert_allclose(remaining, expected, atol=1e-12)


def test_observers_are_sampled_from_their_posterior():
    meeting, random = Meeting(5), np.random.default_rng(1)
    meeting.observer[:], meeting.target[:] = meeting.observer[0], meeting.target[0]
    samples = np.concatenate(
        [meeting.condition(random.standard_normal((M, 3)))[0] for _ in range(2000)]
    )
    _, first, second = meeting.model(0)
    P, S = meeting.P, meeting.observation.covariance + second @ meeting.Q @ second.T
    posterior = np.linalg.inv(np.linalg.inv(P) + first.T @ np.linalg.solve(S, first))
    turn = rotation(meeting.observer[0, 2])
    np.testing.assert_allclose(np.cov(samples.T), turn @ posterior @ turn.T, rtol=0.1, atol=2e-4)


def test_gross_errors_move_nothing_and_cost_as_much_as_one_at_the_gate():
    far, farther = Meeting(2, (9.0, 0.0)), Meeting(2, (90.0, 0.0))
    observer, target, log_likelihoods, remaining = far.condition()
    np.testing.assert_array_equal(observer, far.observer)
    np.testing.assert_array_equal(target, far.target)
    np.testing.assert_allclose(remaining, far.Q, atol=1e-12)
    np.testing.assert_array_equal(log_likelihoods, farther.condition()[2])


def test_residuals_beyond_the_threshold_move_the_poses_less():
    """A residual d counts with the covariance R d²/t²."""
    meeting = Meeting(3, (1.2, 0.0))
    threshold = FastSlamConfig().outlier_threshold
    nu, first, second = meeting.model(0)
    P, Q, R = meeting.P, meeting.Q, meeting.observation.covariance
    projected = first @ P @ first.T + second @ Q @ second.T
    square = nu @ np.linalg.solve(projected + R, nu)
    assert threshold**2 < square < _GATE**2
    S = projected + R * square / threshold**2
    delta = P @ first.T @ np.linalg.solve(S, nu)
    moved = meeting.observer[0] + rotation(meeting.observer[0, 2]) @ delta
    np.testing.assert_allclose(meeting.condition()[0][0], moved, atol=1e-12)
