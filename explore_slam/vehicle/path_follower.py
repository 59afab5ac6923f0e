"""Path following: pure pursuit on dead-reckoned poses, with stops for obstacles and silence.

Pure pursuit after Coulter, "Implementation of the Pure Pursuit Path Tracking Algorithm", 1992.
Independent of ROS and of clocks: every call gets its time. The constants were chosen with
benchmarks/vehicle_following.py (slalom, corners, obstacles; odometry and scans with latency).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from explore_slam.data import FollowerState, LaserScan, ObstacleView, OdometryReading, Plan
from explore_slam.geometry import Pose2, to_world
from explore_slam.sweeps import Sweep
from explore_slam.vehicle.clearance import free_distance
from explore_slam.vehicle.config import PathFollowerConfig
from explore_slam.vehicle.dead_reckoning import DeadReckoning
from explore_slam.vehicle.laser_view import LaserView
from explore_slam.vehicle.obstacle_view import CameraView
from explore_slam.vehicle.reference_path import ReferencePath

_PROJECTION_WINDOW = 2.0  # m of path searched for the nearest point: paths may cross themselves
_SAME_GOAL = 0.05  # m between last waypoints: the plan was only redrawn
_CREEP = 0.05  # m/s, minimum speed without obstacles, so that the goal is reached
_OBSTACLE_CREEP = 0.02  # m/s, minimum speed before an obstacle that allows any
_PROGRESS_STEP = 0.05  # m or rad that count as progress
_LONGEST_STEP = 0.5  # s of acceleration after a gap between commands
_TURN_GAIN = 2.0  # 1/s, turn rate per bearing when turning on the spot
_TURN_HYSTERESIS = 0.35  # of turn_in_place_angle: turning on the spot ends at this bearing
_GENTLE_CURVATURE = 0.5  # 1/m; below it the straight line ahead must be free too
_BRAKING_SHARE = 0.6  # of follow_acceleration, relied upon for braking before obstacles
_END_GAP = 0.05  # m between body and obstacle where a plan ends, less than the stop distance
_RESTART_ROOM = 0.05  # m more than the stop distance to start again after an obstacle


@dataclass(frozen=True)
class VelocityCommand:
    """Velocity (m/s forward, rad/s to the left), and the state and reason behind it."""

    linear: float
    angular: float
    state: FollowerState
    reason: str


@dataclass
class FollowerProgress:
    """Progress along the plan, for reports: metres; inf where unknown."""

    remaining: float = math.inf
    cross_track: float = 0.0
    free: float = math.inf


@dataclass
class _Timers:
    """Times (s) of the last inputs (-inf: none yet) and of ongoing conditions (None: not met)."""

    agent: float = -math.inf
    odometry: float = -math.inf
    scan: float = -math.inf
    obstacle: float | None = None
    progress: float | None = None
    last_command: float | None = None


@dataclass
class _Best:
    """Best values so far; progress is what improves on them."""

    remaining: float = math.inf
    bearing: float = math.inf


@dataclass
class _Motion:
    """The last command."""

    linear: float = 0.0
    angular: float = 0.0
    turning: bool = False


class PathFollower:
    """Computes velocity commands for one vehicle from plan, map pose, odometry and scans.

    The set_ methods take an input and the time (s) it was received, by default its stamp. Silence
    is measured by times of receipt, geometry uses stamps.
    """

    def __init__(
        self,
        config: PathFollowerConfig | None = None,
        vehicle: str = 'the vehicle',
        has_laser: bool = True,
    ) -> None:
        """Create a follower; vehicle: its name in messages.

        has_laser: whether it stops when no scans arrive; the obstacles that cameras see count in
        any case.
        """
        self._has_laser = has_laser
        self.config = config or PathFollowerConfig()
        self.progress = FollowerProgress()
        self.plan: Plan | None = None
        self._path: ReferencePath | None = None
        self._s = 0.0
        self._reckoning = DeadReckoning()
        self._view = LaserView(vehicle, self._reckoning)
        self._cameras = CameraView(self._reckoning)
        self._times = _Timers()
        self._best = _Best()
        self._motion = _Motion()
        self._arrived = False

    def configure(self, config: PathFollowerConfig) -> None:
        """Replace the settings, also while driving."""
        self.config = config

    def set_plan(self, plan: Plan, received: float | None = None) -> None:
        """Set the plan in the map frame; a plan without waypoints stops the vehicle."""
        self._times.agent = max(self._times.agent, plan.stamp if received is None else received)
        if self.plan is not None and np.array_equal(plan.waypoints, self.plan.waypoints):
            return
        same_goal = (
            self.plan is not None
            and len(plan.waypoints) > 0
            and len(self.plan.waypoints) > 0
            and bool(np.allclose(plan.waypoints[-1], self.plan.waypoints[-1], atol=_SAME_GOAL))
        )
        self.plan = plan
        self._path = ReferencePath(plan.waypoints) if len(plan.waypoints) else None
        self._s = 0.0
        self._arrived = False
        if not same_goal:  # otherwise the timers go on: a redrawn path is no progress
            self._times.obstacle = self._times.progress = None
            self._best = _Best()
        else:
            self._best.remaining = min(self._best.remaining, self._path_length())

    def _path_length(self) -> float:
        return self._path.length if self._path is not None else math.inf

    def set_pose(self, stamp: float, pose: Pose2, received: float | None = None) -> None:
        """Set the vehicle's pose in the map at a stamp (s)."""
        self._times.agent = max(self._times.agent, stamp if received is None else received)
        self._reckoning.set_pose(stamp, pose)

    def set_odometry(self, reading: OdometryReading, received: float | None = None) -> None:
        """Add an odometry reading."""
        self._times.odometry = reading.stamp if received is None else received
        self._reckoning.add_odometry(reading)

    def set_scan(self, scan: LaserScan, received: float | None = None) -> None:
        """Replace the scan of a laser that shows obstacles; see LaserView."""
        laser = scan.mount or self.config.laser_mount.pose
        self._view.add(scan, laser, scan.stamp if received is None else received)
        self._times.scan = self._view.last_received

    def set_obstacles(self, view: ObstacleView) -> None:
        """Take what a depth camera has seen; see CameraView."""
        self._cameras.add(view)

    def set_sweeps(self, found: Mapping[str, Sweep]) -> None:
        """Set when the beams of lasers are measured, as the agent has found from their scans."""
        self._view.set_sweeps(found)

    def map_pose(self, now: float) -> Pose2 | None:
        """Return the dead-reckoned pose in the map, None before the first map pose."""
        return self._reckoning.map_pose(now)

    def halt(self) -> None:
        """Forget motion and progress: something else drives the vehicle at present."""
        self._motion = _Motion()
        self._best = _Best()
        self._times.obstacle = self._times.progress = None
        self._arrived = False

    def command(self, now: float, heartbeat_age: float = 0.0) -> VelocityCommand:
        """Return the velocity to drive from now (s) on; call it at control_frequency.

        heartbeat_age: time (s of wall time) since the agent's heartbeat, 0 if it has none.
        """
        step = self._time_step(now)
        silence = self._silence(now)
        if heartbeat_age > self.config.heartbeat_timeout:
            silence = f"agent's heartbeat silent for {heartbeat_age:.1f} s"
        pose = self._reckoning.map_pose(now)
        if silence or pose is None:
            return self._stop(FollowerState.WAITING, silence or 'no map pose yet')
        if self._path is None:
            return self._stop(FollowerState.WAITING, 'no plan')
        position = np.array([pose.x, pose.y])
        self._s, cross = self._path.project(position, self._s, _PROJECTION_WINDOW)
        to_goal = float(np.linalg.norm(position - self._path.points[-1]))
        self.progress.remaining = self._path.length - self._s + min(abs(cross), to_goal)
        self.progress.cross_track = cross
        near_end = self._path.length - self._s <= self.config.arrival_tolerance
        if self._arrived or (near_end and to_goal <= self.config.arrival_tolerance):
            self._arrived = True
            return self._stop(FollowerState.ARRIVED, 'goal reached')
        if abs(cross) > self.config.maximum_deviation:
            return self._stop(FollowerState.BLOCKED, f'{abs(cross):.2f} m off the plan')
        return self._drive(now, step, pose)

    def _time_step(self, now: float) -> float:
        """Return the time (s) since the last command; reset all times if the clock jumped."""
        last = self._times.last_command
        if last is not None and now < last:
            self._times = _Timers()
            self._motion = _Motion()
            last = None
        self._times.last_command = now
        if last is None:
            return 1.0 / self.config.control_frequency
        return min(now - last, _LONGEST_STEP)

    def _silence(self, now: float) -> str:
        """Return which input is missing or has been silent for too long, or ''."""
        c, t = self.config, self._times
        if self.plan is None:
            return 'no plan yet'
        checks = [
            # first: without odometry the agent has no new poses to send either
            ('odometry', t.odometry, c.odometry_timeout),
            ('agent', t.agent, c.agent_timeout),
            ('map pose', self._reckoning.pose_stamp, c.pose_timeout),
        ]
        if c.obstacle_stop and self._has_laser:
            checks.append(('laser', t.scan, c.scan_timeout))
        for name, last, limit in checks:
            if last == -math.inf:
                return f'no {name} yet'
            if now - last > limit:
                return f'{name} silent for {now - last:.1f} s'
        return ''

    def _drive(self, now: float, step: float, pose: Pose2) -> VelocityCommand:
        """Pursue the lookahead point, turning on the spot first if it lies far aside."""
        assert self._path is not None
        c = self.config
        ahead = max(c.minimum_lookahead, abs(self._motion.linear) * c.lookahead_time)
        target = self._path.point_at(self._s + ahead)
        x, y = to_world(pose.inverse(), target[None, :])[0]
        distance, bearing = math.hypot(x, y), math.atan2(y, x)
        limit = c.turn_in_place_angle
        if self._motion.turning:
            limit = _TURN_HYSTERESIS * c.turn_in_place_angle
        self._motion.turning = abs(bearing) > limit
        stuck = self._stuck(now, bearing)
        if stuck:
            return self._stop(FollowerState.BLOCKED, stuck)
        if self._motion.turning:
            self._times.obstacle = None
            linear = self._ramp(self._motion.linear, 0.0, c.follow_acceleration, step)
            return self._send(step, max(linear, 0.0), _TURN_GAIN * bearing, 'turning to the plan')
        # curvature of the arc to the lookahead point (Coulter, 1992)
        curvature = 2.0 * y / max(distance * distance, 1e-6)
        speed = min(c.body.follow_speed, c.follow_turn_rate / max(abs(curvature), 1e-6))
        speed = min(speed, _braking_speed(self.progress.remaining, c.follow_acceleration))
        speed, blocked = self._limit_for_obstacles(now, curvature, max(speed, _CREEP))
        if blocked:
            late = now - (self._times.obstacle or now) > c.blocked_timeout
            state = FollowerState.BLOCKED if late else FollowerState.WAITING
            return self._stop(state, f'obstacle {self.progress.free:.2f} m ahead')
        linear = self._ramp(self._motion.linear, speed, c.follow_acceleration, step)
        return self._send(step, linear, linear * curvature, '')

    def _limit_for_obstacles(
        self, now: float, curvature: float, speed: float
    ) -> tuple[float, bool]:
        """Return the speed from which the vehicle can stop before obstacles, and whether to stop.

        Obstacles on the arc count, and on a gentle arc those straight ahead too. Where the plan
        ends before an obstacle, as at a viewpoint beside a wall, the vehicle may drive to the end.
        """
        c = self.config
        if not c.obstacle_stop:
            return speed, False
        points = self._view.points(now)
        points = np.concatenate([points, self._cameras.points(now, points)])
        body = c.body.record.envelope
        free = free_distance(points, curvature, body)
        straight = free
        if abs(curvature) < _GENTLE_CURVATURE:
            straight = free_distance(points, 0.0, body)
        self.progress.free = free = min(free, straight) + c.body.side_clearance
        room = free - c.stop_distance
        ends_before = free - _END_GAP >= self.progress.remaining
        if ends_before:
            room = max(room, self.progress.remaining)
        # hysteresis: the vehicle does not creep after an obstacle that moves away slowly
        needed = _RESTART_ROOM if self._times.obstacle is not None else 0.0
        if room <= needed and not ends_before:
            if self._times.obstacle is None:
                self._times.obstacle = now
            return 0.0, True
        self._times.obstacle = None
        # v with v t + v² / (2 a) = room: distance during the reaction time and while braking
        a, t = _BRAKING_SHARE * c.follow_acceleration, c.reaction_time
        fastest = max(a * (math.sqrt(t * t + 2.0 * room / a) - t), _OBSTACLE_CREEP)
        return min(speed, fastest), False

    def _stuck(self, now: float, bearing: float) -> str:
        """Return the reason if there has been no progress for too long, or ''.

        Progress is less remaining path, or a smaller bearing while turning on the spot. Waiting
        for an obstacle is not counted.
        """
        turning = self._motion.turning
        remaining = self.progress.remaining
        better = remaining < self._best.remaining - _PROGRESS_STEP or (
            turning and abs(bearing) < self._best.bearing - _PROGRESS_STEP
        )
        if better or self._times.progress is None or self._times.obstacle is not None:
            self._best = _Best(min(remaining, self._best.remaining), abs(bearing))
            self._times.progress = now
        elif now - self._times.progress > self.config.stuck_timeout:
            return f'no progress for {now - self._times.progress:.0f} s'
        return ''

    @staticmethod
    def _ramp(present: float, wanted: float, acceleration: float, step: float) -> float:
        """Limit the change of speed: by the acceleration, and by twice as much when braking."""
        return min(max(wanted, present - 2.0 * acceleration * step), present + acceleration * step)

    def _send(self, step: float, linear: float, angular: float, reason: str) -> VelocityCommand:
        """Return a driving command with turn rate and angular acceleration limited."""
        c = self.config
        bound = c.follow_turn_acceleration * step
        wanted = min(max(angular, -c.follow_turn_rate), c.follow_turn_rate)
        present = self._motion.angular
        self._motion.linear = linear
        self._motion.angular = min(max(wanted, present - bound), present + bound)
        return VelocityCommand(
            float(linear), float(self._motion.angular), FollowerState.DRIVING, reason
        )

    def _stop(self, state: FollowerState, reason: str) -> VelocityCommand:
        """Return a command to stand still."""
        self._motion.linear = self._motion.angular = 0.0
        self._motion.turning = False
        if state is FollowerState.WAITING and self._times.obstacle is None:
            self._times.progress = None
        return VelocityCommand(0.0, 0.0, state, reason)


def _braking_speed(distance: float, deceleration: float) -> float:
    """Return the speed (m/s) from which the deceleration (m/s²) stops within the distance (m)."""
    return math.sqrt(max(2.0 * deceleration * distance, 0.0))
