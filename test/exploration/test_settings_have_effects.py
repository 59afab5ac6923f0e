"""Every setting of exploration changes what comes out; a new one without a test fails here."""

import math

import numpy as np
import pytest
from exploration_maps import grid_of, point_of

from explore_slam.exploration import (
    STRATEGIES,
    ExplorationConfig,
    Frontier,
    KnownPlace,
    Planner,
    PlanningMode,
    VehicleSnapshot,
    find_frontiers,
    make_cost_map,
)
from explore_slam.exploration.blacklist import Blacklist
from explore_slam.exploration.scene import Scene
from explore_slam.exploration.strategies.strategy import Situation
from explore_slam.exploration.traffic import Traffic, Traveler
from explore_slam.geometry import Pose2
from explore_slam.mapping import OccupancyGrid
from explore_slam.settings import settings_of, with_values

HALL = """
????????????????????????
########...########....?
#......................?
#......................?
#.....#................#
#......................#
########################
"""
CLOSED = """
##########
#........#
#........#
##########
"""
LETTER = 4


def hall():
    return grid_of(HALL, resolution=0.125, cells_per_letter=LETTER)


def place(row, col, text=HALL):
    return point_of(row, col, text, resolution=0.125, cells_per_letter=LETTER)


def vehicle(row, col, text=HALL, home=None):
    return VehicleSnapshot(Pose2(*place(row, col, text), 0.0), True, home)


# -- experiments: from settings to something that can be compared ---------------------------------


def cost_map(config):
    costs = make_cost_map(hall(), config.paths)
    return costs.cost.tobytes(), costs.tight_cost.tobytes()


def cost_map_of_unsure_cells(config):
    """Costs where free cells are not certain."""
    grid = hall()
    probability = np.where(grid.probability() > 0.5, 0.97, 0.3)
    unsure = type(grid).from_probability(probability, grid.known(), config=grid.config)
    return make_cost_map(unsure, config.paths).cost.tobytes()


def frontiers(config):
    return [(f.target, f.size, f.gain) for f in find_frontiers(hall(), config)]


def looks_by_a_camera(config):
    """Where a vehicle is sent in a closed room in which no camera has looked anywhere."""
    grid = grid_of(CLOSED, cells_per_letter=LETTER)
    seen = np.zeros(grid.shape, np.bool_)
    one = vehicle(1, 1, CLOSED)._replace(has_camera=True)
    result = Planner(config).plan(grid, 0.0, {'robot1': one}, looked_at=lambda: seen)
    return [f.target for f in result.frontiers]


def frontiers_behind_a_gap(config):
    """Frontiers that can only be seen from a distance."""
    narrow = """
    ##########
    #.....####
    #........?
    #.....####
    ##########
    """
    grid = grid_of(narrow, cells_per_letter=2)
    wide = with_values(config, {'min_frontier_size': 0.2, 'min_frontier_gain': 0.0})
    return [f.target for f in find_frontiers(grid, wide)]


def start_beside_a_wall(config):
    stuck = {'a': VehicleSnapshot(Pose2(0.3, place(3, 1)[1], 0.0))}
    return Scene(hall(), 0.0, config, stuck).starts


def who_is_home(config):
    x, y = place(3, 5)
    away = {'a': VehicleSnapshot(Pose2(x + 0.5, y, 0.0), True, Pose2(x, y, 0.0))}
    return list(Planner(config).plan(hall(), 0.0, away, PlanningMode.RETURN_HOME).plans)


def blocks(config):
    return Scene(hall(), 0.0, config, {'a': vehicle(3, 3)}).routes('a').block


def situation(costs, targets, gains, current):
    found = [
        Frontier(np.zeros((1, 2), np.int64), target, target, (0, i), 1.0, gain)
        for i, (target, gain) in enumerate(zip(targets, gains, strict=True))
    ]
    matrix = np.array(costs, float)
    names = tuple(f'robot{i}' for i in range(len(matrix)))
    return Situation(StraightLines(targets), names, found, matrix, current, [0] * len(matrix))


class StraightLines:
    """Travel costs between targets are their distances; the cell of a target is its number."""

    size = 1  # blocks

    def __init__(self, targets):
        self._targets = np.array(targets, float)

    def routes(self, _vehicle):
        return self

    @staticmethod
    def blocks(cells):
        return cells

    def values_from(self, block):
        class Distances:
            @staticmethod
            def at(blocks):
                here = self._targets[block[1]]
                return np.hypot(*(self._targets[blocks[:, 1]] - here).T)

        return Distances()


def assignment(config, strategy, costs, targets, gains=None, current=None):
    planner = STRATEGIES[strategy].create(config.assignment, config.frontiers.sensor_range)
    given = situation(costs, targets, gains or [10.0] * len(targets), current or [-1] * len(costs))
    return planner.assign(given)


