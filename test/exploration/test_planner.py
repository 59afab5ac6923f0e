"""The planner on maps drawn by hand: statuses, hysteresis, failures, bad input."""

import itertools
import math

import numpy as np
import pytest
from exploration_maps import grid_of, point_of

from explore_slam.data import VehicleBody
from explore_slam.exploration import (
    ExplorationConfig,
    ExplorationStatus,
    Frontier,
    Planner,
    PlanningMode,
    VehicleSnapshot,
)
from explore_slam.geometry import Pose2
from explore_slam.mapping import OccupancyGrid
from explore_slam.settings import settings_of, with_values

HALL = """
??????????????????????
#####......#####..####
#....................#
#....................#
?....................?
?....................?
#....................#
#....................#
######################
"""
CLOSED = """
############
#..........#
#..........#
#..........#
#..........#
############
"""
SIDE = 2  # cells of 0.25 m per letter


def config(**values):
    return with_values(
        ExplorationConfig(), {'planning_radius': 0.3, 'return_to_init': False, **values}
    )


def snapshot(text, row, col, active=True, home=None):
    x, y = point_of(row, col, text, cells_per_letter=SIDE)
    return VehicleSnapshot(Pose2(x, y, 0.0), active, home)


def team(text, *cells):
    return {f'robot{i + 1}': snapshot(text, *cell) for i, cell in enumerate(cells)}


def hall():
    return grid_of(HALL, cells_per_letter=SIDE)


STRATEGIES = ['default', 'paper', 'nearest', 'random']


@pytest.mark.parametrize('strategy', STRATEGIES)
def test_every_vehicle_gets_a_plan_to_a_reachable_frontier(strategy):
    planner = Planner(config(strategy=strategy))
    vehicles = team(HALL, (3, 4), (5, 10), (6, 17))
    result = planner.plan(hall(), 0.0, vehicles)
    assert result.status is ExplorationStatus.STARTED
    assert set(result.plans) <= set(vehicles)
    assert len(result.plans) + len(result.waiting) >= 3
    assert result.costs.shape == (3, len(result.frontiers))
    targets = [f.target for f in result.frontiers]
    for name, plan in result.plans.items():
        assert plan.vehicle == name
        assert np.allclose(plan.waypoints[0], vehicles[name].pose[:2])
        assert np.allclose(plan.waypoints[-1], plan.goal[:2])
        assert math.isfinite(plan.goal.theta)
    ends = [plan.goal[:2] for plan in result.plans.values()]
    assert any(min(math.dist(end, t) for t in targets) < 0.01 for end in ends)
    later = planner.plan(hall(), 1.0, vehicles)
    assert later.status is ExplorationStatus.IN_PROGRESS


@pytest.mark.parametrize('strategy', ['default', 'paper'])
def test_a_team_spreads_out(strategy):
    vehicles = team(HALL, (4, 9), (4, 11))
    result = Planner(config(strategy=strategy)).plan(hall(), 0.0, vehicles)
    goals = [plan.goal for plan in result.plans.values()]
    assert len(goals) == 2
    assert math.dist(goals[0][:2], goals[1][:2]) > 2.0


def test_nearest_takes_the_nearest():
    result = Planner(config(strategy='nearest')).plan(hall(), 0.0, team(HALL, (4, 2)))
    (plan,) = result.plans.values()
    best = int(np.argmin(result.costs[0]))
    assert math.dist(plan.goal[:2], result.frontiers[best].target) < 0.01


def test_random_follows_its_seed():
    def goals(seed):
        planner = Planner(config(strategy='random', exploration_seed=seed))
        return [
            tuple(planner.plan(hall(), 0.0, team(HALL, (4, 9))).plans['robot1'].goal)
            for _ in range(1)
        ]

    assert goals(1) == goals(1)
    assert len({tuple(goals(seed)) for seed in range(8)}) > 1


