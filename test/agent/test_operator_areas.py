"""Areas and goals of the operator: frontiers, paths and plans respect them in the next cycle."""

import math

import numpy as np
import pytest
from synthetic import SyntheticVehicle, SyntheticWorld

from explore_slam.agent import Agent, AgentConfig, TeamPlanner
from explore_slam.agent.operator_areas import OperatorAreas, inside
from explore_slam.data import OdometryReading
from explore_slam.errors import AgentError
from explore_slam.exploration import ExplorationStatus, find_frontiers
from explore_slam.geometry import Pose2
from explore_slam.mapping import OccupancyGrid
from explore_slam.settings import with_values

START = Pose2(-1.0, -1.5, 0.0)
CONFIG = with_values(AgentConfig(), {'particles': 20, 'empty_searches': 1})
L_SHAPE = np.array([[0, 0], [4, 0], [4, 1], [1, 1], [1, 3], [0, 3]], np.float64)


def grid_of(rows=60, columns=80):
    """A free field of 0.05 m cells; the rest of the world is unknown."""
    known = np.zeros((rows, columns), np.bool_)
    known[10:50, 10:70] = True
    return OccupancyGrid.from_probability(np.full(known.shape, 0.1), known)


def test_points_in_a_polygon_that_is_not_convex():
    points = np.array([[0.5, 2.5], [3.5, 0.5], [2.0, 2.0], [-0.1, 0.5], [0.99, 2.99]])
    assert inside(points, L_SHAPE).tolist() == [True, True, False, False, True]
    assert inside(points, L_SHAPE[::-1]).tolist() == [True, True, False, False, True]


def test_out_of_bounds_is_occupied_and_known():
    areas, grid = OperatorAreas(), grid_of()
    assert areas.view(grid) is grid
    areas.add_keep_out([[1, 1], [2, 1], [2, 2], [1, 2]])
    areas.add_keep_out([[1, 1], [2, 1], [2, 2], [1, 2]])  # again, from a latched publisher
    assert len(areas.keep_out) == 1
    view = areas.view(grid)
    cells, table = view.levels()
    values = table[cells.view(np.uint16)]
    np.testing.assert_array_equal(np.isnan(values), ~view.known())
    np.testing.assert_array_equal(values[view.known()], view.probability()[view.known()])
    mask = areas.out_of_bounds(grid)
    assert np.count_nonzero(mask) == 400
    assert (view.probability()[mask] == 1.0).all()
    assert (view.probability()[~mask] == grid.probability()[~mask]).all()
    assert view.known()[mask].all()
    assert (view.shape, view.origin, view.resolution) == (grid.shape, (0.0, 0.0), 0.05)
    assert areas.area_left_out(grid) == pytest.approx(1.0)
    areas.set_area([[0, 0], [2, 0], [2, 3], [0, 3]])
    assert areas.area_left_out(grid) == pytest.approx(1.0 + 2.0 * 3.0)
    areas.set_area([])
    areas.add_keep_out([])
    assert areas.view(grid) is grid


@pytest.mark.parametrize(
    ('points', 'reason'),
    [
        ([[0, 0], [1, 1]], 'has 2 corners'),
        ([[0, 0], [1, 1], [2, 2]], 'encloses no area'),
        ([[0, 0], [1, math.nan], [2, 0]], 'not finite'),
    ],
)
def test_polygons_that_are_none_are_refused_and_change_nothing(points, reason):
    areas = OperatorAreas()
    for call in (areas.set_area, areas.add_keep_out):
        with pytest.raises(AgentError, match=reason):
            call(points)
    assert (areas.area, areas.keep_out) == (None, [])


def drive(agent, vehicle, ticks):
    for _ in range(ticks):
        reading = vehicle.advance()
        agent.add('robot1', OdometryReading(reading.stamp, reading.pose))
        agent.add('robot1', vehicle.scan())


