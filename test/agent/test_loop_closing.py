"""Loops closed by laser through the agent: a lap around an office with drifting wheels."""

import math

import numpy as np
import pytest
from registration.ray_caster import scan_of
from slam.closures.drives import along
from slam.closures.test_loop_search import FURNITURE, LAP, OFFICE

from explore_slam.agent import Agent, AgentConfig
from explore_slam.data import OdometryReading
from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.settings import with_values

WORLD = np.vstack([OFFICE, FURNITURE])
ROUTE = along(*LAP, *LAP[1:3], step=0.15)


def run(vehicles=1, noise_seed=0, **values):
    """Drive the route (a second vehicle in the other sense) with wheels that drift."""
    routes = [ROUTE, [Pose2(p.x, p.y, p.theta + math.pi) for p in reversed(ROUTE)]][:vehicles]
    config = with_values(AgentConfig(), {'particles': 100, 'laser_x': 0.0, **values})
    names = [f'robot{n + 1}' for n in range(vehicles)]
    agent = Agent(config, dict(zip(names, (r[0] for r in routes), strict=True)), seed=1)
    random = np.random.default_rng(noise_seed)
    wheels = dict.fromkeys(names, IDENTITY)
    last = dict.fromkeys(names)
    for tick in range(len(ROUTE)):
        for name, route in zip(names, routes, strict=True):
            true, stamp = route[tick], 0.3 * tick
            if last[name] is not None:
                u = np.array(last[name].between(true)) * (1.03, 1.0, 1.02)
                u += random.normal(size=3) * (0.004, 0.002, 0.01)
                wheels[name] = wheels[name].compose(Pose2(*u))
            last[name] = true
            agent.add(name, OdometryReading(stamp, wheels[name]))
            agent.add(name, scan_of(WORLD, true, 0.01, random, stamp=stamp))
    return agent, dict(zip(names, routes, strict=True))


def errors(agent, name, route):
    """Return the distances (m) of the keyframes from the truth."""
    stamps, poses = agent.trajectory(name)
    true = np.array([route[round(stamp / 0.3)] for stamp in stamps])
    return np.hypot(*(poses - true)[:, :2].T)


@pytest.fixture(scope='module')
def closed():
    return run()


def test_a_loop_is_closed_and_the_path_is_more_certain_than_without(closed):
    agent, routes = closed
    counts = agent.summary()['robot1']
    assert counts['closures'] >= 5
    assert 'closures_retracted' not in counts
    assert counts['matched_scans'] > 0.9 * len(ROUTE)
    open_loop, _ = run(laser_closures=False)
    assert 'closures' not in open_loop.summary()['robot1']
    drifted = errors(open_loop, 'robot1', routes['robot1']).mean()
    assert errors(agent, 'robot1', routes['robot1']).mean() < max(1.1 * drifted, 0.02)
    # scan matching hardly drifts over one lap: what the loops are worth is certainty
    variance, without = (a.estimate('robot1')[1].trace() for a in (agent, open_loop))
    assert variance < 0.5 * without


def test_the_covariance_covers_the_error(closed):
    agent, routes = closed
    pose, P = agent.estimate('robot1')
    off = np.asarray(pose) - np.asarray(routes['robot1'][-1])
    off[2] = (off[2] + math.pi) % (2.0 * math.pi) - math.pi
    assert off @ np.linalg.solve(P, off) < 12.0
    assert math.sqrt(P[0, 0] + P[1, 1]) < 0.2


def test_the_walls_are_single_in_the_grid(closed):
    agent, _ = closed
    grid = agent.grid
    # across the lower wall at y = 0 there is one line of occupied cells, not two
    xs = np.arange(2.0, 5.0, 0.1)
    ys = np.arange(-0.4, 0.4, grid.resolution)
    cells = grid.to_cell(np.array([(x, y) for x in xs for y in ys]))
    occupied = (grid.probability()[cells[:, 0], cells[:, 1]] > 0.6).reshape(len(xs), -1)
    assert occupied.any(axis=1).mean() > 0.8
    assert occupied.sum(axis=1).mean() < 3.5


def test_two_vehicles_close_on_each_other_and_share_their_group():
    agent, routes = run(vehicles=2)
    belief = agent.belief.filters[0]
    assert belief.groups.of(0) is belief.groups.of(1)
    for name, route in routes.items():
        assert errors(agent, name, route).mean() < 0.08


def test_the_same_records_give_the_same_closures(closed):
    again, _ = run()
    np.testing.assert_array_equal(again.belief.best_path(), closed[0].belief.best_path())


def test_closures_survive_a_checkpoint(tmp_path, closed):
    agent, _ = closed
    path = agent.save_state(tmp_path / 'state.npz')
    other = Agent(agent.config, agent.start_poses, seed=1)
    other.load_state(path)
    one, two = (item._team.loops for item in (agent, other))
    assert len(two.search.anchors) == len(one.search.anchors)
    assert [c.row().tolist() for c in two.search.closures] == [
        c.row().tolist() for c in one.search.closures
    ]
    state, restored = one.state_dict(), two.state_dict()
    assert state.keys() == restored.keys()
    for name in state:
        np.testing.assert_array_equal(state[name], restored[name])


def test_laps_do_not_let_the_graph_grow():
    """Later laps add neither variables nor factors, and the vehicle stays where it is."""
    config = with_values(AgentConfig(), {'particles': 50, 'laser_x': 0.0})
    lap = along(*LAP, step=0.3)
    agent, random = Agent(config, {'robot1': lap[0]}, seed=1), np.random.default_rng(0)
    wheels, sizes = lap[0], []
    for tick, true in enumerate(lap * 6):
        u = np.array(lap[(tick - 1) % len(lap)].between(true)) * (1.02, 1.0, 1.02)
        wheels = wheels.compose(Pose2(*(u + random.normal(size=3) * (0.004, 0.002, 0.01))))
        agent.add('robot1', OdometryReading(0.5 * tick, wheels))
        agent.add('robot1', scan_of(WORLD, true, 0.01, random, stamp=0.5 * tick))
        if tick % len(lap) == len(lap) - 1:
            sizes.append((agent.belief.graph_keyframes(), len(agent.loops.search.closures)))
            pose, _ = agent.estimate('robot1')
            assert math.dist(pose[:2], true[:2]) < 0.1
    variables, factors = np.array(sizes).T
    assert agent.summary()['robot1']['closures'] > 1.5 * factors[-1]
    assert variables[5] < 1.1 * variables[3]
    assert factors[5] < 1.1 * factors[3]
    # what was dropped is still on the path, where it belongs
    stamps, poses = agent.trajectory('robot1')
    assert len(stamps) > 5.5 * len(lap)
    true = np.array([lap[round(stamp / 0.5) % len(lap)] for stamp in stamps])
    assert np.hypot(*(poses - true)[:, :2].T).max() < 0.15
