"""Scratch memory that is taken where it is touched."""

import numpy as np
import pytest

from explore_slam.exploration.paths import SearchMemory, search_path
from explore_slam.exploration.sparse_memory import SparseArray


@pytest.mark.parametrize('size', [10, 2**22])
def test_values_are_zero_until_they_are_written_and_after_they_are_cleared(size):
    array = SparseArray(size, np.int32)
    assert array.values.shape == (size,)
    assert not array.values.any()
    array.values[[0, size // 2, size - 1]] = 7
    assert array.values.sum() == 21
    array.clear()
    assert not array.values.any()
    array.values[3] = 1
    assert array.values[3] == 1


def test_an_array_may_be_empty():
    assert SparseArray(0, np.float64).values.size == 0


def test_searches_are_the_same_with_memory_that_has_been_cleared():
    random = np.random.default_rng(0)
    costs = np.pad(
        random.uniform(1.0, 4.0, (30, 40)).astype(np.float32), 1, constant_values=np.inf
    )
    memory = SearchMemory()
    start = 5 * 42 + 3
    for _ in range(450):
        goal = int(random.integers(1, 31)) * 42 + int(random.integers(1, 41))
        cells, cost = search_path(costs, start, goal, memory)
        expected, price = search_path(costs, start, goal)
        assert cost == price
        assert cells.tolist() == expected.tolist()
