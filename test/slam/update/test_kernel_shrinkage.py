"""Kernel shrinkage keeps mean and covariance over all particles, and particles effective."""

import numpy as np
import pytest

from explore_slam.geometry import Pose2
from explore_slam.slam.update.kernel_shrinkage import shrink

PARTICLES = 500


def cloud(random):
    """Return rows (2, 9, M) of two landmarks, poses (M, 3) and weights (M,)."""
    poses = random.normal(0.0, [0.3, 0.3, 0.5], (PARTICLES, 3))
    rows = np.zeros((2, 9, PARTICLES))
    rows[:, :3] = random.normal(0.0, 0.2, (2, 3, PARTICLES)) + np.array([[[3.0], [1.0], [0.5]]])
    rows[:, 3] = rows[:, 6] = rows[:, 8] = 0.01
    rows[1, 3, :100] = 0.0  # does not exist there
    weights = random.exponential(size=PARTICLES)
    return rows, poses, weights / weights.sum()


def seen(rows, poses, n):
    """Return places (M, 3) and covariances (M, 3, 3) of a landmark in the vehicle frames."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    zero, one = np.zeros_like(c), np.ones_like(c)
    turn = np.array([[c, s, zero], [-s, c, zero], [zero, zero, one]]).transpose(2, 0, 1)
    off = rows[n, :3].T - np.c_[poses[:, :2], zero]
    covariance = rows[n, 3:].T[:, [[0, 1, 2], [1, 3, 4], [2, 4, 5]]]
    return np.einsum('mij,mj->mi', turn, off), turn @ covariance @ turn.transpose(0, 2, 1)


def moments(rows, poses, weights, n):
    """Return mean and covariance of a landmark over all particles that have it."""
    there = rows[n, 3] > 0.0
    places, covariances = seen(rows, poses, n)
    w = weights[there] / weights[there].sum()
    mean = w @ places[there]
    off = places[there] - mean
    return mean, np.einsum('m,mi,mj->ij', w, off, off) + np.einsum('m,mij', w, covariances[there])


@pytest.mark.parametrize('part', [0.01, 0.3])
def test_mean_and_covariance_over_the_particles_stay(part):
    rows, poses, weights = cloud(np.random.default_rng(4))
    after = np.empty_like(rows)
    shrink(rows, poses, weights, part, after)
    for n in range(2):
        for one, other in zip(
            moments(rows, poses, weights, n), moments(after, poses, weights, n), strict=True
        ):
            np.testing.assert_allclose(one, other, atol=1e-12)
    spread = [np.ptp(seen(item, poses, 0)[0], axis=0) for item in (rows, after)]
    np.testing.assert_allclose(spread[1], np.sqrt(1.0 - part) * spread[0])
    np.testing.assert_array_equal(after[1, :, :100], rows[1, :, :100])


def test_a_late_return_leaves_particles(make_world, make_slam):
    """The heading drifts while a vehicle turns round; then it sees what it saw at the start."""
    effective = {0.0: [], 0.4: []}
    for least, sizes in effective.items():
        for seed in range(3):
            world = make_world(seed=seed, deviation=0.002)
            slam = make_slam(world.start(a=Pose2(3.0, 3.0, 0.0)), shrinkage_threshold=least)
            turn = Pose2(0.0, 0.0, np.pi / 8)
            for step in range(17):
                noise = 1e-8 if step == 0 else 0.02**2
                world.drive('a', turn)
                slam.predict('a', turn, noise * np.eye(3))
                sizes.append(slam.update('a', world.see('a', float(step))).effective_particles)
    assert min(effective[0.0]) < 40.0
    assert min(effective[0.4]) > 1.5 * min(effective[0.0])
