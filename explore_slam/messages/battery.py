"""The state of a battery: sensor_msgs/BatteryState."""

import math
from typing import Any

from explore_slam.data import BatteryReading
from explore_slam.errors import DataError

_CHARGING = 1  # POWER_SUPPLY_STATUS_CHARGING


def battery_reading(message: Any) -> BatteryReading:
    """Return the reading in a BatteryState; DataError if it has neither voltage nor percentage.

    What is not measured is NaN, as the message defines; some drivers write 0 V or a percentage
    beyond 0 to 1 instead.
    """
    voltage, share = float(message.voltage), float(message.percentage)
    measured = math.isfinite(voltage) and voltage > 0.0
    if not measured and not 0.0 <= share <= 1.0:
        raise DataError(
            f'battery: voltage is {voltage:g} V and percentage {share:g}, expected more than 0 V '
            'or 0 to 1'
        )
    return BatteryReading(
        voltage if measured else math.nan,
        share if 0.0 <= share <= 1.0 else math.nan,
        message.power_supply_status == _CHARGING,
    )
