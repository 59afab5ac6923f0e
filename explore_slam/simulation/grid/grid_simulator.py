"""Kinematic vehicles with a laser in a grid world, for planning studies: no rendering, no ROS.

Vehicles are discs that follow plans with the speeds and accelerations of a Pioneer 3-DX and stop
in front of obstacles and of each other. Their pose is known exactly, or with an error that drifts.
A scenario lets doors close, people stand in the way, and vehicles fail.
"""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import LaserScan, Plan
from explore_slam.errors import SimulationError
from explore_slam.geometry import Array, Pose2, wrap_angle
from explore_slam.settings import Section, setting
from explore_slam.simulation.grid import kernels
from explore_slam.simulation.grid.scenario import Changes, Scenario
from explore_slam.simulation.records import WALL, Collision
from explore_slam.simulation.worlds.grid_world import FREE, GridWorld
from explore_slam.sweeps import LONGEST_SWEEP

MAX_VEHICLES = 31  # each has a bit in the 32-bit mask of who has seen a cell
RANGE_MIN = 0.02  # m, minimum range in a scan

# Path following and collision avoidance: chosen so that teams in narrow buildings neither collide
# nor block each other for good (test_grid_world.py, benchmarks/grid_world_speed.py).
LOOKAHEAD = 0.35  # m
SHORTEST_LOOKAHEAD = 0.12  # m, in narrow places
ARRIVAL_DISTANCE = 0.2  # m from the goal
ARRIVAL_ANGLE = 0.2  # rad from the goal's heading
WALL_MARGIN = 0.003  # m kept from obstacles
VEHICLE_MARGIN = 0.15  # m kept from other vehicles
BACKING_MARGIN = 0.1  # m kept from other vehicles behind
TURN_GAIN = 2.5  # 1/s, turn rate per heading error at the goal
BLOCKED_TIME = 4.0  # s without motion until a vehicle backs off
BACKING_DISTANCE = 0.3  # m
BACKING_SPEED = 0.15  # m/s
MOVED = 0.1  # m that count as motion


@dataclass(frozen=True)
class GridSimulatorConfig(Section):
    """Vehicles, their lasers, and the error of their known poses."""

    disc_radius: float = setting(
        0.22, 'Radius of the disc that stands for a vehicle; half the length of a Pioneer 3-DX',
        unit='m', low=0.05, high=2.0, tier='basic',
    )  # fmt: skip
    reach_clearance: float = setting(
        0.3, 'Cells count as reachable if a disc of this radius can cover them',
        unit='m', low=0.05, high=2.0,
    )  # fmt: skip
    cruise_speed: float = setting(
        0.5, 'Speed on a straight path', unit='m/s', low=0.05, high=3.0, tier='basic'
    )
    turn_rate: float = setting(1.0, 'Maximum turn rate', unit='rad/s', low=0.1, high=6.0)
    acceleration: float = setting(0.5, 'Forward acceleration', unit='m/s²', low=0.05, high=10.0)
    braking: float = setting(1.0, 'Deceleration', unit='m/s²', low=0.05, high=10.0)
    turn_acceleration: float = setting(
        2.0, 'Angular acceleration', unit='rad/s²', low=0.1, high=20.0
    )
    time_step: float = setting(0.1, 'Time step of the simulation', unit='s', low=0.01, high=0.5)
    beams: int = setting(361, 'Beams of a scan', low=1, high=5000)
    field_of_view: float = setting(
        math.pi, 'Angle between the first and the last beam', unit='rad', low=0.1,
        high=2.0 * math.pi,
    )  # fmt: skip
    beam_range: float = setting(
        8.0, 'Maximum range of the laser', unit='m', low=0.5, high=100.0, tier='basic'
    )
    range_noise: float = setting(
        0.01, 'Standard deviation of a range', unit='m', low=0.0, high=0.5
    )
    sweep_time: float = setting(
        0.0,
        'Time from the first to the last beam of a scan, which ends when it is asked for and is '
        'stamped at its first beam; 0: all at one moment',
        unit='s', low=0.0, high=LONGEST_SWEEP,
    )  # fmt: skip
    position_noise: float = setting(
        0.0, 'Standard deviation of x and y of the known pose', unit='m', low=0.0, high=1.0
    )
    heading_noise: float = setting(
        0.0, 'Standard deviation of the heading of the known pose', unit='rad', low=0.0, high=0.5
    )
    error_time_constant: float = setting(
        20.0, 'Correlation time of the error of the known pose', unit='s', low=0.1, high=1000.0
    )