@pytest.mark.parametrize('strategy', STRATEGIES)
def test_an_unchanged_plan_is_the_same_object_and_goals_do_not_flip(strategy):
    planner = Planner(config(strategy=strategy))
    vehicles = team(HALL, (4, 9))
    first = planner.plan(hall(), 0.0, vehicles).plans['robot1']
    for k in range(1, 6):
        # It wavers around its place: neither target becomes much better.
        x, y = vehicles['robot1'].pose[:2]
        moved = {'robot1': VehicleSnapshot(Pose2(x + 0.2 * (-1) ** k, y, 0.3 * k))}
        assert planner.plan(hall(), float(k), moved).plans['robot1'] is first


def test_a_path_that_the_map_closes_is_planned_anew():
    planner = Planner(config())
    vehicles = team(HALL, (4, 9))
    before = planner.plan(hall(), 0.0, vehicles).plans['robot1']
    goal = before.goal
    middle = before.waypoints[0] * 0.5 + before.waypoints[-1] * 0.5
    grid = hall()
    probability, known = grid.probability().copy(), grid.known()
    row, col = grid.to_cell([middle])[0]
    probability[row - 1 : row + 2, col - 1 : col + 2] = 0.97
    closed = OccupancyGrid.from_probability(probability, known, config=grid.config)
    after = planner.plan(closed, 1.0, vehicles).plans['robot1']
    assert after is not before
    if math.dist(after.goal[:2], goal[:2]) < 0.5:
        at = np.concatenate(
            [np.linspace(p, q, 60) for p, q in itertools.pairwise(after.waypoints)]
        )
        assert np.hypot(*(at - closed.to_point([[row, col]])[0]).T).min() > 0.3


def test_done_only_after_several_empty_searches():
    grid = grid_of(CLOSED, cells_per_letter=SIDE)
    planner = Planner(config(empty_searches=3))
    vehicles = team(CLOSED, (2, 3))
    found = [planner.plan(grid, float(k), vehicles) for k in range(3)]
    assert [r.status for r in found[:2]] == [ExplorationStatus.IN_PROGRESS] * 2
    assert found[2].status is ExplorationStatus.COMPLETE
    assert all(r.searched and not r.plans for r in found)


def test_a_failed_search_in_between_does_not_count():
    grid = grid_of(CLOSED, cells_per_letter=SIDE)
    planner = Planner(config(empty_searches=2))
    vehicles = team(CLOSED, (2, 3))
    planner.plan(grid, 0.0, vehicles)
    lost = {'robot1': VehicleSnapshot(Pose2(math.nan, 0.0, 0.0))}
    for k in range(5):
        result = planner.plan(grid, 1.0 + k, lost)
        assert result.status is ExplorationStatus.PAUSED
        assert not result.searched
        assert 'cannot search' in result.reason
    assert planner.plan(grid, 9.0, vehicles).status is ExplorationStatus.COMPLETE


def test_new_frontiers_end_the_end():
    planner = Planner(config(empty_searches=1))
    vehicles = team(CLOSED, (2, 3))
    closed = grid_of(CLOSED, cells_per_letter=SIDE)
    assert planner.plan(closed, 0.0, vehicles).status is ExplorationStatus.COMPLETE
    again = planner.plan(hall(), 1.0, team(HALL, (4, 9)))
    assert again.status is ExplorationStatus.IN_PROGRESS
    assert again.plans


@pytest.mark.parametrize(
    ('grid', 'vehicles', 'reason'),
    [
        (OccupancyGrid(), {'a': VehicleSnapshot(Pose2(0.0, 0.0, 0.0))}, 'empty'),
        (hall(), {}, 'valid pose'),
        (hall(), {'a': VehicleSnapshot(Pose2(1.0, 1.0, 0.0), False)}, 'valid pose'),
        (hall(), {'a': VehicleSnapshot(Pose2(500.0, 1.0, 0.0))}, 'free cell'),
        (hall(), {'a': VehicleSnapshot(Pose2(math.inf, 1.0, 0.0))}, 'valid pose'),
    ],
)
def test_cannot_search_is_not_done_and_withdraws_the_plans(grid, vehicles, reason):
    planner = Planner(config(empty_searches=1))
    before = planner.plan(hall(), 0.0, team(HALL, (4, 9))).plans
    assert before
    for now in (1.0, 2.0):
        result = planner.plan(grid, now, vehicles)
        assert result.status is ExplorationStatus.PAUSED
        assert reason in result.reason
        assert result.plans == {}
    after = planner.plan(hall(), 3.0, team(HALL, (4, 9)))
    assert after.status is ExplorationStatus.IN_PROGRESS
    assert after.plans['robot1'].stamp == 3.0


