"""The kernels against plain NumPy: one linear-Gaussian model of pose and landmarks."""

import math

import numpy as np
import pytest

from explore_slam.slam.association.state import Associations, CandidateRows, Observed
from explore_slam.slam.storage.row_format import UPPER_TRIANGLE, packed
from explore_slam.slam.update.landmark_update import (
    fill_absent,
    insert_landmarks,
    update_landmarks,
)
from explore_slam.slam.update.proposal import (
    ProposalInputs,
    ProposalParameters,
    Proposals,
    propose,
    sample_proposals,
)

M = 45


def spd(random, scale, size=3):
    A = random.standard_normal((size, size)) * scale
    return A @ A.T + 0.3 * scale**2 * np.eye(size)


def rotation(heading):
    c, s = math.cos(heading), math.sin(heading)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


class Scene:
    """K observations of K landmarks whose rows differ from particle to particle."""

    def __init__(self, K=6, seed=0, outlier=False):
        random = np.random.default_rng(seed)
        self.K = K
        self.poses = random.normal(0.0, 0.02, (M, 3)) + [1.0, 2.0, 0.7]
        self.z = np.c_[random.uniform(1, 3, K), random.uniform(-1, 1, K), random.uniform(0, 1, K)]
        self.R = np.array([spd(random, 0.03) for _ in range(K)])
        self.rows = np.zeros((K, 9, M))
        self.means = np.empty((K, M, 3))
        self.covariances = np.empty((K, M, 3, 3))
        for k in range(K):
            point = self.poses.mean(0) * [1, 1, 0] + rotation(0.7) @ self.z[k]
            for m in range(M):
                self.means[k, m] = point + random.normal(0, 0.02, 3)
                self.covariances[k, m] = spd(random, 0.02)
                self.rows[k, :3, m] = self.means[k, m]
                self.rows[k, 3:, m] = self.covariances[k, m][UPPER_TRIANGLE]
        if outlier:
            self.z[0] += [0.25, -0.2, 0.0]
        self.P = spd(random, 0.03) * np.array([[1, 1, 0.4], [1, 1, 0.4], [0.4, 0.4, 0.16]])
        self.chosen = Associations.undecided(K, M)
        self.candidates = np.arange(K)[:, None]
        self.shared = np.zeros(K, bool)

    @property
    def observed(self):
        return Observed(self.z, packed(self.R))

    @property
    def candidate_rows(self):
        distances = np.zeros(self.candidates.shape)
        return CandidateRows(self.rows, np.arange(self.K), self.candidates, distances, self.shared)

    def propose(self, normals, threshold=1e3, gate=1e6, end=M):
        poses = self.poses.copy()
        proposals = Proposals(np.zeros((M, 3)), np.zeros((M, 6)), np.zeros(M))
        parameters = ProposalParameters(gate, 0.0, threshold**2, 1.0, self.P)
        inputs = ProposalInputs(
            self.candidate_rows, self.observed, self.observed, parameters, poses
        )
        propose(inputs, 0, end, proposals, self.chosen)
        sample_proposals(proposals.means, proposals.covariances, normals, poses)
        return poses, proposals.log_likelihoods


