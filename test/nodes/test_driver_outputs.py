"""Latencies as the driver reports them."""

import pytest

from explore_slam.nodes.driver_outputs import Latency


def test_latencies_are_summarized_in_milliseconds():
    latency = Latency()
    assert latency.summary() == {}
    for value in range(101):
        latency.add(0.001 * value)
    assert latency.summary() == pytest.approx({'latency_median_ms': 50.0, 'latency_p99_ms': 99.0})
    for _ in range(200):  # only the newest count
        latency.add(0.5)
    assert latency.summary()['latency_median_ms'] == pytest.approx(500.0)
