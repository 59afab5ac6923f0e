"""BatteryState of other drivers: what is measured, and what stands for nothing."""

import math

import pytest
from sensor_msgs.msg import BatteryState

from explore_slam.errors import DataError
from explore_slam.messages.battery import battery_reading

NAN = math.nan


@pytest.mark.parametrize(
    ('voltage', 'percentage', 'status', 'expected'),
    [
        (12.5, 0.8, BatteryState.POWER_SUPPLY_STATUS_DISCHARGING, (12.5, 0.8, False)),
        (12.5, NAN, BatteryState.POWER_SUPPLY_STATUS_CHARGING, (12.5, NAN, True)),
        (NAN, 0.25, BatteryState.POWER_SUPPLY_STATUS_FULL, (NAN, 0.25, False)),
        (0.0, 0.0, BatteryState.POWER_SUPPLY_STATUS_UNKNOWN, (NAN, 0.0, False)),
        (12.5, 87.0, BatteryState.POWER_SUPPLY_STATUS_UNKNOWN, (12.5, NAN, False)),  # percent
        (12.5, -1.0, BatteryState.POWER_SUPPLY_STATUS_UNKNOWN, (12.5, NAN, False)),
    ],
)
def test_readings(voltage, percentage, status, expected):
    message = BatteryState(voltage=voltage, percentage=percentage, power_supply_status=status)
    assert battery_reading(message) == pytest.approx(expected, nan_ok=True)


@pytest.mark.parametrize(('voltage', 'percentage'), [(NAN, NAN), (0.0, NAN), (NAN, 87.0)])
def test_nothing_measured_is_an_error(voltage, percentage):
    with pytest.raises(DataError, match=r'voltage is .* and percentage'):
        battery_reading(BatteryState(voltage=voltage, percentage=percentage))
