"""Batteries: limits in V or as a share, dips, noise, recovery, chargers."""

import math

import pytest

from explore_slam.battery import BatteryConfig, BatteryMonitor
from explore_slam.data import BatteryLevel, BatteryReading
from explore_slam.errors import ConfigError

OK, LOW, CRITICAL = BatteryLevel
VOLTS = BatteryConfig(battery_low=11.5, battery_critical=11.0)
SHARES = BatteryConfig(battery_low=0.25, battery_critical=0.1)


def feed(monitor, seconds, start, *values, field='voltage', **others):
    """Add readings at 10 Hz that take the values in turn; return the time (s) of each change."""
    changes = []
    for step in range(round(10 * seconds)):
        now = start + 0.1 * step
        reading = BatteryReading(**{field: values[step % len(values)]}, **others)
        if monitor.add(reading, now):
            changes.append(pytest.approx(now))
    return changes


def test_levels_follow_after_five_seconds_below_the_limit():
    monitor = BatteryMonitor(VOLTS)
    assert feed(monitor, 10.0, 0.0, 12.4) == []
    assert (monitor.level, monitor.warning) == (OK, '')
    assert feed(monitor, 10.0, 10.0, 11.4) == [15.0]
    assert monitor.level is LOW
    assert monitor.warning == 'battery low: 11.4 V, battery_low is 11.5 V'
    assert feed(monitor, 10.0, 20.0, 10.9) == [25.0]
    assert monitor.level is CRITICAL
    assert monitor.warning == 'battery critical: 10.9 V, battery_critical is 11.0 V'


def test_shares():
    monitor = BatteryMonitor(SHARES)
    assert feed(monitor, 6.0, 0.0, 0.24, field='share') == [5.0]
    assert monitor.warning == 'battery low: 24%, battery_low is 25%'
    assert feed(monitor, 6.0, 6.0, 0.05, field='share') == [11.0]
    assert monitor.level is CRITICAL


def test_a_dip_while_the_motors_accelerate_is_no_low_battery():
    monitor = BatteryMonitor(VOLTS)
    for start in range(0, 60, 6):
        assert feed(monitor, 2.0, start, 10.5) == []
        assert feed(monitor, 4.0, start + 2, 11.9) == []


def test_readings_on_both_sides_of_critical_are_low_at_least():
    monitor = BatteryMonitor(VOLTS)
    assert feed(monitor, 20.0, 0.0, 11.05, 10.95) == [5.0]
    assert monitor.level is LOW
    assert feed(monitor, 6.0, 20.0, 11.6, 11.4) == []  # and stays low although half are above


def test_the_voltage_at_rest_does_not_send_it_out_again_but_a_new_battery_does():
    monitor = BatteryMonitor(VOLTS)
    feed(monitor, 6.0, 0.0, 11.4)
    assert feed(monitor, 600.0, 6.0, 12.1) == []
    assert feed(monitor, 6.0, 606.0, 12.7) == [611.0]
    assert (monitor.level, monitor.warning) == (OK, '')


def test_it_stays_on_the_charger_until_that_is_done():
    monitor = BatteryMonitor(VOLTS)
    feed(monitor, 6.0, 0.0, 11.4)
    assert feed(monitor, 60.0, 6.0, 13.9, charging=True) == []
    assert feed(monitor, 6.0, 66.0, 12.8) == [71.0]
    shares = BatteryMonitor(SHARES)
    feed(shares, 6.0, 0.0, 0.2, field='share')
    assert feed(shares, 60.0, 6.0, 0.5, field='share') == []
    assert feed(shares, 6.0, 66.0, 0.6, field='share') == [71.0]


def test_a_critical_battery_is_critical_until_it_is_charged():
    monitor = BatteryMonitor(VOLTS)
    feed(monitor, 6.0, 0.0, 10.9)
    assert monitor.level is CRITICAL
    assert feed(monitor, 60.0, 6.0, 11.8) == []
    assert feed(monitor, 6.0, 66.0, 12.6) == [71.0]
    assert monitor.level is OK


def test_one_limit_alone():
    only_low = BatteryMonitor(BatteryConfig(battery_low=11.5))
    feed(only_low, 20.0, 0.0, 1.0)
    assert only_low.level is LOW
    only_critical = BatteryMonitor(BatteryConfig(battery_critical=0.1))
    feed(only_critical, 20.0, 0.0, 0.05, field='share')
    assert only_critical.level is CRITICAL
    assert feed(only_critical, 6.0, 20.0, 0.9, field='share') == [25.0]
    assert only_critical.level is OK


def test_a_clock_that_is_set_back_delays_nothing_for_ever():
    monitor = BatteryMonitor(VOLTS)
    feed(monitor, 3.0, 1000.0, 11.4)
    assert feed(monitor, 6.0, 0.0, 11.4) == [5.0]


def test_what_is_not_measured_has_no_effect_and_is_named():
    monitor = BatteryMonitor(SHARES)
    assert monitor.unmeasured == ''
    feed(monitor, 10.0, 0.0, 5.0)
    assert monitor.level is OK
    assert monitor.unmeasured == (
        'battery_critical is 10%, but the messages have no percentage (0 to 1): it has no '
        'effect; give it in V'
    )
    mixed = BatteryMonitor(BatteryConfig(battery_low=0.25, battery_critical=11.0))
    feed(mixed, 6.0, 0.0, 10.9)
    assert mixed.level is CRITICAL
    assert 'battery_low is 25%' in mixed.unmeasured
    assert feed(mixed, 6.0, 6.0, 12.6) == [11.0]  # the share, which is unknown, does not hold it


def test_without_limits_nothing_happens():
    assert not BatteryConfig().watched
    monitor = BatteryMonitor(BatteryConfig())
    assert feed(monitor, 20.0, 0.0, 0.1, share=0.0) == []
    assert (monitor.level, monitor.unmeasured) == (OK, '')
    assert math.isnan(BatteryReading().voltage)


@pytest.mark.parametrize(
    ('values', 'message'),
    [
        (
            {'battery_low': 11.0, 'battery_critical': 11.5},
            'battery_critical is 11.5 V and battery_low 11.0 V',
        ),
        (
            {'battery_low': 0.1, 'battery_critical': 0.2},
            'battery_critical is 20% and battery_low 10%',
        ),
        ({'battery_low': -1.0}, 'battery_low is .*, expected 0'),
    ],
)
def test_limits_that_cannot_be_meant_are_refused(values, message):
    with pytest.raises(ConfigError, match=message):
        BatteryConfig(**values)


def test_limits_of_unlike_units_may_be_mixed():
    BatteryConfig(battery_low=0.25, battery_critical=11.0)
