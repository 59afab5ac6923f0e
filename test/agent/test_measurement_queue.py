"""The queue of waiting measurements: order, capacity."""

import math
from typing import NamedTuple

import pytest

from explore_slam.agent.measurement_queue import MeasurementQueue


class Record(NamedTuple):
    stamp: float
    name: str


def test_measurements_come_out_by_stamp_and_ties_by_arrival():
    queue = MeasurementQueue()
    for stamp, name in ((2.0, 'late'), (1.0, 'b'), (1.0, 'a'), (0.5, 'first')):
        assert not queue.push(Record(stamp, name), 10)
    assert (len(queue), queue.first) == (4, 0.5)
    assert [queue.pop().name for _ in range(4)] == ['first', 'b', 'a', 'late']
    assert (len(queue), queue.first) == (0, math.inf)


def test_beyond_the_capacity_the_oldest_is_dropped():
    queue = MeasurementQueue()
    assert [queue.push(Record(stamp, ''), 2) for stamp in (1.0, 2.0, 3.0)] == [False, False, True]
    assert [queue.pop().stamp for _ in range(2)] == [2.0, 3.0]


def test_an_empty_queue_has_nothing_to_pop():
    queue = MeasurementQueue()
    queue.push(Record(1.0, ''), 2)
    queue.clear()
    with pytest.raises(IndexError):
        queue.pop()