class HalfRoom(SyntheticWorld):
    """The laser sees the left half of its beams only: much remains to be explored."""

    def scan_from(self, stamp, pose, beams=181):
        scan = super().scan_from(stamp, pose, beams)
        scan.ranges[: beams // 2] = float('nan')
        return scan


def make():
    agent = Agent(CONFIG, {'robot1': START}, 1)
    vehicle = SyntheticVehicle(HalfRoom(), START, speed=0.0, turn=0.0)
    drive(agent, vehicle, 3)
    return agent, TeamPlanner(agent), vehicle


def square(x, y, half=0.3):
    return [[x - half, y - half], [x + half, y - half], [x + half, y + half], [x - half, y + half]]


def test_targets_and_paths_respect_a_keep_out_area_in_the_next_cycle():
    _, planner, _ = make()
    target = planner.plan(1.0).plans['robot1'].waypoints[-1]
    assert math.dist(target, START[:2]) > 0.8  # the vehicle itself is not in the area
    corners = np.array(square(*target))
    planner.areas.add_keep_out(corners)
    result = planner.plan(1.1)
    for plan in result.plans.values():
        legs = zip(plan.waypoints, plan.waypoints[1:], strict=False)
        dense = np.concatenate([np.linspace(a, b, 50) for a, b in legs])
        assert not inside(dense, corners).any()
    targets = np.array([frontier.target for frontier in result.frontiers]).reshape(-1, 2)
    assert not inside(targets, corners).any()
    planner.areas.add_keep_out([])
    assert np.allclose(planner.plan(1.2).plans['robot1'].waypoints[-1], target, atol=0.5)


@pytest.mark.parametrize('corners', [square(*START[:2], 0.8), square(0.0, 0.0, 9.0)])
def test_a_keep_out_area_over_the_only_vehicle_withdraws_its_plan(corners):
    agent, planner, _ = make()
    assert planner.plan(1.0).plans
    planner.areas.add_keep_out(corners)
    result = planner.plan(1.1)
    assert result.plans == {}
    assert agent.track('robot1').plan is None
    assert (result.status, result.searched) == (ExplorationStatus.PAUSED, False)
    planner.areas.add_keep_out([])
    assert planner.plan(1.2).plans


def test_an_area_to_explore_elsewhere_withdraws_the_plan():
    _, planner, _ = make()
    assert planner.plan(1.0).plans
    planner.areas.set_area(square(3.0, 3.0, 0.5))
    assert planner.plan(1.1).plans == {}


def test_outside_of_the_area_nothing_is_explored():
    agent, planner, _ = make()
    assert planner.plan(1.0).frontiers
    planner.areas.set_area(square(START.x + 1.0, START.y + 1.0, 0.5))  # all of it is known
    assert not find_frontiers(planner.areas.view(agent.grid), CONFIG.exploration)
    planner.areas.set_area([])
    assert planner.plan(4.0).frontiers


def test_a_vehicle_drives_to_the_goal_of_the_operator_and_explores_on(caplog):
    agent, planner, _ = make()
    goal = Pose2(0.5, -0.5, 0.0)
    planner.set_goal('robot1', goal)
    result = planner.plan(1.0)
    assert math.dist(result.plans['robot1'].goal[:2], goal[:2]) < 0.2
    assert result.status is ExplorationStatus.IN_PROGRESS
    caplog.set_level('INFO')
    here = agent.map_pose('robot1')
    planner.set_goal('robot1', Pose2(here.x + 0.02, here.y, 0.0))
    explored = planner.plan(2.0)
    assert 'has reached the goal of the operator' in caplog.text
    assert explored.searched
    assert math.dist(explored.plans['robot1'].goal[:2], here[:2]) > 0.3


def test_a_goal_that_must_not_be_entered_or_of_an_unknown_vehicle_is_refused():
    _, planner, _ = make()
    planner.areas.add_keep_out([[0, -1], [1, -1], [1, 0], [0, 0]])
    with pytest.raises(AgentError, match=r'\(0.50, -0.50\) of robot1 lies in a keep-out area'):
        planner.set_goal('robot1', Pose2(0.5, -0.5, 0.0))
    with pytest.raises(AgentError, match="unknown vehicle 'robot9'"):
        planner.set_goal('robot9', Pose2(0.0, 0.0, 0.0))
