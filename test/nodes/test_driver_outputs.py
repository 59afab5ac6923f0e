"""Latencies and charge of the battery as the driver reports them."""

import math

import pytest

from explore_slam.nodes.driver_outputs import Latency, battery_charge


def test_latencies_are_summarized_in_milliseconds():
    latency = Latency()
    assert latency.summary() == {}
    for value in range(101):
        latency.add(0.001 * value)
    assert latency.summary() == pytest.approx({'latency_median_ms': 50.0, 'latency_p99_ms': 99.0})
    for _ in range(200):  # only the newest count
        latency.add(0.5)
    assert latency.summary()['latency_median_ms'] == pytest.approx(500.0)


@pytest.mark.parametrize(
    ('voltage', 'nominal', 'charge'),
    [
        (11.9, 0.0, 0.5), (23.8, 0.0, 0.5), (12.8, 12.0, 1.0), (22.0, 24.0, 0.0),
        (17.85, 18.0, 0.5), (14.4, 0.0, 1.0), (28.8, 0.0, 1.0),
    ],
)  # fmt: skip
def test_the_charge_of_batteries_of_12_and_24_volts(voltage, nominal, charge):
    assert battery_charge(voltage, nominal) == pytest.approx(charge)


def test_no_voltage_is_no_charge():
    assert math.isnan(battery_charge(0.0))