@dataclass
class _Drive:
    """State of one vehicle beside its pose."""

    plan: Plan | None = None
    segment: int = 0  # of the plan, followed last
    arrived: bool = True
    speed: float = 0.0  # m/s
    turn: float = 0.0  # rad/s
    backing: float = 0.0  # m still to back off
    travelled: float = 0.0  # m
    error: Array = field(default_factory=lambda: np.zeros(3))  # of the known pose
    touching: str = ''  # the obstacle in contact, WALL or a vehicle
    progress_time: float = 0.0  # s, when the vehicle last left progress_place
    progress_place: tuple[float, float] = (0.0, 0.0)
    motion_time: float = 0.0  # s, when the vehicle last moved on, or last began to back off
    motion_place: tuple[float, float] = (0.0, 0.0)


class GridSimulator:
    """A team of vehicles in a grid world; equal seeds and plans give equal runs."""

    def __init__(
        self,
        world: GridWorld,
        starts: Mapping[str, Pose2],
        config: GridSimulatorConfig | None = None,
        seed: int = 0,
        scenario: Scenario | None = None,
        own_configs: Mapping[str, GridSimulatorConfig] | None = None,
    ) -> None:
        """Place vehicles at their start poses.

        own_configs: of vehicles that differ from the others; their time_step is that of all.
        Raises SimulationError for too many vehicles, for poses outside, in obstacles or closer
        to each other than two radii, and for a scenario that does not fit the world.
        """
        self.world = world
        self.scenario = scenario or Scenario()
        self.scenario.check(world, starts)
        self.config = config or GridSimulatorConfig()
        self.vehicles = tuple(starts)
        own = own_configs or {}
        self._configs = [
            replace(own.get(name, self.config), time_step=self.config.time_step) for name in starts
        ]
        self._radii = np.array([one.disc_radius for one in self._configs])
        self._longest_sweep = max((one.sweep_time for one in self._configs), default=0.0)
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
        self._past = deque([(0.0, self._poses.copy())])  # times (s) and poses in the last sweep
        origin = np.array(world.origin, dtype=np.float64)
        self._origin = origin
        self._changes = Changes(world, self.scenario)
        self._changes.update(0.0, self._poses[:, :2])
        self._use(self._changes.world)
        self._drives = [_Drive(progress_place=(pose.x, pose.y)) for pose in starts.values()]
        self._index = {name: index for index, name in enumerate(self.vehicles)}
        self._angles = [
            np.linspace(-0.5 * one.field_of_view, 0.5 * one.field_of_view, one.beams)
            for one in self._configs
        ]
        self._ranges = [np.zeros(one.beams) for one in self._configs]
        self._check_apart()
        self.reachable = self._reachable(self.scenario.final_world(world))
        self.reachable_cells = max(1, int(np.count_nonzero(self.reachable)))
        self._seen = np.zeros(world.shape, np.uint32)
        self._own_cells = [0] * len(self.vehicles)
        self._team_cells = 0
        for index in range(len(self.vehicles)):
            self._drift(index, stationary=True)

    def _use(self, world: GridWorld) -> None:
        """Let beams and bodies meet the cells of a world."""
        self._cells = kernels.Cells(world.cells, world.resolution, self._origin)
        self._clearance = kernels.ClearanceField(world.clearance, world.resolution, self._origin)

    def _check_start(self, name: str, pose: Pose2) -> None:
        if not pose.is_finite() or not self.world.is_inside(pose):
            raise SimulationError(
                f'grid simulator: {name} starts at {tuple(pose)}, outside the world'
            )
        row, col = self.world.to_cell(np.array([pose[:2]]))[0]
        if self.world.cells[row, col] != FREE:
            raise SimulationError(
                f'grid simulator: {name} starts at {tuple(pose)}, in an obstacle'
            )

    def _check_apart(self) -> None:
        for index, name in enumerate(self.vehicles):
            x, y, _ = self._poses[index]
            gap = kernels.smallest_gap(self._poses, self._radii, index, x, y)
            if gap < 0.0:
                raise SimulationError(
                    f'grid simulator: {name} starts with its disc {-gap:.2f} m within that of '
                    f'another vehicle (disc_radius {self._radii[index]:g} m)'
                )

    def _reachable(self, world: GridWorld) -> NDArray[np.bool_]:
        """Return the cells (H, W) that some vehicle can cover, each with its own clearance."""
        clearances = [one.reach_clearance for one in self._configs]
        covered = np.zeros(world.shape, np.bool_)
        for clearance in set(clearances):
            alike = [index for index, own in enumerate(clearances) if own == clearance]
            covered |= world.reachable(self._poses[alike, :2], clearance)
        return covered

    def config_of(self, vehicle: str) -> GridSimulatorConfig:
        """Return the settings of a vehicle."""
        return self._configs[self._index[vehicle]]

    # -- state -------------------------------------------------------------------------------

    def true_pose(self, vehicle: str) -> Pose2:
        """Return the true pose of a vehicle."""
        return Pose2.from_array(self._poses[self._index[vehicle]])

    def known_pose(self, vehicle: str) -> Pose2:
        """Return the pose a vehicle knows: the true pose with its present error."""
        index = self._index[vehicle]
        return Pose2.from_array(self._poses[index] + self._drives[index].error)

    def set_known_pose(self, vehicle: str, pose: Pose2) -> None:
        """Let a vehicle know a pose, such as an estimate, and follow its plan by it.

        The difference to the true pose remains until the next call; with position_noise or
        heading_noise it fades.
        """
        index = self._index[vehicle]
        error = np.array(pose) - self._poses[index]
        error[2] = wrap_angle(float(error[2]))
        self._drives[index].error = error

    def travelled(self, vehicle: str) -> float:
        """Return the length (m) of the path driven."""
        return self._drives[self._index[vehicle]].travelled

    def is_idle(self, vehicle: str) -> bool:
        """Return whether a vehicle has no plan or has reached the goal of its plan."""
        drive = self._drives[self._index[vehicle]]
        return drive.plan is None or drive.arrived

    def stalled_for(self, vehicle: str) -> float:
        """Return for how long (s) a vehicle with a plan has made no progress.

        Backing off and returning to the same place is no progress.
        """
        drive = self._drives[self._index[vehicle]]
        return 0.0 if self.is_idle(vehicle) else self.time - drive.progress_time

    def is_silent(self, vehicle: str) -> bool:
        """Return whether nothing arrives from a vehicle now."""
        return self.scenario.conditions(vehicle, self.time).silent

    def team_coverage(self) -> float:
        """Return the fraction of the reachable cells that any vehicle's beams have crossed."""
        return self._team_cells / self.reachable_cells

    def own_coverage(self, vehicle: str) -> float:
        """Return the fraction of the reachable cells that this vehicle's beams have crossed."""
        return self._own_cells[self._index[vehicle]] / self.reachable_cells

    def seen(self, vehicle: str) -> NDArray[np.bool_]:
        """Return the cells (H, W) that this vehicle's beams have crossed."""
        mask: NDArray[np.bool_] = (self._seen & np.uint32(1 << self._index[vehicle])) != 0
        return mask

    # -- inputs and sensors ------------------------------------------------------------------

    def set_plan(self, vehicle: str, plan: Plan | None) -> None:
        """Set the plan of a vehicle; None, or a plan without waypoints, stops it."""
        drive = self._drives[self._index[vehicle]]
        if drive.plan is None or drive.arrived:
            drive.progress_time = drive.motion_time = self.time
        drive.plan = plan if plan is not None and len(plan.waypoints) else None
        drive.segment = 0
        drive.arrived = False

    def scan(self, vehicle: str) -> LaserScan:
        """Return a scan from the vehicle's centre; the cells it crosses count as seen.

        With a sweep_time, it has begun that long ago, at most when the simulation began, and each
        beam starts where the vehicle was at its time. Other vehicles are where they are now.
        """
        index, config = self._index[vehicle], self.config_of(vehicle)
        every = np.column_stack([self._poses[:, :2], self._radii])
        bodies = np.delete(every, index, axis=0)
        stamp, poses = self._sweep(index)
        own, team = kernels.cast_beams(
            self._cells,
            kernels.Sweep(poses, self._angles[index], config.beam_range),
            bodies,
            kernels.Coverage(self.reachable, self._seen, np.uint32(1 << index)),
            self._ranges[index],
        )
        self._own_cells[index] += own
        self._team_cells += team
        angles, ranges = self._angles[index], self._ranges[index].copy()
        if config.range_noise:
            ranges += self._rng.normal(0.0, config.range_noise, ranges.size)
            ranges[ranges >= config.beam_range] = np.inf
        step = angles[1] - angles[0] if ranges.size > 1 else 0.0
        return LaserScan(
            stamp=stamp,
            angle_min=float(angles[0]),
            angle_increment=float(step),
            ranges=np.maximum(ranges, RANGE_MIN).astype(np.float32),
            range_min=RANGE_MIN,
            range_max=config.beam_range,
            time_increment=(self.time - stamp) / max(ranges.size - 1, 1),
        )

    def _sweep(self, index: int) -> tuple[float, Array]:
        """Return when the first beam of a scan is measured (s), and the pose (B, 3) at each."""
        beams = self._angles[index].size
        begin = max(self.time - self._configs[index].sweep_time, 0.0)
        if begin == self.time:
            return begin, np.tile(self._poses[index], (beams, 1))
        at = np.array([time for time, _ in self._past])
        past = np.array([poses[index] for _, poses in self._past])
        times = np.linspace(begin, self.time, beams)
        columns = (past[:, 0], past[:, 1], np.unwrap(past[:, 2]))
        poses = np.stack([np.interp(times, at, column) for column in columns], axis=1)
        return begin, poses

    # -- motion ------------------------------------------------------------------------------

    def step(self) -> None:
        """Advance by one time step: each vehicle in turn steers, brakes and moves."""
        self._ticks += 1
        self.time = self._ticks * self.config.time_step
        if self._changes.update(self.time, self._poses[:, :2]):
            self._use(self._changes.world)
        for index in range(len(self.vehicles)):
            self._drift(index)
            self._steer(index)
            self._move(index)
        self._past.append((self.time, self._poses.copy()))
        while len(self._past) > 2 and self._past[1][0] <= self.time - self._longest_sweep:
            self._past.popleft()

    def _drift(self, index: int, stationary: bool = False) -> None:
        """Advance the error of the known pose (Ornstein-Uhlenbeck process).

        stationary: draw it from the stationary distribution instead.
        """
        config, drive = self._configs[index], self._drives[index]
        if config.position_noise or config.heading_noise:
            sigmas = np.array([config.position_noise, config.position_noise, config.heading_noise])
            keep = 0.0 if stationary else math.exp(-config.time_step / config.error_time_constant)
            fresh = sigmas * self._rng.normal(size=3)
            drive.error = keep * drive.error + math.sqrt(1.0 - keep * keep) * fresh

    def _steer(self, index: int) -> None:
        """Set speed and turn rate of a vehicle for this time step."""
        config, drive = self._configs[index], self._drives[index]
        wanted_speed, wanted_turn = 0.0, 0.0
        driving = drive.plan is not None and not drive.arrived
        if driving and self.time - drive.motion_time >= BLOCKED_TIME:
            drive.motion_time, drive.backing = self.time, BACKING_DISTANCE
        if drive.backing > 0.0:
            self._back_off(index)
            factor = self.scenario.conditions(self.vehicles[index], self.time).speed_factor
            drive.speed *= factor
            return
        if driving and drive.plan is not None:
            pursuit = kernels.Pursuit(
                self._lookahead(index),
                ARRIVAL_DISTANCE,
                config.cruise_speed,
                config.turn_rate,
                config.braking,
            )
            wanted_speed, wanted_turn, drive.segment, drive.arrived = kernels.pursue(
                np.ascontiguousarray(drive.plan.waypoints, dtype=np.float64),
                drive.segment,
                self._poses[index] + drive.error,
                pursuit,
            )
            if drive.arrived:  # at the goal's position: turn to its heading
                known = float(self._poses[index, 2] + drive.error[2])
                aside = wrap_angle(drive.plan.goal.theta - known)
                drive.arrived = abs(aside) <= ARRIVAL_ANGLE
                wanted_turn = min(max(TURN_GAIN * aside, -config.turn_rate), config.turn_rate)
        change = config.turn_acceleration * config.time_step
        drive.turn = min(max(wanted_turn, drive.turn - change), drive.turn + change)
        wanted_speed = min(wanted_speed, self._safe_speed(index)) if wanted_speed > 0.0 else 0.0
        rise, fall = config.acceleration * config.time_step, config.braking * config.time_step
        drive.speed = min(max(wanted_speed, drive.speed - fall), drive.speed + rise)
        factor = self.scenario.conditions(self.vehicles[index], self.time).speed_factor
        if factor < 1.0:
            drive.speed = min(drive.speed, factor * config.cruise_speed)
            drive.turn *= factor

    def _lookahead(self, index: int) -> float:
        """Return the lookahead (m), short in narrow places, where corners must not be cut."""
        x, y, _ = self._poses[index]
        room = kernels.sample_field(self._clearance, x, y) - self._configs[index].disc_radius
        return min(max(2.0 * room, SHORTEST_LOOKAHEAD), LOOKAHEAD)

    def _back_off(self, index: int) -> None:
        """Drive straight back until the backing distance is driven or something is behind."""
        config, drive = self._configs[index], self._drives[index]
        behind = self._poses.copy()
        behind[index, 2] += math.pi
        needed = config.disc_radius + WALL_MARGIN
        room = min(
            kernels.free_distance(self._clearance, behind[index], needed, 0.2),
            kernels.distance_to_others(behind, self._radii, index, BACKING_MARGIN),
        )
        drive.turn = 0.0
        drive.speed = -BACKING_SPEED if room > 2.0 * BACKING_SPEED * config.time_step else 0.0
        drive.backing += drive.speed * config.time_step if drive.speed else -drive.backing

    def _safe_speed(self, index: int) -> float:
        """Return the speed (m/s) from which the vehicle can stop before what lies ahead.

        Obstacles (glass too, as for a sonar ring) allow the whole distance to them, straight ahead
        and in the directions of the next time steps. Another vehicle allows half of the distance,
        since it may approach as well.
        """
        config = self._configs[index]
        cruise, braking, step = config.cruise_speed, config.braking, config.time_step
        reach = cruise**2 / (2.0 * braking) + cruise * step
        turned = np.array([0.0, 0.0, self._drives[index].turn])
        needed = config.disc_radius + WALL_MARGIN
        room = min(
            kernels.free_distance(
                self._clearance, self._poses[index] + later * turned, needed, 2.0 * reach
            )
            for later in (0.0, step, 3.0 * step)
        )
        before = 0.5 * kernels.distance_to_others(self._poses, self._radii, index, VEHICLE_MARGIN)
        room = min(room, before) - cruise * step * 0.5
        return math.sqrt(2.0 * braking * room) if room > 0.0 else 0.0

    def _move(self, index: int) -> None:
        """Move a vehicle over a time step unless it would touch something; record contacts."""
        config, drive = self._configs[index], self._drives[index]
        x, y, theta = self._poses[index]
        turned = drive.turn * config.time_step
        moved = drive.speed * config.time_step
        nx = x + moved * math.cos(theta + 0.5 * turned)
        ny = y + moved * math.sin(theta + 0.5 * turned)
        self._poses[index, 2] = wrap_angle(theta + turned)
        touching = self._contact(index, (x, y), (nx, ny)) if moved else drive.touching
        if touching and moved:
            drive.speed = 0.0
            if touching != drive.touching:
                self.collisions.append(Collision(self.time, self.vehicles[index], touching))
        elif moved:
            self._poses[index, 0], self._poses[index, 1] = nx, ny
            drive.travelled += abs(moved)
        drive.touching = touching
        place = (float(self._poses[index, 0]), float(self._poses[index, 1]))
        if math.dist(place, drive.motion_place) > MOVED:
            drive.motion_time, drive.motion_place = self.time, place
        if math.dist(place, drive.progress_place) > 2.0 * BACKING_DISTANCE:
            drive.progress_time, drive.progress_place = self.time, place

    def _contact(self, index: int, old: tuple[float, float], new: tuple[float, float]) -> str:
        """Return the obstacle touched by a motion: a vehicle's name, WALL, or '' for none."""
        poses, radii, radius = self._poses, self._radii, self._radii[index]
        near = kernels.smallest_gap(poses, radii, index, *new)
        if near < 0.0 and near < kernels.smallest_gap(poses, radii, index, *old):
            gaps = np.hypot(poses[:, 0] - new[0], poses[:, 1] - new[1]) - radii
            gaps[index] = np.inf
            return self.vehicles[int(np.argmin(gaps))]
        clearance = kernels.sample_field(self._clearance, *new)
        if clearance < radius and clearance < kernels.sample_field(self._clearance, *old) - 1e-9:
            return WALL
        return ''


def warm_up() -> None:
    """Compile the kernels, so that no run waits for the compiler."""
    kernels.warm_up()
