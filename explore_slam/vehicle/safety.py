"""The last gate before the motors: whatever is commanded, what may not be driven is not driven."""

import math
from dataclasses import dataclass, field

import numpy as np

from explore_slam.data import LaserScan
from explore_slam.geometry import Array, Pose2
from explore_slam.vehicle.clearance import scan_points
from explore_slam.vehicle.driver_config import SafetyConfig

# the Pioneer's sonar rings: x, y (mm), bearing (°) of transducers 0-7 in front, 8-15 behind
_FRONT_SONAR = (
    (69, 136, 90), (114, 119, 50), (148, 78, 30), (166, 27, 10),
    (166, -27, -10), (148, -78, -30), (114, -119, -50), (69, -136, -90),
)  # fmt: skip
_REAR_SONAR = (
    (-157, -136, -90), (-203, -119, -130), (-237, -78, -150), (-255, -27, -170),
    (-255, 27, 170), (-237, 78, 150), (-203, 119, 130), (-157, 136, 90),
)  # fmt: skip
SONAR_POSES = tuple(
    Pose2(0.001 * x, 0.001 * y, math.radians(bearing))
    for x, y, bearing in _FRONT_SONAR + _REAR_SONAR
)
SONAR_RANGE = 5.0  # m; what reads longer has heard no echo
_LATENCY = 0.2  # s driven on between seeing and braking


def sonar_points(readings: dict[int, float]) -> Array:
    """Return the echoes (N, 2) m in the vehicle frame of readings: transducer -> m."""
    points = [
        SONAR_POSES[index].compose(Pose2(distance, 0.0, 0.0))[:2]
        for index, distance in readings.items()
        if index < len(SONAR_POSES) and 0.0 < distance < SONAR_RANGE
    ]
    return np.array(points, dtype=np.float64).reshape(-1, 2)


@dataclass
class SafetyInputs:
    """What the gate looks at; None means that there is no such part, so it is not waited for."""

    laser_heard: float | None = None  # monotonic s of the laser's last byte; None: no laser
    bumpers_front: bool = False
    bumpers_rear: bool = False
    stalled: bool = False
    emergency_stop: bool = False
    connected: bool = True
    laser_points: Array = field(default_factory=lambda: np.empty((0, 2)))
    sonar_points: Array = field(default_factory=lambda: np.empty((0, 2)))


@dataclass(frozen=True)
class SafeVelocity:
    """What may be driven (m/s, rad/s), and why it is not what was commanded ('' when it is)."""

    linear: float
    angular: float
    reason: str


class SafetyGate:
    """Watchdog, limits and stops between commands and base; times are monotonic seconds."""

    def __init__(self, config: SafetyConfig, maximum_speed: float, maximum_turn: float) -> None:
        self.config = config
        self._maximum = (maximum_speed, maximum_turn)
        self._command = (0.0, 0.0)
        self._commanded = -math.inf
        self._last = (0.0, 0.0)
        self._updated: float | None = None
        self._stall_direction: float | None = None

    def command(self, linear: float, angular: float, now: float) -> None:
        """Take a command; one that is not finite counts as stop."""
        finite = math.isfinite(linear) and math.isfinite(angular)
        self._command = (linear, angular) if finite else (0.0, 0.0)
        self._commanded = now

    @staticmethod
    def points_of(scan: LaserScan, laser: Pose2) -> Array:
        """Return what a scan hit as points (N, 2) m in the vehicle frame."""
        return scan_points(scan, laser)

    def update(self, inputs: SafetyInputs, now: float) -> SafeVelocity:
        """Return what may be driven now."""
        step = 0.05 if self._updated is None else min(max(now - self._updated, 0.0), 0.2)
        self._updated = now
        reason = self._stop_reason(inputs, now)
        if reason:
            self._last = (0.0, 0.0)
            return SafeVelocity(0.0, 0.0, reason)
        linear, angular = (
            min(max(value, -limit), limit)
            for value, limit in zip(self._command, self._maximum, strict=True)
        )
        linear, reason = self._directional(linear, inputs)
        limited = self._ramp(linear, angular, step)
        self._last = limited
        return SafeVelocity(*limited, reason)

    def _stop_reason(self, inputs: SafetyInputs, now: float) -> str:
        """Return the first reason for standing still whatever the direction, or ''."""
        c = self.config
        age = now - self._commanded
        silence = 0.0 if inputs.laser_heard is None else now - inputs.laser_heard
        reasons = (
            (not inputs.connected, 'base not connected'),
            (inputs.emergency_stop, 'emergency stop pressed'),
            (age == math.inf, 'no command yet'),
            (age > c.command_timeout, f'no command for {age:.1f} s'),
            (silence == math.inf, 'no laser yet'),
            (silence > c.laser_timeout, f'laser silent for {silence:.1f} s'),
            (self._held_by_stall(inputs.stalled), 'wheel stalled'),
        )
        return next((text for holds, text in reasons if holds), '')

    def _held_by_stall(self, stalled: bool) -> bool:
        """Tell whether a stall forbids what is commanded: it allows to drive back, or to rest."""
        if not stalled:
            self._stall_direction = None
            return False
        if self._stall_direction is None:
            self._stall_direction = float(np.sign(self._last[0]))
        wanted = float(np.sign(self._command[0]))
        return wanted == 0.0 or wanted != -self._stall_direction

    def _directional(self, linear: float, inputs: SafetyInputs) -> tuple[float, str]:
        """Return the speed with what touches or lies in the direction of travel respected."""
        if linear > 0.0 and inputs.bumpers_front:
            return 0.0, 'front bumper pressed'
        if linear < 0.0 and inputs.bumpers_rear:
            return 0.0, 'rear bumper pressed'
        c = self.config
        clouds = []
        if c.driver_obstacle_stop:
            clouds.append(inputs.laser_points)
        if c.sonar_stop:
            clouds.append(inputs.sonar_points)
        if linear == 0.0 or not clouds:
            return linear, ''
        free = lane_free(np.concatenate(clouds), c.guard_half_width, c.guard_length, linear > 0.0)
        room = free - c.guard_distance
        if room <= 0.0:
            return 0.0, f'obstacle {max(free, 0.0):.2f} m ahead'
        a, t = c.guard_deceleration, _LATENCY
        fastest = a * (math.sqrt(t * t + 2.0 * room / a) - t)
        if fastest < abs(linear):
            return math.copysign(fastest, linear), f'slow: obstacle {free:.2f} m ahead'
        return linear, ''

    def _ramp(self, linear: float, angular: float, step: float) -> tuple[float, float]:
        """Speed up no faster than allowed; slowing down is left to the base."""
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


def lane_free(points: Array, half_width: float, length: float, forward: bool) -> float:
    """Return the room (m) between the body's front (or back) and the nearest point in its lane."""
    x = points[:, 0] if forward else -points[:, 0]
    ahead = x[(x > 0.0) & (np.abs(points[:, 1]) < half_width)]
    return float(ahead.min()) - length if ahead.size else math.inf
