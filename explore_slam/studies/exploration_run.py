"""One run of an exploration study: the planner explores a grid world with a team.

Grid map and planner are those of the agent. Poses are known up to a correlated error, so that the
study measures planning alone, or the whole agent estimates them (SlamSettings). Every run
terminates: complete, stuck, or at the time limit.
"""

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from explore_slam.agent import AgentConfig
from explore_slam.data import Plan, VehicleBody
from explore_slam.exploration import ExplorationConfig, ExplorationStatus, PlanningResult
from explore_slam.geometry import Pose2
from explore_slam.mapping import GridConfig
from explore_slam.results.coverage import CoverageCurve, GoalCounter
from explore_slam.settings import Section, setting, with_values
from explore_slam.simulation.config import SimulatedOdometryConfig
from explore_slam.simulation.grid.grid_simulator import GridSimulator, GridSimulatorConfig
from explore_slam.simulation.grid.scenario import Scenario
from explore_slam.simulation.records import WALL
from explore_slam.simulation.worlds.grid_world import GridWorld
from explore_slam.studies.team_mapping import KnownPoses, TeamMapping, TeamSlam

TIME_LIMIT = 'time_limit'


@dataclass(frozen=True)
class StudyConfig(Section):
    """Configuration of the runs of a study; vehicles and planner have their own."""

    cell_size: float = setting(0.1, 'cell size of the grid map', unit='m', low=0.02, high=0.5)
    scan_period: float = setting(
        0.5, 'time between scans of a vehicle', unit='s', low=0.05, high=10.0
    )
    planning_period: float = setting(
        2.0, 'time between planning cycles', unit='s', low=0.1, high=60.0
    )
    stall_time: float = setting(
        8.0,
        'time without progress after which a goal is reported as blocked',
        unit='s',
        low=1.0,
        high=120.0,
    )
    stuck_time: float = setting(
        60.0, 'time without any plan after which a run ends', unit='s', low=1.0, high=600.0
    )
    time_limit: float = setting(
        7200.0,
        'simulated time after which a run ends',
        unit='s',
        low=1.0,
        high=1e6,
        tier='basic',
    )
    position_error: float = setting(
        0.02, 'standard deviation of the known position, without SLAM', unit='m', low=0.0, high=1.0
    )
    heading_error: float = setting(
        0.003,
        'standard deviation of the known heading, without SLAM',
        unit='rad',
        low=0.0,
        high=0.5,
    )
    vehicles_known: bool = setting(
        True,
        'whether the planner knows how vehicles differ in radius, speed and view; false shows '
        'what that is worth',
    )
    home_at_end: bool = setting(False, 'drive home when exploration is complete', tier='basic')


class SlamSettings(NamedTuple):
    """Settings of runs with the whole agent: of the agent, by name, and of the wheel odometry."""

    agent: Mapping[str, Any] = MappingProxyType({})
    odometry: SimulatedOdometryConfig = SimulatedOdometryConfig()


class Vehicles(NamedTuple):
    """The simulated vehicles of a team: config of all but those that have their own, by name."""

    config: GridSimulatorConfig
    own: Mapping[str, GridSimulatorConfig]

    def body(self, vehicle: str) -> VehicleBody:
        """Return what the planner knows of a vehicle.

        The disc and the speed of a usual vehicle stand for the standard body, with which the
        planner has room for errors; those of others differ from it as much as their discs and in
        the ratio of their speeds.
        """
        usual, one = self.config, self.own.get(vehicle)
        if one is None:
            return VehicleBody()
        standard = VehicleBody()
        return VehicleBody(
            standard.radius + (one.disc_radius - usual.disc_radius),
            standard.speed * (one.cruise_speed / usual.cruise_speed),
            sensor_range=None if one.beam_range == usual.beam_range else one.beam_range,
            field_of_view=one.field_of_view,
        )


