import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import ndtr

from explore_slam.slam.particles.resampling import (
    effective_particles,
    normalized,
    stratified_normals,
    systematic_ancestors,
)


@given(st.lists(st.floats(0.0, 10.0), min_size=1, max_size=60), st.floats(0.0, 0.999))
def test_systematic_resampling_is_proportional_and_ordered(raw, offset):
    weights = np.array(raw) + 1e-9
    weights /= weights.sum()
    ancestors = systematic_ancestors(weights, offset)
    assert (np.diff(ancestors) >= 0).all()
    counts = np.bincount(ancestors, minlength=len(weights))
    assert (np.abs(counts - weights * len(weights)) < 1.0 + 1e-9).all()


def test_effective_particles_of_equal_and_of_single_weights():
    assert effective_particles(np.full(50, 0.02)) == pytest.approx(50)
    assert effective_particles(np.array([1.0, 0.0, 0.0])) == pytest.approx(1)


def test_normalized_survives_weights_beyond_the_range_of_floats():
    logs, weights = normalized(np.array([-5000.0, -5001.0, -6000.0]))
    assert weights.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(np.exp(logs), weights)


def test_stratified_normals_cover_every_dimension_evenly():
    normals = stratified_normals(np.random.default_rng(0), 400, 3)
    assert normals.shape == (400, 3)
    assert np.abs(normals.mean(axis=0)).max() < 0.01
    np.testing.assert_allclose(normals.std(axis=0), 1.0, atol=0.02)
    assert np.abs(np.corrcoef(normals.T) - np.eye(3)).max() < 0.15
    assert np.isfinite(stratified_normals(np.random.default_rng(0), 1, 2)).all()


def test_neighbours_get_normals_from_all_parts_of_the_distribution():
    normals = stratified_normals(np.random.default_rng(0), 400, 3)
    octants = np.floor(8 * ndtr(normals)).reshape(50, 8, 3)
    np.testing.assert_array_equal(
        np.sort(octants, axis=1)[:, :, 0], np.tile(np.arange(8), (50, 1))
    )
    assert stratified_normals(np.random.default_rng(0), 13, 2).shape == (13, 2)
