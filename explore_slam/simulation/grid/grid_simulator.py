"""Kinematic vehicles with a laser in a grid world, for planning studies: no rendering, no ROS.

Vehicles are discs that follow plans with the speeds and accelerations of a Pioneer 3-DX, stop in
front of obstacles and of each other, and know their pose perfectly or with an error that wanders.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import LaserScan, Plan
from explore_slam.errors import SimulationError
from explore_slam.geometry import Array, Pose2, wrap_angle
from explore_slam.settings import Section, setting
from explore_slam.simulation.grid import grid_world_kernels as kernels
from explore_slam.simulation.grid.grid_world import GridWorld

MAX_VEHICLES = 31
BACKING_SPEED = 0.15
LOOKS_THERE = 0.2  # rad
SHORT_LOOK = 0.12  # m


@dataclass(frozen=True)
class GridSimulatorConfig(Section):
    """What the vehicles, their lasers and their poses are like."""

    body_radius: float = setting(
        0.22,
        'radius of a vehicle, a disc (half the length of a Pioneer)',
        unit='m',
        low=0.05,
        high=2.0,
    )
    reach_clearance: float = setting(
        0.3,
        'reachable is what vehicles reach at this distance from obstacles',
        unit='m',
        low=0.05,
        high=2.0,
    )
    cruise_speed: float = setting(0.5, 'speed on a straight path', unit='m/s', low=0.05, high=3.0)
    turn_rate: float = setting(1.0, 'fastest turn', unit='rad/s', low=0.1, high=6.0)
    acceleration: float = setting(0.5, 'while gaining speed', unit='m/s^2', low=0.05, high=10.0)
    braking: float = setting(1.0, 'while losing speed', unit='m/s^2', low=0.05, high=10.0)
    turn_acceleration: float = setting(2.0, 'of the turn', unit='rad/s^2', low=0.1, high=20.0)
    tick: float = setting(0.1, 'time step', unit='s', low=0.01, high=0.5)
    pursuit_distance: float = setting(0.35, 'lookahead on the path', unit='m', low=0.05, high=2.0)
    arrival_distance: float = setting(0.2, 'a goal is reached', unit='m', low=0.01, high=2.0)
    wall_margin: float = setting(0.003, 'kept from obstacles', unit='m', low=0.0, high=1.0)
    vehicle_margin: float = setting(0.15, 'kept from vehicles', unit='m', low=0.0, high=2.0)
    beams: int = setting(361, 'beams of the laser', low=1, high=5000)
    field_of_view: float = setting(
        math.pi, 'of the laser', unit='rad', low=0.1, high=2.0 * math.pi
    )
    beam_range: float = setting(8.0, 'longest range of the laser', unit='m', low=0.5, high=100.0)
    range_noise: float = setting(0.01, 'deviation of a range', unit='m', low=0.0, high=0.5)
    position_noise: float = setting(
        0.0, 'deviation of the error of the known position', unit='m', low=0.0, high=1.0
    )
    heading_noise: float = setting(
        0.0, 'deviation of the error of the known heading', unit='rad', low=0.0, high=0.5
    )
    patience: float = setting(
        4.0, 'without motion until a vehicle backs off', unit='s', low=0.5, high=60.0
    )
    back_off: float = setting(0.3, 'it backs off so far', unit='m', low=0.0, high=2.0)
    noise_time: float = setting(20.0, 'that error wanders within', unit='s', low=0.1, high=1000.0)


@dataclass(frozen=True)
class Collision:
    """A contact: when, which vehicle, with which other one; None is an obstacle."""

    stamp: float
    vehicle: str
    other: str | None


@dataclass
class _Drive:
    """What changes about one vehicle beside its pose."""

    plan: Plan | None = None
    segment: int = 0
    arrived: bool = True
    speed: float = 0.0
    turn: float = 0.0
    backing: float = 0.0
    travelled: float = 0.0
    error: Array = field(default_factory=lambda: np.zeros(3))
    touching: str | None = None
    last_moved: float = 0.0
    last_tried: float = 0.0
    last_place: tuple[float, float] = (0.0, 0.0)
    tried_place: tuple[float, float] = (0.0, 0.0)


class GridSimulator:
    """A team of vehicles in a grid world; one call of step() is one tick."""

    def __init__(
        self,
        world: GridWorld,
        starts: Mapping[str, Pose2],
        config: GridSimulatorConfig | None = None,
        seed: int = 0,
    ) -> None:
        self.world = world
        self.config = config or GridSimulatorConfig()
        self.vehicles = tuple(starts)
        if not 1 <= len(starts) <= MAX_VEHICLES:
            raise SimulationError(
                f'grid simulator: {len(starts)} vehicles, expected 1 to {MAX_VEHICLES}'
            )
        for name, pose in starts.items():
            self._check_start(name, pose)
        self.time = 0.0
        self.collisions: list[Collision] = []
        self._rng = np.random.default_rng(seed)
        self._ticks = 0
        self._poses = np.array([tuple(pose) for pose in starts.values()], dtype=np.float64)
        self._origin = np.array(world.origin, dtype=np.float64)
        self._drives = [_Drive(last_place=(pose.x, pose.y)) for pose in starts.values()]
        self._index = {name: index for index, name in enumerate(self.vehicles)}
        half = 0.5 * self.config.field_of_view
        self._angles = np.linspace(-half, half, self.config.beams)
        self._ranges = np.zeros(self.config.beams)
        self._check_apart()
        self.reachable = world.reachable(self._poses[:, :2], self.config.reach_clearance)
        self.reachable_cells = max(1, int(np.count_nonzero(self.reachable)))
        self._seen = np.zeros(world.shape, np.uint32)
        self._own_cells = [0] * len(self.vehicles)
        self._team_cells = 0
        for index in range(len(self.vehicles)):
            self._wander(index, settled=True)

    def _check_start(self, name: str, pose: Pose2) -> None:
        if not pose.is_finite() or not self.world.is_inside(pose):
            raise SimulationError(f'grid simulator: {name} starts at {tuple(pose)}, outside')
        row, col = self.world.to_cell(np.array([pose[:2]]))[0]
        if self.world.cells[row, col] != kernels.FREE:
            raise SimulationError(
                f'grid simulator: {name} starts at {tuple(pose)}, in an obstacle'
            )

    def _check_apart(self) -> None:
        for index, name in enumerate(self.vehicles):
            x, y, _ = self._poses[index]
            if kernels.nearest_other(self._poses, index, x, y) < 2.0 * self.config.body_radius:
                raise SimulationError(f'grid simulator: {name} starts upon another vehicle')

    # -- what is known -----------------------------------------------------------------------

    def true_pose(self, vehicle: str) -> Pose2:
        """Return where a vehicle is."""
        return Pose2.from_array(self._poses[self._index[vehicle]])

    def known_pose(self, vehicle: str) -> Pose2:
        """Return where a vehicle believes to be: the true pose and its present error."""
        index = self._index[vehicle]
        return Pose2.from_array(self._poses[index] + self._drives[index].error)

    def travelled(self, vehicle: str) -> float:
        """Return the length (m) of the path driven."""
        return self._drives[self._index[vehicle]].travelled

    def is_idle(self, vehicle: str) -> bool:
        """Tell whether a vehicle has no plan or has come to its end."""
        drive = self._drives[self._index[vehicle]]
        return drive.plan is None or drive.arrived

    def stalled_for(self, vehicle: str) -> float:
        """Return for how long (s) a vehicle with a plan has not got on (backing off apart)."""
        drive = self._drives[self._index[vehicle]]
        return 0.0 if self.is_idle(vehicle) else self.time - drive.last_moved

    def team_coverage(self) -> float:
        """Return the share of the reachable cells that any beam has crossed."""
        return self._team_cells / self.reachable_cells

    def own_coverage(self, vehicle: str) -> float:
        """Return the share of the reachable cells that this vehicle's beams have crossed."""
        return self._own_cells[self._index[vehicle]] / self.reachable_cells

    def seen(self, vehicle: str) -> NDArray[np.bool_]:
        """Return the cells (H, W) that this vehicle's beams have crossed."""
        mask: NDArray[np.bool_] = (self._seen & np.uint32(1 << self._index[vehicle])) != 0
        return mask

    # -- orders ------------------------------------------------------------------------------

    def set_plan(self, vehicle: str, plan: Plan | None) -> None:
        """Give a vehicle a plan to follow from now on, or None to stop."""
        drive = self._drives[self._index[vehicle]]
        if drive.plan is None or drive.arrived:
            drive.last_moved = drive.last_tried = self.time
        drive.plan = plan if plan is not None and len(plan.waypoints) else None
        drive.segment = 0
        drive.arrived = False

    def scan(self, vehicle: str) -> LaserScan:
        """Return what the laser at the vehicle's center sees now, and remember what it saw."""
        index, config = self._index[vehicle], self.config
        others = np.delete(self._poses, index, axis=0)
        bodies = np.column_stack([others[:, :2], np.full(len(others), config.body_radius)])
        own, team = kernels.cast_beams(
            self.world.cells,
            self.world.resolution,
            self._origin,
            self._poses[index],
            self._angles,
            config.beam_range,
            bodies,
            np.uint32(1 << index),
            self.reachable,
            self._seen,
            self._ranges,
        )
        self._own_cells[index] += own
        self._team_cells += team
        ranges = self._ranges.copy()
        if config.range_noise:
            ranges += self._rng.normal(0.0, config.range_noise, ranges.size)
            ranges[ranges >= config.beam_range] = np.inf
        step = self._angles[1] - self._angles[0] if ranges.size > 1 else 0.0
        return LaserScan(
            stamp=self.time,
            angle_min=float(self._angles[0]),
            angle_increment=float(step),
            ranges=np.maximum(ranges, 0.02).astype(np.float32),
            range_min=0.02,
            range_max=config.beam_range,
        )

    # -- motion ------------------------------------------------------------------------------

    def step(self) -> None:
        """Let one tick go by: every vehicle steers, brakes and moves."""
        self._ticks += 1
        self.time = self._ticks * self.config.tick
        for index in range(len(self.vehicles)):
            self._wander(index)
            self._steer(index)
            self._move(index)

    def _wander(self, index: int, settled: bool = False) -> None:
        """Let the error of the known pose wander (Ornstein-Uhlenbeck process)."""
        config, drive = self.config, self._drives[index]
        if config.position_noise or config.heading_noise:
            sigmas = np.array([config.position_noise, config.position_noise, config.heading_noise])
            keep = 0.0 if settled else math.exp(-config.tick / config.noise_time)
            fresh = sigmas * self._rng.normal(size=3)
            drive.error = keep * drive.error + math.sqrt(1.0 - keep * keep) * fresh

    def _steer(self, index: int) -> None:
        config, drive = self.config, self._drives[index]
        wanted_speed, wanted_turn = 0.0, 0.0
        driving = drive.plan is not None and not drive.arrived
        if driving and self.time - drive.last_tried >= config.patience:
            drive.last_tried, drive.backing = self.time, config.back_off
        if drive.backing > 0.0:
            self._back_off(index)
            return
        if driving and drive.plan is not None:
            wanted_speed, wanted_turn, drive.segment, drive.arrived = kernels.pursue(
                np.ascontiguousarray(drive.plan.waypoints, dtype=np.float64),
                drive.segment,
                self._poses[index] + drive.error,
                self._lookahead(index),
                config.arrival_distance,
                config.cruise_speed,
                config.turn_rate,
                config.braking,
            )
            if drive.arrived:
                # There, but perhaps not yet looking where the plan wants it to look.
                known = float(self._poses[index, 2] + drive.error[2])
                aside = wrap_angle(drive.plan.goal.theta - known)
                drive.arrived = abs(aside) <= LOOKS_THERE
                wanted_turn = min(max(2.5 * aside, -config.turn_rate), config.turn_rate)
        change = config.turn_acceleration * config.tick
        drive.turn = min(max(wanted_turn, drive.turn - change), drive.turn + change)
        wanted_speed = min(wanted_speed, self._safe_speed(index)) if wanted_speed > 0.0 else 0.0
        rise, fall = config.acceleration * config.tick, config.braking * config.tick
        drive.speed = min(max(wanted_speed, drive.speed - fall), drive.speed + rise)

    def _lookahead(self, index: int) -> float:
        """Return the lookahead (m): short in narrow places, where corners must not be cut."""
        x, y, _ = self._poses[index]
        field_at = (self.world.clearance, self.world.resolution, self._origin)
        room = kernels.sample_field(*field_at, x, y) - self.config.body_radius
        return min(max(2.0 * room, SHORT_LOOK), self.config.pursuit_distance)

    def _back_off(self, index: int) -> None:
        """Drive straight back, slowly, until far enough or something lies behind."""
        config, drive = self.config, self._drives[index]
        behind = self._poses.copy()
        behind[index, 2] += math.pi
        needed = config.body_radius + config.wall_margin
        field_at = (self.world.clearance, self.world.resolution, self._origin)
        room = min(
            kernels.free_distance(*field_at, behind[index], needed, 0.2),
            kernels.room_before_others(behind, index, 2.0 * config.body_radius + 0.1),
        )
        drive.turn = 0.0
        drive.speed = -BACKING_SPEED if room > 2.0 * BACKING_SPEED * config.tick else 0.0
        drive.backing += drive.speed * config.tick if drive.speed else -drive.backing

    def _safe_speed(self, index: int) -> float:
        """Return the speed from which the vehicle can stop in time for what lies ahead.

        Obstacles (the sonar ring sees glass too) leave it the whole room, straight on and where
        its turn leads it; before another vehicle it may use half of it, for that one may come
        nearer as well.
        """
        config = self.config
        reach = config.cruise_speed**2 / (2.0 * config.braking) + config.cruise_speed * config.tick
        turned = np.array([0.0, 0.0, self._drives[index].turn])
        room = min(
            kernels.free_distance(
                self.world.clearance,
                self.world.resolution,
                self._origin,
                self._poses[index] + later * turned,
                config.body_radius + config.wall_margin,
                2.0 * reach,
            )
            for later in (0.0, config.tick, 3.0 * config.tick)
        )
        apart = 2.0 * config.body_radius + config.vehicle_margin
        before = 0.5 * kernels.room_before_others(self._poses, index, apart)
        room = min(room, before) - config.cruise_speed * config.tick * 0.5
        return math.sqrt(2.0 * config.braking * room) if room > 0.0 else 0.0

    def _move(self, index: int) -> None:
        """Move one vehicle by a tick unless it would touch something; count new contacts."""
        config, drive = self.config, self._drives[index]
        x, y, theta = self._poses[index]
        turned = drive.turn * config.tick
        moved = drive.speed * config.tick
        nx = x + moved * math.cos(theta + 0.5 * turned)
        ny = y + moved * math.sin(theta + 0.5 * turned)
        self._poses[index, 2] = wrap_angle(theta + turned)
        touching = self._contact(index, (x, y), (nx, ny)) if moved else drive.touching
        if touching is not None and moved:
            drive.speed = 0.0
            if touching != drive.touching:
                other = touching or None
                self.collisions.append(Collision(self.time, self.vehicles[index], other))
        elif moved:
            self._poses[index, 0], self._poses[index, 1] = nx, ny
            drive.travelled += abs(moved)
        drive.touching = touching
        place = (float(self._poses[index, 0]), float(self._poses[index, 1]))
        if math.dist(place, drive.tried_place) > 0.1:
            drive.last_tried, drive.tried_place = self.time, place
        if math.dist(place, drive.last_place) > 2.0 * config.back_off:
            drive.last_moved, drive.last_place = self.time, place

    def _contact(
        self, index: int, old: tuple[float, float], new: tuple[float, float]
    ) -> str | None:
        """Return the vehicle touched by going there, '' for an obstacle, None for nothing."""
        poses, radius = self._poses, self.config.body_radius
        near = kernels.nearest_other(poses, index, *new)
        if near < 2.0 * radius and near < kernels.nearest_other(poses, index, *old):
            gaps = np.hypot(poses[:, 0] - new[0], poses[:, 1] - new[1])
            gaps[index] = np.inf
            return self.vehicles[int(np.argmin(gaps))]
        field_at = (self.world.clearance, self.world.resolution, self._origin)
        clearance = kernels.sample_field(*field_at, *new)
        if clearance < radius and clearance < kernels.sample_field(*field_at, *old) - 1e-9:
            return ''
        return None


def warm_up() -> None:
    """Compile the kernels, so that no run pays for it."""
    kernels.compile_kernels()
