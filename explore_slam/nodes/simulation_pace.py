"""The pace of simulated time: a fixed rate, or as fast as agent and followers keep up.

Free of ROS. Wall times are seconds of a monotonic clock, sim times are simulated seconds.
"""

import threading
from dataclasses import dataclass

from explore_slam.settings import Section, setting

# s beyond pose_lead in which time advances at real-time rate: otherwise an agent that publishes by
# simulated time and has caught up would wait for the clock while the clock waits for it
CREEP = 0.25
MAX_LAG = 0.25  # wall s; a larger delay behind a fixed rate is not made up for


@dataclass(frozen=True)
class PaceConfig(Section):
    """Limits of the pace of simulated time."""

    real_time_factor: float = setting(
        0.0,
        'Simulated seconds per second; 0: as fast as agent and followers keep up',
        low=0.0,
        high=1000.0,
    )
    pose_lead: float = setting(
        0.6,
        'Maximum lead of simulated time over the newest pose of the slowest vehicle '
        '(real_time_factor 0)',
        unit='s',
        low=0.1,
        high=60.0,
    )
    pose_wait_timeout: float = setting(
        5.0,
        'Time without a newer pose after which a vehicle no longer holds simulated time '
        '(real_time_factor 0)',
        unit='wall s',
        low=0.1,
        high=3600.0,
    )
    command_lead: float = setting(
        0.15,
        'Maximum lead of simulated time over the newest velocity command of a moving vehicle '
        '(real_time_factor 0)',
        unit='s',
        low=0.02,
        high=10.0,
    )
    command_wait_timeout: float = setting(
        0.25,
        'Time without a velocity command after which a vehicle no longer holds simulated time '
        '(real_time_factor 0)',
        unit='wall s',
        low=0.01,
        high=60.0,
    )


@dataclass
class _Follower:
    """The newest velocity command of a vehicle: its times, and whether it is a motion."""

    sim: float = 0.0
    wall: float = 0.0
    moving: bool = False


@dataclass
class _Estimate:
    """The newest pose stamp of a vehicle, and the wall time at which it last changed."""

    stamp: float
    wall: float


class Pace:
    """Determines the wait before the next step; any thread may report poses and commands."""

    def __init__(self, config: PaceConfig, vehicles: list[str], wall: float) -> None:
        self.config = config
        self._lock = threading.Lock()
        self._followers = {name: _Follower() for name in vehicles}
        self._poses: dict[str, _Estimate] = {}
        self._anchor = (0.0, wall)
        self.holder = ''  # what is holding time back

    def report_pose(self, vehicle: str, stamp: float, wall: float) -> None:
        """Record the stamp of a pose that the agent has published for a vehicle."""
        with self._lock:
            known = self._poses.get(vehicle)
            if known is None or stamp != known.stamp:
                self._poses[vehicle] = _Estimate(stamp, wall)

    def report_command(self, vehicle: str, moving: bool, sim: float, wall: float) -> None:
        """Record the arrival of a velocity command for a vehicle."""
        with self._lock:
            self._followers[vehicle] = _Follower(sim, wall, moving)

    def delay(self, sim: float, wall: float) -> float:
        """Return the longest wait (wall s) before the next step; 0: step now."""
        with self._lock:
            if self.config.real_time_factor > 0.0:
                self.holder = 'clock'
                return self._until(sim, wall, self.config.real_time_factor)
            held = self._held_by_command(sim, wall) or self._held_by_pose(sim, wall)
            if held is not None:
                self.holder, delay = held
                if delay <= 0.0:
                    self._anchor = (sim, wall)
                return delay
            if self._listening(wall):
                self._anchor = (sim, wall)
                self.holder = ''
                return 0.0
            self.holder = (
                'no poses'  # no agent is running: real time, so that a late one misses little
            )
            return self._until(sim, wall, 1.0)

    def _until(self, sim: float, wall: float, factor: float) -> float:
        start_sim, start_wall = self._anchor
        delay = start_wall + (sim - start_sim) / factor - wall
        if delay < -MAX_LAG:
            self._anchor = (sim, wall)
        return max(0.0, delay)

    def _held_by_command(self, sim: float, wall: float) -> tuple[str, float] | None:
        for name, follower in self._followers.items():
            waited = wall - follower.wall
            ahead = sim - follower.sim >= self.config.command_lead - 1e-9
            if follower.moving and ahead and waited < self.config.command_wait_timeout:
                return f'{name}/cmd_vel', self.config.command_wait_timeout - waited
        return None

    def _listening(self, wall: float) -> dict[str, _Estimate]:
        timeout = self.config.pose_wait_timeout
        return {name: p for name, p in self._poses.items() if wall - p.wall < timeout}

    def _held_by_pose(self, sim: float, wall: float) -> tuple[str, float] | None:
        alive = self._listening(wall)
        if not alive:
            return None
        slowest = min(alive, key=lambda name: alive[name].stamp)
        ahead = sim - alive[slowest].stamp - self.config.pose_lead
        if ahead < -1e-9:
            return None
        remaining = self.config.pose_wait_timeout - (wall - alive[slowest].wall)
        if ahead < CREEP:
            remaining = min(remaining, self._until(sim, wall, 1.0))
        return f'{slowest}/pose', remaining
