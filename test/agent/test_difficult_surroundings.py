"""Laps through the agent where the laser misleads: glass, bare corridors, crowds, moved furniture.

The search for loops alone is tested in test/slam/closures; here the front end is part of it, whose
errors become those of the map that is searched.
"""

import math

import numpy as np
import pytest
from registration.ray_caster import box, polyline, scan_of
from slam.closures.drives import along
from slam.closures.test_loop_search import FURNITURE, LAP, MOVED, OFFICE
from slam.closures.test_twin_worlds import WRONG

from explore_slam.agent import Agent, AgentConfig
from explore_slam.data import OdometryReading
from explore_slam.geometry import Pose2, between, wrap_angle
from explore_slam.settings import with_values

STEP, PERIOD = 0.3, 0.5  # m and s between scans
DRIFT = (1.03, 1.0, 1.02)  # of the wheels
LAP_AND_A_HALF = along(*LAP, *LAP[1:3], step=STEP)
SECOND_VISIT = len(along(*LAP, step=STEP))


def run(path, world, farthest=30.0, **values):
    """Drive a path through world(step, pose, random): walls (n, 4)."""
    config = with_values(AgentConfig(), {'particles': 50, 'laser_x': 0.0, **values})
    agent, random = Agent(config, {'robot1': path[0]}, seed=1), np.random.default_rng(2)
    wheels = last = path[0]
    for k, true in enumerate(path):
        u = np.array(last.between(true)) * DRIFT + random.normal(size=3) * (0.004, 0.002, 0.01)
        wheels, last = wheels.compose(Pose2(*u)), true
        agent.add('robot1', OdometryReading(PERIOD * k, wheels))
        walls = world(k, true, random)
        scan = scan_of(walls, true, 0.01, random, stamp=PERIOD * k, farthest=farthest)
        agent.add('robot1', scan)
    return agent


def closure_errors(agent, path):
    """Return the errors (n,) m, (n,) rad of the closures."""

    def true(keyframe):
        return path[round(agent.belief.stamp_of(keyframe) / PERIOD)]

    closures = agent.loops.search.closures
    off = [
        between(np.asarray(true(c.keyframe_a).between(true(c.keyframe_b))), np.asarray(c.pose))
        for c in closures
    ]
    values = np.array(off).reshape(-1, 3)
    return np.hypot(values[:, 0], values[:, 1]), np.abs(values[:, 2])


def path_errors(agent, path):
    """Return the distances (n,) m of the keyframes from the truth."""
    stamps, poses = agent.trajectory('robot1')
    true = np.array([path[round(stamp / PERIOD)] for stamp in stamps])
    return np.hypot(*(poses - true)[:, :2].T)


def test_glass_leaves_the_loop_to_the_walls_that_return():
    """Every third wall is a pane: it returns half of the scans, else the laser looks through it.

    Behind some panes there is nothing at all, behind others a facade.
    """
    panes = np.arange(len(OFFICE)) % 3 == 0
    facade = polyline((-6.0, -7.0), (20.0, -7.0), (20.0, 17.0))

    def world(_step, _pose, random):
        seen = ~panes | (random.random(len(OFFICE)) < 0.5)
        return np.vstack([OFFICE[seen], facade])

    agent = run(LAP_AND_A_HALF, world)
    distances, turns = closure_errors(agent, LAP_AND_A_HALF)
    assert len(distances) >= 3
    assert distances.max() < 0.15
    assert turns.max() < 0.03
    assert path_errors(agent, LAP_AND_A_HALF).max() < 0.3


def test_along_a_bare_corridor_nothing_is_claimed():
    """30 m of it, out, back and out again, with a laser that sees neither of its ends."""
    path = along((0.0, 0.0), (30.0, 0.0), (0.0, 0.2), (30.0, 0.0), step=STEP)
    walls = np.vstack([polyline((-40.0, y), (70.0, y)) for y in (-1.1, 1.1)])
    agent = run(path, lambda *_: walls, farthest=8.0)
    distances, turns = closure_errors(agent, path)
    for closure, distance in zip(agent.loops.search.closures, distances, strict=True):
        deviation = math.sqrt(np.linalg.eigvalsh(np.linalg.inv(closure.information)[:2, :2])[1])
        assert distance < 3.0 * deviation
    assert (turns < WRONG[1]).all()
    pose, P = agent.estimate('robot1')
    # across the corridor and in heading the walls tell; along it the wheels alone
    assert abs(pose.y - path[-1].y) < 0.2
    assert abs(wrap_angle(pose.theta - path[-1].theta)) < 0.03
    assert abs(pose.x - path[-1].x) < 0.05 * 30.0
    assert abs(pose.x - path[-1].x) < 3.0 * math.sqrt(P[0, 0])


@pytest.mark.parametrize('people', [8, 16])
def test_a_crowd_around_the_vehicle_closes_nothing_wrong(people):
    """On the second visit people walk with the vehicle and hide most of the walls."""
    offsets = np.random.default_rng(people).uniform(-math.pi, math.pi, people)

    def world(step, pose, random):
        if step < SECOND_VISIT:
            return OFFICE
        angles = offsets + 0.2 * random.normal(size=people)
        ranges = random.uniform(0.6, 1.6, people)
        corners = np.array([pose.x, pose.y]) + ranges[:, None] * np.stack(
            [np.cos(angles), np.sin(angles)], axis=1
        )
        return np.vstack([OFFICE, *(box(x, y, x + 0.4, y + 0.4) for x, y in corners)])

    agent = run(LAP_AND_A_HALF, world)
    distances, turns = closure_errors(agent, LAP_AND_A_HALF)
    assert (distances < 0.3).all()
    assert (turns < WRONG[1]).all()
    if people < 10:  # enough of the walls is seen between them; the wheels alone are 0.7 m off
        assert path_errors(agent, LAP_AND_A_HALF).max() < 0.5


def test_moved_furniture_leaves_the_loop_to_what_did_not_move():
    def world(step, _pose, _random):
        return np.vstack([OFFICE, FURNITURE if step < SECOND_VISIT else MOVED])

    agent = run(LAP_AND_A_HALF, world)
    distances, turns = closure_errors(agent, LAP_AND_A_HALF)
    assert len(distances) >= 3
    assert distances.max() < 0.1
    assert turns.max() < 0.02
    assert path_errors(agent, LAP_AND_A_HALF).max() < 0.1