def test_a_vehicle_in_a_blocked_cell_starts_from_the_nearest_free_one():
    x, y = point_of(1, 8, HALL, cells_per_letter=SIDE)
    inside_wall = {'robot1': VehicleSnapshot(Pose2(0.6, y - 1.2, 0.0))}
    plan = Planner(config()).plan(hall(), 0.0, inside_wall).plans['robot1']
    assert tuple(plan.waypoints[0]) == (0.6, y - 1.2)
    assert len(plan.waypoints) >= 2
    del x


def test_a_shut_in_vehicle_gets_out_through_a_tight_place():
    tight = """
    ?????????????
    ###########.?
    #....#......?
    #....#......?
    #...........?
    #....#......?
    ###########.?
    ?????????????
    """
    grid = grid_of(tight, cells_per_letter=SIDE)
    slim = VehicleBody(radius=0.15)  # the gap is 0.5 m wide
    start = {'robot1': snapshot(tight, 4, 2)._replace(body=slim)}
    wide = config(planning_radius=0.4, minimum_planning_radius=0.2)
    assert 'robot1' in Planner(wide).plan(grid, 0.0, start).plans
    wider = {'robot1': snapshot(tight, 4, 2)}  # never into gaps that its follower refuses
    assert 'robot1' not in Planner(wide).plan(grid, 0.0, wider).plans
    wall = config(planning_radius=0.4, minimum_planning_radius=0.4)
    assert 'robot1' not in Planner(wall).plan(grid, 0.0, start).plans


def test_a_vehicle_leaves_by_the_way_it_came_though_the_map_shows_a_wall_there():
    # Something stood behind the vehicle when it was seen: it cannot see that it has gone.
    before = """
    ?????????????
    ###########.?
    #....#......?
    #...........?
    #....#......?
    ###########.?
    ?????????????
    """
    after = before.replace('#...........?', '#....#......?')
    planner = Planner(config())
    for col in (7, 6, 5, 4, 3):
        planner.plan(
            grid_of(before, cells_per_letter=SIDE), 0.0, {'robot1': snapshot(before, 3, col)}
        )
    inside = {'robot1': snapshot(after, 3, 3)}
    grid = grid_of(after, cells_per_letter=SIDE)
    plan = planner.plan(grid, 10.0, inside).plans['robot1']
    assert plan.goal.x > inside['robot1'].pose.x + 4.0
    assert 'robot1' not in Planner(config()).plan(grid, 10.0, inside).plans
    # what is forbidden there has not gone, and nobody drives there to look
    forbidden = np.zeros(grid.shape, np.bool_)
    forbidden[:, 5 * SIDE : 6 * SIDE] = True
    result = planner.plan(grid, 11.0, inside, forbidden=forbidden)
    assert 'robot1' not in result.plans


def test_a_target_reported_as_blocked_near_by_is_left_alone_and_tried_again_at_the_end():
    planner = Planner(config(blacklist_radius=1.0))
    vehicles = team(HALL, (4, 9))
    first = planner.plan(hall(), 0.0, vehicles).plans['robot1']
    near = {'robot1': VehicleSnapshot(Pose2(*(np.array(first.goal[:2]) - [0.9, 0.0]), 0.0))}
    targets = []
    for k in range(40):
        result = planner.plan(hall(), 1.0 + k, near)
        if result.status.explored:
            break
        plan = result.plans.get('robot1')
        if plan is not None:
            targets.append(plan.goal[:2])
            near = {'robot1': VehicleSnapshot(Pose2(*plan.waypoints[-1], 0.0))}
            planner.report_blocked('robot1', plan.goal, 1.0 + k)
    assert result.status is ExplorationStatus.INCOMPLETE
    assert result.unreachable > 0
    assert result.unreached_m2 > 1.0
    for target in targets:
        times = sum(math.dist(target, other) < 0.3 for other in targets)
        assert times <= 3 * 2


WINDING = """
################
#.............##
#.##########..##
#.##########..##
#.##########..##
#.##########..##
#.##########..##
#.##########...?
#.##########...?
################
"""