@dataclass(frozen=True)
class ExplorationRun:
    """Result of one run; lengths in metres, times in simulated seconds unless named wall.

    map_rms: position error of the scans in the map; None if the poses were known.
    """

    strategy: str
    vehicles: int
    seed: int
    status: str
    reason: str
    duration: float
    curve: CoverageCurve
    mapped: float
    paths: tuple[float, ...]
    goals_given: int
    goals_changed: int
    vehicle_collisions: int
    wall_collisions: int
    stalls: int
    plannings: int
    planning_seconds: float
    wall_seconds: float
    unreached_frontiers: int = 0
    unreached_m2: float = 0.0
    map_rms: float | None = None

    @property
    def longest_path(self) -> float:
        """Longest path of a vehicle (m)."""
        return max(self.paths)

    @property
    def path_spread(self) -> float:
        """Coefficient of variation of the path lengths of the vehicles."""
        mean = float(np.mean(self.paths))
        return float(np.std(self.paths)) / mean if mean > 0.0 else 0.0

    @property
    def real_time_factor(self) -> float:
        """Simulated time per wall time, planning included."""
        return self.duration / self.wall_seconds if self.wall_seconds > 0.0 else math.inf


@dataclass
class _Team:
    """State of one run."""

    simulator: GridSimulator
    mapping: TeamMapping
    goals: dict[str, GoalCounter]
    plans: dict[str, Plan | None] = field(default_factory=dict)
    stalls: int = 0
    plannings: int = 0
    planning_seconds: float = 0.0
    result: PlanningResult | None = None  # of the last cycle


def explore(
    world: GridWorld,
    starts: Mapping[str, Pose2],
    strategy: str = 'default',
    seed: int = 0,
    config: StudyConfig | None = None,
    planner_settings: Mapping[str, Any] | None = None,
    vehicle_config: GridSimulatorConfig | None = None,
    scenario: Scenario | None = None,
    own_configs: Mapping[str, GridSimulatorConfig] | None = None,
    slam: SlamSettings | None = None,
) -> ExplorationRun:
    """Explore a world with one team from its start poses until it is complete, stuck or late.

    planner_settings: further settings of ExplorationConfig by name.
    vehicle_config: of all vehicles but those that have their own (own_configs).
    slam: let the whole agent run, with these settings; None: poses are known.
    """
    config = config or StudyConfig()
    vehicles = Vehicles(vehicle_config or GridSimulatorConfig(), own_configs or {})
    team = _make_team(
        world, starts, strategy, seed, config, planner_settings or {}, vehicles, scenario, slam
    )
    simulator, curve = team.simulator, CoverageCurve()
    begun = time.perf_counter()
    status, reason = TIME_LIMIT, f'not complete after {config.time_limit:g} s'
    next_scan = next_plan = last_plan = last_active = 0.0
    while simulator.time < config.time_limit:
        now = simulator.time
        if now >= next_scan - 1e-9:
            next_scan = now + config.scan_period
            team.mapping.scan()
        any_idle = any(map(simulator.is_idle, simulator.vehicles))
        if now >= next_plan - 1e-9 or (
            any_idle and now >= last_plan + 0.5 * config.planning_period
        ):
            next_plan, last_plan = now + config.planning_period, now
            result = _plan(team, config)
            own = (simulator.own_coverage(vehicle) for vehicle in simulator.vehicles)
            curve.add(now, simulator.team_coverage(), own)
            if any(result.plans.values()) or any(map(simulator.is_silent, simulator.vehicles)):
                last_active = now
            if _is_over(result.status, config.home_at_end) or (
                now - last_active >= config.stuck_time
            ):
                status, reason = result.status.value, result.reason
                break
        simulator.step()
        team.mapping.move()
    return _summarize(team, strategy, seed, status, reason, curve, time.perf_counter() - begun)


def _is_over(status: ExplorationStatus, home_at_end: bool) -> bool:
    return status is ExplorationStatus.RETURNED or (status.explored and not home_at_end)


