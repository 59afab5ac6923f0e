"""The battery of a vehicle: when it is low, when it is critical, and when it will do again."""

import math
from dataclasses import dataclass

from explore_slam.data import BatteryLevel, BatteryReading
from explore_slam.errors import ConfigError
from explore_slam.settings import Section, setting

# The voltage dips while the motors accelerate: for one to two seconds with the default speed and
# acceleration of the Pioneer (maximum_speed, base_acceleration).
_CONFIRMATION = 5.0  # s for which all readings must agree before the level changes
_LARGEST_SHARE = 1.0  # limits up to this one are shares of the full charge, others are V
# An empty battery recovers by some tenths of a volt when the load ends. 8 % above 11.5 V, a usual
# limit of lead-acid batteries of 12 V, are 12.4 V: at rest, three quarters full.
_RECOVERED_VOLTAGE = 1.08  # times the limit
_RECOVERED_SHARE = 0.3  # above the limit
_NEARLY_FULL = 0.95  # share that counts as recovered whatever the limit is


@dataclass(frozen=True)
class BatteryConfig(Section):
    """When the agent takes a vehicle out of the exploration because of its battery."""

    battery_low: float = setting(
        0.0,
        'Battery below which the vehicle hands over its goal and drives home: up to 1 a share of '
        'the full charge, above that V; 0: never',
        low=0.0,
        high=100.0,
        tier='basic',
    )
    battery_critical: float = setting(
        0.0,
        'Battery below which the vehicle stops where it is: up to 1 a share of the full charge, '
        'above that V; 0: never',
        low=0.0,
        high=100.0,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        low, critical = self.battery_low, self.battery_critical
        if low > 0.0 and _is_share(low) == _is_share(critical) and critical > low:
            raise ConfigError(
                f'battery_critical is {_text(critical)} and battery_low {_text(low)}, expected '
                'the former to be less'
            )

    @property
    def watched(self) -> bool:
        """Whether the battery matters at all."""
        return self.battery_low > 0.0 or self.battery_critical > 0.0


class BatteryMonitor:
    """Judges the battery of one vehicle, reading by reading.

    level: of the newest readings. reading: the newest one, None before the first.
    """

    def __init__(self, config: BatteryConfig) -> None:
        self._limits = {
            BatteryLevel.CRITICAL: config.battery_critical,
            BatteryLevel.LOW: config.battery_low,
        }
        # since when (s) all readings have suggested a level, or a worse one
        self._since: dict[BatteryLevel, float] = {}
        self.level = BatteryLevel.OK
        self.reading: BatteryReading | None = None

    def add(self, reading: BatteryReading, now: float) -> bool:
        """Take a reading at a time (s); return whether the level has changed."""
        self.reading = reading
        suggested = self._suggested(reading)
        self._since = {
            level: min(self._since.get(level, now), now)  # the clock may have been set back
            for level in suggested
        }
        confirmed = [level for level in suggested if now - self._since[level] >= _CONFIRMATION]
        if not confirmed or confirmed[0] is self.level:
            return False
        self.level = confirmed[0]
        return True

    @property
    def warning(self) -> str:
        """What is wrong with the battery, '' if nothing."""
        if self.level is BatteryLevel.OK or self.reading is None:
            return ''
        limit = self._limits[self.level]
        setting_name = f'battery_{self.level.value}'
        value = _text(_measured(self.reading, limit), share=_is_share(limit))
        return f'battery {self.level.value}: {value}, {setting_name} is {_text(limit)}'

    @property
    def unmeasured(self) -> str:
        """Which limit cannot be applied because the vehicle does not measure it, '' if none."""
        if self.reading is None:
            return ''
        for level, limit in self._limits.items():
            if limit > 0.0 and not math.isfinite(_measured(self.reading, limit)):
                what = 'percentage (0 to 1)' if _is_share(limit) else 'voltage'
                return (
                    f'battery_{level.value} is {_text(limit)}, but the messages have no {what}: '
                    f'it has no effect; give it in {"V" if _is_share(limit) else "shares of 1"}'
                )
        return ''

    def _suggested(self, reading: BatteryReading) -> list[BatteryLevel]:
        """Return the levels that agree with a reading, the worst first.

        A level once reached is kept until the battery has recovered.
        """
        below = [
            level
            for level, limit in self._limits.items()
            if level is self.level or (limit > 0.0 and _measured(reading, limit) < limit)
        ]
        if BatteryLevel.CRITICAL in below:
            below = [BatteryLevel.CRITICAL, BatteryLevel.LOW]
        if self._has_recovered(reading) or not below:
            return [BatteryLevel.OK]
        return below

    def _has_recovered(self, reading: BatteryReading) -> bool:
        """Return whether the battery has been charged, or replaced.

        The voltage while it is being charged says nothing.
        """
        if reading.charging:
            return False
        for level, limit in self._limits.items():
            measured = _measured(reading, limit)
            if limit == 0.0 or (math.isnan(measured) and level is not self.level):
                continue
            enough = limit * _RECOVERED_VOLTAGE
            if _is_share(limit):
                enough = min(limit + _RECOVERED_SHARE, max(limit, _NEARLY_FULL))
            if not measured >= enough:
                return False
        return True


def _is_share(limit: float) -> bool:
    return limit <= _LARGEST_SHARE


def _measured(reading: BatteryReading, limit: float) -> float:
    """Return what a limit is compared with; NaN where it is not measured."""
    return reading.share if _is_share(limit) else reading.voltage


def _text(value: float, *, share: bool | None = None) -> str:
    """Return a share or a voltage in words; by default a limit, which shows what it is."""
    if _is_share(value) if share is None else share:
        return f'{value:.0%}'
    return f'{value:.1f} V'