def stacked(scene, m, delta):
    """Residual and Jacobian of all observations at the pose moved by delta (predicted frame)."""
    G = rotation(scene.poses[m, 2])
    pose = scene.poses[m] + G @ delta
    nu, H, S = [], [], []
    for k in range(scene.K):
        turn = rotation(pose[2]).T
        expected = turn @ (scene.means[k, m] - [pose[0], pose[1], 0.0])
        nu.append(scene.z[k] - expected)
        h = np.zeros((3, 3))
        h[:, :2] = -(turn @ G)[:, :2]
        h[:, 2] = [expected[1], -expected[0], 0.0]
        H.append(h)
        S.append(turn @ scene.covariances[k, m] @ turn.T + scene.R[k])
    dense = np.zeros((3 * scene.K, 3 * scene.K))
    for k in range(scene.K):
        dense[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = S[k]
    return np.concatenate(nu), np.concatenate(H), dense


def test_proposal_and_likelihood_equal_the_dense_filter():
    scene = Scene()
    poses, log_weights = scene.propose(np.zeros((M, 3)))
    expected = []
    for m in range(M):
        delta = np.zeros(3)
        for _ in range(2):
            nu, H, S = stacked(scene, m, delta)
            nu = nu + H @ delta
            T = H @ scene.P @ H.T + S
            delta = scene.P @ H.T @ np.linalg.solve(T, nu)
        np.testing.assert_allclose(
            poses[m], scene.poses[m] + rotation(scene.poses[m, 2]) @ delta, atol=1e-9
        )
        expected.append(-0.5 * (nu @ np.linalg.solve(T, nu) + np.linalg.slogdet(T)[1]))
    off = log_weights - np.array(expected)
    np.testing.assert_allclose(off, off[0], atol=1e-8)


@pytest.mark.parametrize('seed', range(3))
def test_association_equals_brute_force_with_a_correlated_motion(seed):
    """Each observation takes the landmark of least d² + ln|S| that is left for it."""
    scene = Scene(seed=seed)
    random = np.random.default_rng(seed)
    scene.P = spd(random, 0.2)
    shift = 0.12 * random.standard_normal((scene.K, 3))
    for k in range(scene.K):  # all of them are near each other
        scene.means[k] += scene.means[0].mean(0) - scene.means[k].mean(0) + shift[k]
        scene.rows[k, :3] = scene.means[k].T
    scene.z = scene.z[:1] + 0.12 * random.standard_normal((scene.K, 3))
    scene.candidates = np.tile(np.arange(scene.K), (scene.K, 1))
    scene.shared[:] = True
    scene.propose(np.zeros((M, 3)))
    for m in range(M):
        turn, left = rotation(scene.poses[m, 2]).T, set(range(scene.K))
        for k in range(scene.K):
            scores = {}
            for j in left:
                expected = turn @ (scene.means[j, m] - [*scene.poses[m, :2], 0.0])
                H = np.array([[-1.0, 0.0, expected[1]], [0.0, -1.0, -expected[0]], [0, 0, 0]])
                S = H @ scene.P @ H.T + turn @ scene.covariances[j, m] @ turn.T + scene.R[k]
                off = scene.z[k] - expected
                scores[j] = off @ np.linalg.solve(S, off) + np.linalg.slogdet(S)[1]
            best = min(scores, key=scores.get)
            assert scene.chosen.choice[k, m] == best
            left.remove(best)


def test_samples_have_the_posterior_covariance():
    scene = Scene()
    scene.poses[:] = scene.poses[0]
    scene.rows[:] = scene.rows[:, :, :1]
    scene.means[:] = scene.means[:, :1]
    scene.covariances[:] = scene.covariances[:, :1]
    random = np.random.default_rng(0)
    samples = np.concatenate(
        [scene.propose(random.standard_normal((M, 3)))[0] for _ in range(200)]
    )
    _, H, S = stacked(scene, 0, np.zeros(3))
    posterior = np.linalg.inv(np.linalg.inv(scene.P) + H.T @ np.linalg.solve(S, H))
    G = rotation(scene.poses[0, 2])
    np.testing.assert_allclose(np.cov(samples.T), G @ posterior @ G.T, rtol=0.1, atol=2e-6)


def test_exact_motion_stays_exact():
    scene = Scene()
    scene.P = np.zeros((3, 3))
    poses, log_weights = scene.propose(np.ones((M, 3)))
    np.testing.assert_array_equal(poses, scene.poses)
    assert np.isfinite(log_weights).all()


def test_an_outlier_loses_weight_and_hardly_moves_the_pose():
    clean, _ = Scene(seed=3).propose(np.zeros((M, 3)), threshold=3.0)
    scene = Scene(seed=3, outlier=True)
    robust, _ = scene.propose(np.zeros((M, 3)), threshold=3.0)
    naive, _ = Scene(seed=3, outlier=True).propose(np.zeros((M, 3)))
    assert scene.chosen.robust_weight[0].mean() < 0.3
    assert (scene.chosen.robust_weight[1:] > 0.6).mean() > 0.9
    shift = np.abs(robust - clean).mean()
    assert shift < 0.5 * np.abs(naive - clean).mean()


def test_gated_and_absent_landmarks_are_not_taken():
    scene = Scene()
    scene.rows[1, :, 7] = 0.0
    scene.rows[2, 0, 9] += 5.0
    poses, _ = scene.propose(np.zeros((M, 3)), threshold=3.0, gate=4.5**2)
    assert scene.chosen.choice[1, 7] == -1
    assert scene.chosen.choice[2, 9] == -1
    assert scene.chosen.choice[0].min() == 0
    assert np.isfinite(poses).all()


def test_each_particle_takes_its_own_candidate_once():
    scene = Scene(K=2)
    scene.rows[1] = scene.rows[0]
    scene.rows[1, 0, ::2] += 0.05
    scene.rows[0, 0, 1::2] += 0.05
    scene.z[1] = scene.z[0]
    scene.R[1] = scene.R[0]
    scene.candidates = np.array([[0, 1], [0, 1]])
    scene.shared = np.ones(2, bool)
    scene.P = 1e-6 * np.eye(3)
    scene.propose(np.zeros((M, 3)), threshold=3.0)
    assert set(scene.chosen.choice[0]) == {0, 1}
    assert (scene.chosen.choice[1] == 1 - scene.chosen.choice[0]).all()


def test_any_split_of_the_particles_gives_the_same_bits():
    normals = np.random.default_rng(1).standard_normal((M, 3))
    whole, weights = Scene().propose(normals, 3.0, 20.0)
    first, first_weights = Scene().propose(normals, 3.0, 20.0, end=32)
    np.testing.assert_array_equal(whole[:32], first[:32])
    np.testing.assert_array_equal(weights[:32], first_weights[:32])


@pytest.mark.parametrize('weight', [1.0, 0.25])
def test_landmark_update_equals_the_kalman_filter(weight):
    scene = Scene()
    scene.chosen.choice[:] = 0
    scene.chosen.choice[2, 5] = -1
    before = scene.rows.copy()
    scene.chosen.robust_weight[:] = weight
    update_landmarks(scene.candidate_rows, scene.observed, scene.chosen, scene.poses, 0, M)
    for k, m in ((0, 0), (3, 17), (5, 44)):
        T = rotation(scene.poses[m, 2]).T
        A, R = scene.covariances[k, m], scene.R[k] / weight
        gain = A @ T.T @ np.linalg.inv(T @ A @ T.T + R)
        nu = scene.z[k] - T @ (scene.means[k, m] - [*scene.poses[m, :2], 0.0])
        np.testing.assert_allclose(scene.rows[k, :3, m], scene.means[k, m] + gain @ nu)
        np.testing.assert_allclose(
            scene.rows[k, 3:, m], (A - gain @ T @ A)[UPPER_TRIANGLE], rtol=1e-6, atol=1e-12
        )
    np.testing.assert_array_equal(scene.rows[2, :, 5], before[2, :, 5])


def test_new_landmarks_lie_where_they_are_seen():
    scene = Scene(K=1)
    where = np.arange(M)[None] % 2 == 0
    block = np.zeros((1, 9, M))
    insert_landmarks(block, np.array([0]), scene.observed, where, scene.poses)
    T = rotation(scene.poses[4, 2])
    np.testing.assert_allclose(block[0, :3, 4], T @ scene.z[0] + [*scene.poses[4, :2], 0.0])
    np.testing.assert_allclose(block[0, 3:, 4], (T @ scene.R[0] @ T.T)[UPPER_TRIANGLE])
    assert (block[0, :, 1::2] == 0.0).all()


def test_a_landmark_that_particles_lack_is_filled_in_there_and_once():
    scene = Scene(K=2)
    scene.rows[0, :, :20] = 0.0
    before = scene.rows.copy()
    wanted = np.zeros((2, M), bool)
    wanted[:, :30] = True
    scene.candidates = np.array([[-1, 0], [0, -1]])
    filled = fill_absent(scene.candidate_rows, scene.observed, scene.poses, wanted)
    assert filled.tolist() == [True, False]
    assert not wanted[0, :20].any()
    assert wanted[0, 20:30].all()
    assert wanted[1, :30].all()
    np.testing.assert_array_equal(scene.rows[:, :, 20:], before[:, :, 20:])
    T = rotation(scene.poses[4, 2])
    place = T @ scene.z[0] + [*scene.poses[4, :2], 0.0]
    np.testing.assert_allclose(scene.rows[0, :3, 4], place)


@pytest.mark.parametrize('K', [32, 300])
def test_likelihood_of_many_new_landmarks_seen_again_far_more_exactly(K):
    """|S| / |2R| of one is above 10¹¹: their product, 10³³⁰⁰ for 300 of them, is no double."""
    scene = Scene(K)
    scene.R /= 100.0**2
    random = np.random.default_rng(1)
    scene.covariances = np.array([[spd(random, 0.3) for _ in range(M)] for _ in range(K)])
    scene.rows[:, 3:] = scene.covariances[:, :, *UPPER_TRIANGLE].transpose(0, 2, 1)
    _, log_weights = scene.propose(np.zeros((M, 3)))
    off = []
    for m in (0, 17, 44):
        delta = np.zeros(3)
        for _ in range(2):
            nu, H, S = stacked(scene, m, delta)
            nu = nu + H @ delta
            T = H @ scene.P @ H.T + S
            delta = scene.P @ H.T @ np.linalg.solve(T, nu)
        off.append(log_weights[m] + 0.5 * (nu @ np.linalg.solve(T, nu) + np.linalg.slogdet(T)[1]))
    np.testing.assert_allclose(off, off[0], atol=1e-6)


@pytest.mark.parametrize('K', [11, 40, 300])
def test_likelihood_of_many_outliers(K):
    """Weights below 1/500: 300 of them multiply to less than any double."""
    scene = Scene(K)
    scene.P = np.zeros((3, 3))
    scene.z += np.random.default_rng(2).choice([-3.0, 3.0], scene.z.shape)
    t2 = 1.5**2
    _, log_weights = scene.propose(np.zeros((M, 3)), threshold=1.5)
    costs = []
    for m in range(M):
        nu, _, S = stacked(scene, m, np.zeros(3))
        blocks = [slice(3 * k, 3 * k + 3) for k in range(K)]
        squares = np.array([nu[b] @ np.linalg.solve(S[b, b], nu[b]) for b in blocks])
        assert squares.min() > 500.0 * t2
        log_determinants = sum(np.linalg.slogdet(S[b, b])[1] for b in blocks)
        costs.append(np.sum(t2 * (1.0 + np.log(squares / t2))) + log_determinants)
    off = log_weights + 0.5 * np.array(costs)
    np.testing.assert_allclose(off, off[0], atol=1e-6)