def _make_team(
    world: GridWorld,
    starts: Mapping[str, Pose2],
    strategy: str,
    seed: int,
    config: StudyConfig,
    planner_settings: Mapping[str, Any],
    vehicles: Vehicles,
    scenario: Scenario | None,
    slam: SlamSettings | None,
) -> _Team:
    noise = {'position_noise': config.position_error, 'heading_noise': config.heading_error}
    if slam is not None:
        noise = dict.fromkeys(noise, 0.0)
    simulator_config = with_values(vehicles.config, noise)
    own = {name: with_values(one, noise) for name, one in vehicles.own.items()}
    simulator = GridSimulator(world, starts, simulator_config, seed, scenario, own)
    exploration = {
        'strategy': strategy,
        'exploration_seed': seed,
        'return_to_init': config.home_at_end,
        **planner_settings,
    }
    longest = max(simulator.config_of(vehicle).beam_range for vehicle in simulator.vehicles)
    grid = {
        'resolution': config.cell_size,
        'max_laser_range': longest,
        'no_return_range': longest,
    }
    bodies = {
        vehicle: vehicles.body(vehicle) if config.vehicles_known else VehicleBody()
        for vehicle in simulator.vehicles
    }
    mapping: TeamMapping
    if slam is None:
        mapping = KnownPoses(
            simulator,
            with_values(GridConfig(), grid),
            with_values(ExplorationConfig(), exploration),
            bodies,
        )
    else:
        agent = with_values(AgentConfig(), grid | dict(slam.agent) | exploration)
        mapping = TeamSlam(simulator, agent, slam.odometry, bodies, seed)
    return _Team(simulator, mapping, {name: GoalCounter() for name in simulator.vehicles})


def _plan(team: _Team, config: StudyConfig) -> PlanningResult:
    """Report blocked goals, plan, and pass new plans to the vehicles."""
    simulator = team.simulator
    for vehicle in simulator.vehicles:
        plan = team.plans.get(vehicle)
        if simulator.is_silent(vehicle) and plan is not None:
            # nothing arrives there either, so that its follower stops
            simulator.set_plan(vehicle, None)
            team.plans[vehicle] = plan = None
        if plan is not None and simulator.stalled_for(vehicle) >= config.stall_time:
            team.mapping.report_blocked(vehicle, plan)
            simulator.set_plan(vehicle, None)
            team.plans[vehicle] = None
            team.stalls += 1
    begun = time.perf_counter()
    result = team.mapping.plan()
    team.planning_seconds += time.perf_counter() - begun
    team.plannings += 1
    team.result = result
    for vehicle in simulator.vehicles:
        if simulator.is_silent(vehicle):
            continue
        plan = result.plans.get(vehicle)
        pose = simulator.known_pose(vehicle)
        if plan is None or simulator.is_idle(vehicle):
            team.goals[vehicle].clear()
        if plan is not None:
            team.goals[vehicle].update((plan.goal.x, plan.goal.y), (pose.x, pose.y))
        if plan is not team.plans.get(vehicle):
            simulator.set_plan(vehicle, plan)
            team.plans[vehicle] = plan
    return result


def _mapped_fraction(team: _Team) -> float:
    """Return the fraction of the reachable cells that are free in the map."""
    simulator, grid = team.simulator, team.mapping.grid
    cells = grid.to_cell(simulator.world.to_point(np.argwhere(simulator.reachable)))
    inside = grid.contains(cells)
    rows, cols = cells[inside].T
    free = grid.known()[rows, cols] & (grid.probability()[rows, cols] < 0.5)
    return int(np.count_nonzero(free)) / simulator.reachable_cells


def _summarize(
    team: _Team,
    strategy: str,
    seed: int,
    status: str,
    reason: str,
    curve: CoverageCurve,
    wall_seconds: float,
) -> ExplorationRun:
    simulator, result = team.simulator, team.result
    contacts = [contact.obstacle != WALL for contact in simulator.collisions]
    return ExplorationRun(
        strategy=strategy,
        vehicles=len(simulator.vehicles),
        seed=seed,
        status=status,
        reason=reason,
        duration=simulator.time,
        curve=curve,
        mapped=_mapped_fraction(team),
        paths=tuple(simulator.travelled(vehicle) for vehicle in simulator.vehicles),
        goals_given=sum(counter.given for counter in team.goals.values()),
        goals_changed=sum(counter.changed for counter in team.goals.values()),
        vehicle_collisions=sum(contacts),
        wall_collisions=len(contacts) - sum(contacts),
        stalls=team.stalls,
        plannings=team.plannings,
        planning_seconds=team.planning_seconds,
        wall_seconds=wall_seconds,
        unreached_frontiers=result.unreachable if result is not None else 0,
        unreached_m2=result.unreached_m2 if result is not None else 0.0,
        map_rms=team.mapping.map_rms(),
    )