def test_a_long_way_around_is_progress_and_standing_still_is_failure():
    grid = grid_of(WINDING, cells_per_letter=4)
    settings = config(progress_timeout=10.0, max_frontier_size=10.0)
    x, y = point_of(8, 1, WINDING, cells_per_letter=4)
    start = VehicleSnapshot(Pose2(x, y, 0.0))
    planner = Planner(settings)
    plan = planner.plan(grid, 0.0, {'robot1': start}).plans['robot1']
    place = plan.waypoints
    at = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(place, axis=0).T))])
    for k in range(1, int(at[-1] / 0.4) - 1):
        here = [float(np.interp(0.4 * k, at, place[:, i])) for i in (0, 1)]
        moved = {'robot1': VehicleSnapshot(Pose2(*here, 0.0))}
        assert planner.plan(grid, float(k), moved).plans['robot1'] is plan
    still = Planner(settings)
    statuses = [still.plan(grid, 2.0 * k, {'robot1': start}).status for k in range(40)]
    assert statuses[-1] is ExplorationStatus.INCOMPLETE


def test_what_is_blocked_far_from_the_target_is_the_way():
    planner = Planner(config())
    vehicles = team(HALL, (4, 9))
    first = planner.plan(hall(), 0.0, vehicles).plans['robot1']
    planner.report_blocked('robot1', first.goal, 1.0)
    second = planner.plan(hall(), 2.0, vehicles).plans['robot1']
    assert second is not first
    ahead = first.waypoints[0] + 0.5 * (first.waypoints[1] - first.waypoints[0]) / np.linalg.norm(
        first.waypoints[1] - first.waypoints[0]
    )
    at = np.concatenate([np.linspace(p, q, 60) for p, q in itertools.pairwise(second.waypoints)])
    assert np.hypot(*(at - ahead).T).min() > 0.1


def test_a_lost_vehicle_leaves_its_target_to_another():
    planner = Planner(config())
    vehicles = team(HALL, (4, 3), (4, 17))
    first = planner.plan(hall(), 0.0, vehicles)
    vehicles['robot1'] = VehicleSnapshot(vehicles['robot1'].pose, False)
    second = planner.plan(hall(), 1.0, vehicles)
    assert 'robot1' not in second.plans
    assert 'robot2' in second.plans
    vehicles['robot1'] = VehicleSnapshot(vehicles['robot1'].pose, True)
    assert set(planner.plan(hall(), 2.0, vehicles).plans) == set(first.plans)


def test_home_again():
    planner = Planner(config(empty_searches=1, return_to_init=True))
    grid = grid_of(CLOSED, cells_per_letter=SIDE)
    away = {'robot1': snapshot(CLOSED, 3, 8, True, Pose2(1.2, 1.2, 0.0))}
    result = planner.plan(grid, 0.0, away)
    assert result.status is ExplorationStatus.RETURNING
    assert math.dist(result.plans['robot1'].goal[:2], (1.2, 1.2)) < 0.3
    home = {'robot1': VehicleSnapshot(Pose2(1.2, 1.2, 0.0), True, Pose2(1.2, 1.2, 0.0))}
    assert planner.plan(grid, 1.0, home).status is ExplorationStatus.RETURNED


def test_home_is_where_a_vehicle_was_first_seen_unless_given():
    planner = Planner(config())
    start = snapshot(HALL, 4, 3)
    planner.plan(hall(), 0.0, {'robot1': start})
    result = planner.plan(hall(), 1.0, {'robot1': snapshot(HALL, 4, 15)}, PlanningMode.RETURN_HOME)
    assert math.dist(result.plans['robot1'].goal[:2], start.pose[:2]) < 0.4


def test_a_paused_planner_sends_no_vehicle():
    result = Planner(config()).plan(hall(), 0.0, team(HALL, (4, 3)), 'paused')
    assert result.status is ExplorationStatus.PAUSED
    assert not result.plans


def test_plans_are_the_same_every_time():
    def run():
        planner = Planner(config())
        vehicles = team(HALL, (3, 4), (5, 10), (6, 17))
        return [
            [(n, p.waypoints.tolist()) for n, p in planner.plan(hall(), k, vehicles).plans.items()]
            for k in range(3)
        ]

    assert run() == run()


