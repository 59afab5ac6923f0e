import numpy as np
import pytest

from explore_slam.geometry import to_world
from explore_slam.slam.graph import fuse_rows

FULL = [0, 1, 2, 1, 3, 4, 2, 4, 5]


def rows_of(graph, ids, draws, begin=0, end=None):
    stored = graph.observations_of(ids)
    out = np.full((len(ids), 9, draws.poses.shape[2]), np.nan)
    end = out.shape[2] if end is None else end
    node = stored.located(draws.keyframes)
    fuse_rows(stored.first, node, stored.z, stored.W, draws.poses, out, begin, end)
    return out


@pytest.fixture
def world(make_world):
    made = make_world(2, landmarks=15)
    made.circle(12)
    made.graph.optimize()
    return made


def test_rows_are_the_product_of_the_observations(world):
    draws = world.graph.draw(6, np.random.default_rng(0))
    ids = world.graph.landmarks()[0]
    rows = rows_of(world.graph, ids, draws)
    stored = world.graph.observations_of(ids)
    poses = dict(zip(draws.keyframes.tolist(), draws.poses, strict=True))
    for k in range(len(ids)):
        for m in (0, 5):
            information, vector = np.zeros((3, 3)), np.zeros(3)
            for o in range(stored.first[k], stored.first[k + 1]):
                pose = poses[int(stored.keyframes[o])][:, m]
                axes = to_world([0.0, 0.0, pose[2]], np.eye(3)).T
                W = axes @ stored.W[o][FULL].reshape(3, 3) @ axes.T
                information += W
                vector += W @ to_world(pose, stored.z[o][None])[0]
            covariance = np.linalg.inv(information)
            np.testing.assert_allclose(rows[k, :3, m], covariance @ vector, rtol=1e-9)
            packed = covariance.ravel()[[0, 1, 2, 4, 5, 8]]
            np.testing.assert_allclose(rows[k, 3:, m], packed, rtol=1e-7, atol=1e-12)


def test_parts_of_the_particles_give_the_same_bits(world):
    draws = world.graph.draw(10, np.random.default_rng(0))
    ids = world.graph.landmarks()[0]
    whole = rows_of(world.graph, ids, draws)
    first, second = (rows_of(world.graph, ids, draws, b, e) for b, e in ((0, 4), (4, 10)))
    np.testing.assert_array_equal(whole[:, :, :4], first[:, :, :4])
    np.testing.assert_array_equal(whole[:, :, 4:], second[:, :, 4:])
    assert np.isnan(first[:, :, 4:]).all()


def test_landmarks_of_the_optimum_are_fused_from_its_path(world):
    """Given the most likely path, the most likely landmarks follow from the observations."""
    draws = world.graph.draw(1, np.random.default_rng(0))
    ids, positions = world.graph.landmarks()
    np.testing.assert_allclose(rows_of(world.graph, ids, draws)[:, :3, 0], positions, atol=1e-5)


def test_landmarks_without_observations_have_empty_ranges(world):
    ids = world.graph.landmarks()[0]
    stored = world.graph.observations_of([10_000, int(ids[1]), 10_001])
    assert stored.first[0] == stored.first[1] == 0
    assert stored.first[2] == stored.first[3] == len(stored.z) > 0