def paper_choice(config):
    """Two targets close together, and one far away that nobody else sees."""
    targets = [(0.0, 0.0), (1.0, 0.0), (9.0, 0.0)]
    return assignment(config, 'paper', [[0.1, 0.2, 0.9], [0.3, 0.35, 0.9]], targets)


def kept_choice(config):
    return assignment(config, 'nearest', [[5.0, 4.0]], [(0.0, 0.0), (9.0, 0.0)], None, [0])


def kept_tour(config):
    targets = [(6.0, 0.0), (-6.0, 0.0)]
    return assignment(config, 'default', [[10.0, 2.0]], targets, None, [0])


def tours(config):
    """First targets of two vehicles, for stops on a line with different gains."""
    at = [-2.0, -2.5, 2.2, 9.0, 14.0]
    gains = [4.0, 0.4, 20.0, 90.0, 3.0]
    found = []
    for starts in ((0.0, 1.0), (0.5, 13.0), (-1.0, -4.0), (0.0, 0.1), (2.0, 20.0), (5.0, 5.5)):
        costs = [[abs(x - start) for x in at] for start in starts]
        found.append(assignment(config, 'default', costs, [(x, 0.0) for x in at], gains))
    return found


def clusters(config):
    """First targets of two vehicles among clusters of frontiers."""
    found = []
    for seed in range(8):
        generator = np.random.default_rng(seed)
        centers = generator.uniform(-10.0, 10.0, (4, 2)).repeat(3, axis=0)
        targets = centers + generator.uniform(-0.7, 0.7, (12, 2))
        starts = generator.uniform(-3.0, 3.0, (2, 2))
        costs = np.linalg.norm(starts[:, None] - targets[None], axis=2)
        gains = generator.uniform(0.2, 8.0, 12).tolist()
        found.append(assignment(config, 'default', costs, list(map(tuple, targets)), gains))
    return found


def idle_choice(config):
    """One stop for three vehicles: two are idle, and frontiers beside each other are nearest."""
    targets = [(40.0, 0.0), (41.0, 0.0), (41.2, 0.0), (45.0, 0.0)]
    costs = [[x + away for x, _ in targets] for away in (0.0, 4.0, 4.0)]
    return sorted(assignment(config, 'default', costs, targets))


def random_targets(config):
    costs = np.ones((1, 50))
    targets = [(float(i), 0.0) for i in range(50)]
    return [assignment(config, 'random', costs, targets) for _ in range(3)]


def plans_of_a_team(config):
    planner = Planner(config)
    team = {'a': vehicle(3, 3), 'b': vehicle(3, 10)}
    plans = planner.plan(hall(), 0.0, team).plans
    return {name: plan.waypoints.tolist() for name, plan in plans.items()}


def blacklisted(config):
    """Which places are blacklisted when, and which are given up."""
    known = np.ones((60, 60), bool)
    grid = OccupancyGrid.from_probability(np.full((60, 60), 0.1), known)
    entries = Blacklist(config.blacklist)
    found = []
    for now in (0.0, 1000.0, 5000.0):
        entries.report((1.5, 1.5))
        entries.update(now, grid, known)
        places = [(1.5 + 0.2 * i, 1.5) for i in range(8)]
        found.append([(entries.blocks(p, now + 400.0), entries.gave_up(p)) for p in places])
    return found


def cycles_until_failure(config):
    """How long a vehicle that does not move keeps its target."""
    planner = Planner(config)
    team = {'a': vehicle(3, 3)}
    first = planner.plan(hall(), 0.0, team).plans['a'].goal
    for cycle in range(1, 60):
        plan = planner.plan(hall(), 2.0 * cycle, team).plans.get('a')
        if plan is None or plan.goal != first:
            return cycle
    return 60


def searches_until_complete(config):
    planner = Planner(config)
    grid = grid_of(CLOSED, resolution=0.125, cells_per_letter=LETTER)
    team = {'a': vehicle(1, 2, CLOSED, Pose2(*place(2, 7, CLOSED), 0.0))}
    return [planner.plan(grid, float(k), team).status for k in range(4)]


def cycles_until_the_end_of_waiting(config):
    """A way that was free becomes blocked; the vehicle drives as it is told."""
    corridor = """
    ##############?????????????????
    #.....########.????????????????
    #...............???????????????
    #...............???????????????
    #.....########.????????????????
    ##############?????????????????
    """
    planner, pose = Planner(config), Pose2(*place(2, 2, corridor), 0.0)
    closed = corridor.replace('#...............', '#........##.....')
    for cycle in range(120):
        text = corridor if cycle == 0 else closed
        grid = grid_of(text, resolution=0.125, cells_per_letter=LETTER)
        result = planner.plan(grid, 2.0 * cycle, {'a': VehicleSnapshot(pose)})
        if result.status.explored:
            return cycle, result.status, result.unreachable
        if cycle and 'a' in result.plans:
            pose = result.plans['a'].goal
    return 120


