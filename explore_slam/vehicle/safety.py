"""Safety gate between velocity commands and the base: watchdogs, limits, obstacle stops."""

import math
from dataclasses import dataclass, field

import numpy as np

from explore_slam.geometry import Array
from explore_slam.vehicle.driver_config import SafetyConfig

_LATENCY = 0.2  # s from a laser return to braking: age of a scan at 38400 Bd
_FIRST_STEP, _LONGEST_STEP = 0.05, 0.2  # s of acceleration allowed at the first update, at most


@dataclass
class SafetyInputs:
    """State of the vehicle that decides what may be driven; points are in the vehicle frame."""

    laser_last_received: float | None = None  # monotonic s, of a byte; None: without laser
    bumpers_front: bool = False
    bumpers_rear: bool = False
    stalled: bool = False
    emergency_stop: bool = False
    motors_on: bool = True
    connected: bool = True
    laser_points: Array = field(default_factory=lambda: np.empty((0, 2)))
    sonar_points: Array = field(default_factory=lambda: np.empty((0, 2)))


@dataclass(frozen=True)
class SafeVelocity:
    """Velocity that may be driven (m/s, rad/s).

    reason: the first that makes it differ from the command, '' if it does not.
    others: further reasons to stand, which remain when the first one is gone.
    """

    linear: float
    angular: float
    reason: str
    others: tuple[str, ...] = ()

    @property
    def all_reasons(self) -> str:
        """All reasons in one line."""
        return '; '.join(filter(None, (self.reason, *self.others)))


class SafetyGate:
    """Computes the velocity that may be driven; all times are monotonic seconds."""

    def __init__(self, config: SafetyConfig, maximum_speed: float, maximum_turn: float) -> None:
        self.config = config
        self._maximum = (maximum_speed, maximum_turn)
        self._command = (0.0, 0.0)
        self._commanded = -math.inf
        self._last = (0.0, 0.0)
        self._updated: float | None = None
        self._stall_direction: float | None = None

    def command(self, linear: float, angular: float, now: float) -> None:
        """Set the commanded velocity (m/s, rad/s); a non-finite one stops the vehicle."""
        finite = math.isfinite(linear) and math.isfinite(angular)
        self._command = (linear, angular) if finite else (0.0, 0.0)
        self._commanded = now

    def update(self, inputs: SafetyInputs, now: float) -> SafeVelocity:
        """Return the velocity that may be driven now."""
        last = self._updated
        step = _FIRST_STEP if last is None else min(max(now - last, 0.0), _LONGEST_STEP)
        self._updated = now
        reasons = self._stop_reasons(inputs, now)
        if reasons:
            self._last = (0.0, 0.0)
            return SafeVelocity(0.0, 0.0, reasons[0], tuple(reasons[1:]))
        linear, angular = (
            min(max(value, -limit), limit)
            for value, limit in zip(self._command, self._maximum, strict=True)
        )
        linear, reason = self._limit_in_direction(linear, inputs)
        limited = self._ramp(linear, angular, step)
        self._last = limited
        return SafeVelocity(*limited, reason)

    def _stop_reasons(self, inputs: SafetyInputs, now: float) -> list[str]:
        """Return all reasons to stop in any direction."""
        c = self.config
        age = now - self._commanded
        silence = 0.0 if inputs.laser_last_received is None else now - inputs.laser_last_received
        reasons = (
            (not inputs.connected, 'base not connected'),
            (inputs.emergency_stop, 'emergency stop pressed'),
            (not inputs.motors_on, 'motors off (service enable_motors)'),
            (age == math.inf, 'no command yet'),
            (c.command_timeout < age < math.inf, f'no command for {age:.1f} s'),
            (silence == math.inf, 'no laser yet'),
            (c.laser_timeout < silence < math.inf, f'laser silent for {silence:.1f} s'),
            (self._held_by_stall(inputs.stalled), 'wheel stalled'),
        )
        return [text for holds, text in reasons if holds]

    def _held_by_stall(self, stalled: bool) -> bool:
        """Return whether a stall forbids the command; the opposite direction is allowed."""
        if not stalled:
            self._stall_direction = None
            return False
        if self._stall_direction is None:
            self._stall_direction = float(np.sign(self._last[0]))
        wanted = float(np.sign(self._command[0]))
        return wanted == 0.0 or wanted != -self._stall_direction

    def _limit_in_direction(self, linear: float, inputs: SafetyInputs) -> tuple[float, str]:
        """Return the speed limited by bumpers and obstacles in its direction, and the reason."""
        if linear > 0.0 and inputs.bumpers_front:
            return 0.0, 'front bumper pressed'
        if linear < 0.0 and inputs.bumpers_rear:
            return 0.0, 'rear bumper pressed'
        c = self.config
        clouds = []
        if c.laser_stop:
            clouds.append(inputs.laser_points)
        if c.sonar_stop:
            clouds.append(inputs.sonar_points)
        if linear == 0.0 or not clouds:
            return linear, ''
        points, forward = np.concatenate(clouds), linear > 0.0
        where = 'ahead' if forward else 'behind'
        free = free_in_lane(points, c.guard_half_width, c.guard_half_length, forward)
        room = free - c.guard_distance
        if room <= 0.0:
            return 0.0, f'obstacle {max(free, 0.0):.2f} m {where}'
        # v with v t + v² / (2 a) = room: distance during the latency and while braking
        a, t = c.guard_deceleration, _LATENCY
        fastest = a * (math.sqrt(t * t + 2.0 * room / a) - t)
        if fastest < abs(linear):
            return math.copysign(fastest, linear), f'slow: obstacle {free:.2f} m {where}'
        return linear, ''

    def _ramp(self, linear: float, angular: float, step: float) -> tuple[float, float]:
        """Limit the acceleration; deceleration is left to the base."""
        c = self.config
        last_linear, last_angular = self._last
        bound = c.guard_acceleration * step
        if linear * last_linear < 0.0:
            last_linear = 0.0
        if abs(linear) > abs(last_linear) + bound:
            linear = math.copysign(abs(last_linear) + bound, linear)
        turn = c.guard_turn_acceleration * step
        angular = min(max(angular, last_angular - turn), last_angular + turn)
        return linear, angular


def free_in_lane(points: Array, half_width: float, length: float, forward: bool) -> float:
    """Return the distance (m) from the body's front (or back) to the nearest point in its lane.

    The lane is |y| < half_width; length: distance (m) from the origin to the front. inf if free.
    """
    x = points[:, 0] if forward else -points[:, 0]
    ahead = x[(x > 0.0) & (np.abs(points[:, 1]) < half_width)]
    return float(ahead.min()) - length if ahead.size else math.inf