def test_every_setting_has_a_doc_and_a_name_of_its_own():
    names = [info.name for info, _ in settings_of(ExplorationConfig())]
    assert len(names) == len(set(names))
    assert all(info.doc for info, _ in settings_of(ExplorationConfig()))


def planned_at(distance):
    """Plan for a vehicle at this distance (m) from its target, with a straight path there."""
    planner = Planner(config())
    vehicles = team(HALL, (4, 9))
    plan = planner.plan(hall(), 0.0, vehicles).plans['robot1']
    target = np.array(plan.goal[:2])
    direction = plan.waypoints[-1] - plan.waypoints[-2]
    place = target - distance * direction / np.linalg.norm(direction)
    here = {'robot1': VehicleSnapshot(Pose2(*place.tolist(), 0.0))}
    plan = planner.plan(hall(), 1.0, here).plans['robot1']
    return planner, here, plan


@pytest.mark.parametrize(('distance', 'failed'), [(1.9, True), (2.1, False)])
def test_a_target_fails_where_its_vehicle_is_blocked_near_by(distance, failed):
    planner, here, plan = planned_at(distance)
    planner.report_blocked('robot1', plan.goal, 2.0)
    planner.plan(hall(), 3.0, here)
    assert planner._blacklist.blocks(plan.goal[:2], 3.0) is failed


def test_the_keep_out_zone_lies_half_a_metre_ahead_on_the_path():
    planner, here, plan = planned_at(2.5)
    planner.report_blocked('robot1', plan.goal, 2.0)
    place = np.array(here['robot1'].pose[:2])
    step = np.array(plan.goal[:2]) - place
    (zone,) = planner._keep_out.places()
    np.testing.assert_allclose(zone, place + 0.5 * step / np.linalg.norm(step), atol=0.1)
    assert math.dist(zone, place) == pytest.approx(0.5)


def test_a_vehicle_without_a_task_that_is_blocked_has_failed_and_makes_no_zone():
    planner = Planner(config())
    planner.report_blocked('robot1', (5.0, 4.0), 0.0)
    planner.plan(hall(), 1.0, team(HALL, (4, 9)))
    assert planner._blacklist.blocks((5.0, 4.0), 1.0)
    assert planner._keep_out.places() == []


def test_a_third_blockage_on_the_way_is_a_failure():
    planner = Planner(config())
    vehicles = team(HALL, (6, 10))
    failures = []
    for now in (0.0, 10.0, 20.0):
        plan = planner.plan(hall(), now, vehicles).plans['robot1']
        assert math.dist(plan.goal[:2], vehicles['robot1'].pose[:2]) > 2.0
        failures.append(len(planner._blacklist))
        planner.report_blocked('robot1', plan.goal, now + 1.0)
    planner.plan(hall(), 30.0, vehicles)
    assert [*failures, len(planner._blacklist)] == [0, 0, 0, 1]
    assert planner._blacklist.blocks(plan.goal[:2], 30.0)


def frontier_at(x, y):
    cell = tuple(hall().to_cell([(x, y)])[0].tolist())
    return Frontier(np.array([cell]), (x, y), (x, y), cell, 1.0, 5.0)


@pytest.mark.parametrize(('moved', 'index'), [(1.9, 1), (2.1, -1)])
def test_a_frontier_that_recedes_is_the_same_target(moved, index):
    planner = Planner(config())
    plan = planner.plan(hall(), 0.0, team(HALL, (4, 9))).plans['robot1']
    x, y = plan.goal[:2]
    found = [frontier_at(x + 9.0, y), frontier_at(x + moved, y)]
    assert planner._current_frontiers(('robot1', 'robot2'), found) == [index, -1]


def test_a_target_is_given_up_after_three_cycles_at_it_without_anything_new():
    planner, _, plan = planned_at(2.5)
    there = {'robot1': VehicleSnapshot(Pose2(*plan.goal[:2], 0.0))}
    blocked = []
    for cycle in range(5):
        planner.plan(hall(), 2.0 + cycle, there)
        blocked.append(planner._blacklist.gave_up(plan.goal[:2]))
    assert blocked == [False, False, False, True, True]