def target_beside_a_doubtful_place(config):
    """A vehicle that looks for loops, unless the settings say otherwise, goes there or on."""
    seeking = with_values(config, {'loop_seeking': True})
    known = (KnownPlace(place(4, 18), 0.3),)
    team = {'a': vehicle(4, 10)._replace(known_places=known)}
    return tuple(Planner(seeking).plan(hall(), 0.0, team).plans['a'].goal)


def target_unless_loops_are_sought(config):
    known = (KnownPlace(place(4, 18), 0.3),)
    team = {'a': vehicle(4, 10)._replace(known_places=known)}
    return tuple(Planner(config).plan(hall(), 0.0, team).plans['a'].goal)


def straight(name, y, x0, x1):
    path = np.array([[x0, y], [x1, y]])
    return Traveler(name, path[0], path)


class NoWayOut:
    def retreat(self, _one, _others):
        return None, math.inf


def rights(config, *travelers):
    grants = Traffic(config.traffic).grant({t.name: t for t in travelers}, NoWayOut())
    return [(g.right, g.limit) for g in grants.values()]


def opposite_traffic(gap):
    return lambda config: rights(
        config, straight('a', 0.0, 0.0, 9.0), straight('b', gap, 9.0, 0.0)
    )


def crossing_traffic(config):
    crossing = np.array([[6.2, -4.0], [6.2, 4.0]])
    return rights(config, straight('a', 0.0, 0.0, 9.0), Traveler('b', crossing[0], crossing))


# -- one line per setting -------------------------------------------------------------------------

EFFECTS = {
    'strategy': ('nearest', plans_of_a_team),
    'planning_radius': (0.5, cost_map),
    'minimum_planning_radius': (0.1, cost_map),
    'planning_margin': (1.0, frontiers),
    'occ_max': (0.99, cost_map),
    'cost_floor': (0.1, cost_map_of_unsure_cells),
    'clearance_distance': (0.0, cost_map),
    'clearance_weight': (0.0, cost_map),
    'route_resolution': (0.125, blocks),
    'escape_distance': (0.1, start_beside_a_wall),
    'arrival_distance': (0.6, who_is_home),
    'min_frontier_size': (3.0, frontiers),
    'max_frontier_size': (0.6, frontiers),
    'viewpoint_distance': (2.5, frontiers_behind_a_gap),
    'min_frontier_gain': (50.0, frontiers),
    'min_gain_per_travel': (10.0, plans_of_a_team),
    'min_unviewed_area': (0.0, looks_by_a_camera),
    'sensor_range': (2.0, frontiers),
    'travel_weight': (10.0, paper_choice),
    'hysteresis': (0.5, kept_choice),
    'tour_hysteresis': (100.0, kept_tour),
    'work_per_area': (5.0, tours),
    'waiting_weight': (20.0, tours),
    'longest_weight': (0.0, tours),
    'gain_per_detour': (5.0, tours),
    'merge_distance': (0.5, clusters),
    'overlap_weight': (0.0, idle_choice),
    'exploration_seed': (1, random_targets),
    'loop_seeking': (True, target_unless_loops_are_sought),
    'loop_deviation': (0.5, target_beside_a_doubtful_place),
    'map_tolerance': (2.0, target_beside_a_doubtful_place),
    'loop_reach': (1.0, target_beside_a_doubtful_place),
    'blacklist_radius': (1.0, blacklisted),
    'blacklist_expiry': (300.0, blacklisted),
    'maximum_attempts': (1, blacklisted),
    'progress_timeout': (10.0, cycles_until_failure),
    'vehicle_separation': (0.3, opposite_traffic(0.6)),
    'traffic_margin': (0.0, crossing_traffic),
    'traffic_horizon': (3.0, opposite_traffic(0.2)),
    'empty_searches': (1, searches_until_complete),
    'obstruction_patience': (10.0, cycles_until_the_end_of_waiting),
    'return_to_init': (True, searches_until_complete),
}


@pytest.mark.parametrize('name', [info.name for info, _ in settings_of(ExplorationConfig())])
def test_every_setting_changes_what_comes_out(name):
    value, experiment = EFFECTS[name]
    usual = ExplorationConfig()
    assert experiment(usual) == experiment(usual)
    assert experiment(usual) != experiment(with_values(usual, {name: value}))


def test_no_effect_is_listed_for_a_setting_that_does_not_exist():
    assert EFFECTS.keys() == {info.name for info, _ in settings_of(ExplorationConfig())}


@pytest.mark.parametrize('strategy', list(STRATEGIES))
def test_every_strategy_sends_a_vehicle_somewhere(strategy):
    assert plans_of_a_team(with_values(ExplorationConfig(), {'strategy': strategy}))
