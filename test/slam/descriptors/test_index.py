import numpy as np
import pytest

from explore_slam.slam.descriptors.index import BruteForceIndex
from explore_slam.slam.descriptors.kd_forest import BUCKET, KdForestIndex
from explore_slam.slam.descriptors.kd_tree import KdTreeIndex

INDICES = [BruteForceIndex, KdTreeIndex, KdForestIndex]


def like_sift(random, count):
    rows = random.gamma(0.3, 1.0, (count, 128))
    rows = np.minimum(rows / np.linalg.norm(rows, axis=1, keepdims=True), 0.2)
    return (rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float32)


def near(random, rows, deviation):
    moved = rows + deviation * random.standard_normal(rows.shape)
    return (moved / np.linalg.norm(moved, axis=1, keepdims=True)).astype(np.float32)


@pytest.mark.parametrize('index_type', INDICES)
def test_nearest_within_the_radius_come_first(index_type):
    random = np.random.default_rng(0)
    rows = like_sift(random, 3)
    index = index_type(128)
    index.add(np.array([4, 9, 2]), rows)
    ids, distances = index.query(rows[1:2], 4.0, 4)
    exact = ((rows - rows[1]) ** 2).sum(axis=1)
    order = np.argsort(exact)
    assert ids[0].tolist() == [*np.array([4, 9, 2])[order], -1]
    np.testing.assert_allclose(distances[0, :3], exact[order], atol=1e-5)
    assert np.isinf(distances[0, 3])
    ids, _ = index.query(rows[1:2], 0.0, 2)
    assert ids[0].tolist() == [9, -1]


@pytest.mark.parametrize('index_type', INDICES)
def test_removed_ids_are_not_found_and_can_be_given_again(index_type):
    random = np.random.default_rng(1)
    rows = like_sift(random, 300)
    index = index_type(128)
    index.add(np.arange(300), rows)
    index.remove(np.arange(0, 300, 2))
    ids, _ = index.query(rows, 0.0, 1)
    assert (ids[::2] == -1).all()
    assert (ids[1::2, 0] == np.arange(1, 300, 2)).all()
    fresh = like_sift(random, 1)
    index.add(np.array([0]), fresh)
    assert index.query(fresh, 0.0, 1)[0][0, 0] == 0


@pytest.mark.parametrize('index_type', INDICES)
def test_many_equal_descriptors_are_all_kept(index_type):
    index = index_type(128)
    row = like_sift(np.random.default_rng(2), 1)
    index.add(np.arange(100), np.repeat(row, 100, axis=0))
    ids, _ = index.query(row, 0.0, 100)
    assert sorted(ids[0].tolist()) == list(range(100))


def test_kd_tree_equals_brute_force_while_it_grows():
    random = np.random.default_rng(3)
    tree, brute = KdTreeIndex(128), BruteForceIndex(128)
    for begin in range(0, 600, 50):
        rows = like_sift(random, 50)
        for index in (tree, brute):
            index.add(np.arange(begin, begin + 50), rows)
        queries = near(random, rows, 0.05)
        for a, b in zip(tree.query(queries, 0.5, 3), brute.query(queries, 0.5, 3), strict=True):
            np.testing.assert_allclose(a, b, atol=1e-5)


def test_recall_of_the_forest_against_brute_force():
    random = np.random.default_rng(4)
    rows = like_sift(random, 5000)
    forest, brute = KdForestIndex(128), BruteForceIndex(128)
    for begin in range(0, 5000, 100):
        ids = np.arange(begin, begin + 100)
        forest.add(ids, rows[ids])
        brute.add(ids, rows[ids])
    queries = near(random, rows[random.choice(5000, 300)], 0.04)
    found, _ = forest.query(queries, 0.4, 1)
    exact, _ = brute.query(queries, 0.4, 1)
    assert np.mean(found == exact) >= 0.98


def test_every_vector_lies_in_the_leaf_that_its_descent_ends_in():
    rows = like_sift(np.random.default_rng(6), 1000)
    tree = KdForestIndex(128, checks=BUCKET, trees=1)  # one leaf is compared
    tree.add(np.arange(1000), rows)
    found, _ = tree.query(rows, 1e-3, 1)
    np.testing.assert_array_equal(found[:, 0], np.arange(1000))


def test_the_same_insertions_make_the_same_forest():
    rows = like_sift(np.random.default_rng(5), 500)
    a, b = KdForestIndex(128), KdForestIndex(128)
    for index in (a, b):
        index.add(np.arange(500), rows)
    np.testing.assert_array_equal(a.nodes, b.nodes)
    np.testing.assert_array_equal(a.buckets, b.buckets)