def test_a_vehicle_that_comes_no_nearer_has_failed_after_the_timeout():
    planner = Planner(config(progress_timeout=10.0))
    vehicles = team(HALL, (4, 9))
    goal = planner.plan(hall(), 0.0, vehicles).plans['robot1'].goal
    times = [1.0, 5.0, 11.0, 11.5, 12.0]
    failed = []
    for now in times:
        planner.plan(hall(), now, vehicles)
        failed.append(planner._blacklist.blocks(goal[:2], now))
    assert failed == [False, False, False, False, True]


def test_a_target_that_was_reached_and_shows_nothing_more_is_forgiven():
    planner, _, plan = planned_at(2.5)
    target = plan.goal[:2]
    planner._blacklist.report((target[0] + 0.1, target[1]))
    there = {'robot1': VehicleSnapshot(Pose2(target[0] + 0.6, target[1], 0.0))}
    planner.plan(hall(), 100.0, there)
    closed = grid_of(
        HALL.replace('?', '#').replace('#####......', '####?......'), cells_per_letter=SIDE
    )
    assert len(planner._blacklist) == 1
    planner.plan(closed, 5000.0, there)
    assert not planner._blacklist.blocks(target, 5000.0)


def test_switching_targets_is_counted_until_one_is_reached():
    planner = Planner(config())
    vehicles = team(HALL, (4, 9))
    planner.plan(hall(), 0.0, vehicles)
    planner._strategy.assign = lambda s: [next(
        i for i, f in enumerate(s.frontiers) if i != s.current[0]
    )]  # fmt: skip
    switches = []
    for now in (1.0, 2.0, 3.0):
        planner.plan(hall(), now, vehicles)
        switches.append(planner._tasks['robot1'].switches)
    assert switches == [1, 2, 3]


def test_when_keep_out_zones_hide_every_target_they_are_released():
    planner = Planner(config(empty_searches=1, minimum_planning_radius=0.3))
    grid = grid_of(WINDING, cells_per_letter=4)
    start = {'robot1': VehicleSnapshot(Pose2(*point_of(8, 1, WINDING, cells_per_letter=4), 0.0))}
    plan = planner.plan(grid, 0.0, start).plans['robot1']
    planner.report_blocked('robot1', plan.goal, 1.0)
    result = planner.plan(grid, 2.0, start)
    assert result.status is ExplorationStatus.IN_PROGRESS
    assert 'released' in result.reason
    assert planner.plan(grid, 3.0, start).plans


def test_permanent_zones_around_a_trapped_vehicle_are_released_too():
    planner = Planner(config(empty_searches=1, minimum_planning_radius=0.3))
    grid = grid_of(WINDING, cells_per_letter=4)
    start = {'robot1': VehicleSnapshot(Pose2(*point_of(8, 1, WINDING, cells_per_letter=4), 0.0))}
    planner.plan(grid, 0.0, start)
    ahead = (start['robot1'].pose.x, start['robot1'].pose.y + 0.5)
    for now in (1.0, 2.0):
        planner._keep_out.add(ahead, now, [])
    statuses = []
    for now in (100.0, 101.0, 102.0):
        result = planner.plan(grid, now, start)
        statuses.append((result.status, 'released' in result.reason, bool(result.plans)))
    assert statuses[0] == (ExplorationStatus.IN_PROGRESS, True, False)
    assert statuses[1][2]


def test_a_frontier_that_only_one_vehicle_reaches_and_has_given_up_ends_exploration():
    """The other one is shut in: it has not failed, but it never gets there."""
    text = """
????????????????????
#####....###########
#.........#........#
#.........#........#
#.........#........#
#.........#........#
####################
"""
    grid = grid_of(text, cells_per_letter=SIDE)
    planner = Planner(config(maximum_attempts=1))
    vehicles = team(text, (4, 5), (4, 14))
    sent = set()
    for turn in range(100):
        result = planner.plan(grid, 0.1 * turn, vehicles)
        if result.status.explored:
            break
        for name, plan in result.plans.items():
            sent.add(name)
            planner.report_blocked(name, plan.goal, 0.1 * turn)
    assert result.status.explored
    assert sent == {'robot1'}
