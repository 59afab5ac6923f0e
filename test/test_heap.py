"""The binary heap of kernels, against heapq."""

import heapq

import numpy as np
import pytest

from explore_slam.heap import push, remove_first


@pytest.mark.parametrize('dtype', [np.float64, np.float32])
@pytest.mark.parametrize('seed', range(4))
def test_items_come_out_by_key_as_from_heapq(dtype, seed):
    generator = np.random.default_rng(seed)
    keys, items = np.empty(500, dtype), np.empty(500, np.int64)
    size, expected, found = 0, [], []
    for number in range(500):
        key = dtype(generator.integers(0, 10**6) / 7.0)
        push(keys, items, size, key, number)
        heapq.heappush(expected, (key, number))
        size += 1
        while size and generator.random() < 0.4:
            first = heapq.heappop(expected)
            found.append((keys[0], items[0]))
            assert found[-1] == first
            size -= 1
            remove_first(keys, items, size)
    assert len(found) > 150
    assert sorted(keys[:size]) == sorted(key for key, _ in expected)


def test_equal_keys_lose_no_item():
    keys, items = np.empty(9), np.empty(9, np.int64)
    for size in range(9):
        push(keys, items, size, 1.0, size)
    found = set()
    for size in range(8, -1, -1):
        found.add(int(items[0]))
        remove_first(keys, items, size)
    assert found == set(range(9))
