"""Vehicles of unknown start through the agent: kept apart, found by laser, joined to one map."""

import math

import numpy as np
import pytest
from agent.test_loop_closing import ROUTE, WORLD, errors
from grids import same_grid
from registration.ray_caster import scan_of

from explore_slam.agent import Agent, AgentConfig, TeamPlanner
from explore_slam.data import OdometryReading, VehicleState
from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.mapping import LaserMap
from explore_slam.settings import with_values

REVERSE = [Pose2(p.x, p.y, p.theta + math.pi) for p in reversed(ROUTE)]
ROUTES = {'robot1': ROUTE, 'robot2': REVERSE}
CONFIG = with_values(AgentConfig(), {'particles': 100, 'laser_x': 0.0})


class Drive:
    """Two vehicles on their routes, with wheels that drift; the start of robot2 is unknown."""

    def __init__(self, world=WORLD, routes=None, **values):
        self.world, self.routes = world, routes or ROUTES
        starts = {'robot1': self.routes['robot1'][0], 'robot2': None}
        self.agent = Agent(with_values(CONFIG, values), starts, seed=1)
        self.random = np.random.default_rng(0)
        self.wheels = dict.fromkeys(self.routes, IDENTITY)
        self.ticks = 0

    def run(self, ticks, until=None):
        """Drive on for some ticks of 0.3 s, or until something is so."""
        for tick in range(self.ticks, self.ticks + ticks):
            self.ticks = tick + 1
            for name, route in self.routes.items():
                if tick >= len(route):
                    continue
                true, stamp = route[tick], 0.3 * tick
                if tick:
                    u = np.array(route[tick - 1].between(true)) * (1.03, 1.0, 1.02)
                    u += self.random.normal(size=3) * (0.004, 0.002, 0.01)
                    self.wheels[name] = self.wheels[name].compose(Pose2(*u))
                self.agent.add(name, OdometryReading(stamp, self.wheels[name]))
                self.agent.add(name, scan_of(self.world, true, 0.01, self.random, stamp=stamp))
            if until is not None and until(self.agent):
                return


def states(agent):
    return {status.vehicle: status.state for status in agent.statuses()}


@pytest.fixture(scope='module')
def joined():
    """A drive until robot2 has joined, with what was known before."""
    drive = Drive()
    drive.run(60)
    agent = drive.agent
    in_map = np.flatnonzero(agent.belief.keyframes_in_map())
    alone = LaserMap(agent.config.mapping)
    for item in agent.laser_map.scans:
        if item.vehicle == 'robot1':
            bodies = [body for body in item.bodies if body.keyframe in in_map]
            alone.add(*item[:-1], bodies)
    alone.redraw(agent.belief.best_path())
    before = {
        'states': states(agent),
        'grid': agent.grid.copy(),
        'alone': alone.grid,
        'trajectory': agent.trajectory('robot2'),
        'events': agent.take_events(),
    }
    drive.run(len(ROUTE), until=lambda agent: agent.is_in_map('robot2'))
    before['tick'] = drive.ticks
    before['joins'] = agent.take_joins()
    drive.run(len(ROUTE))
    return drive, before


def test_before_the_join_a_vehicle_is_apart(joined):
    _, before = joined
    assert before['states']['robot2'] is VehicleState.UNLOCALIZED
    assert before['states']['robot1'] is not VehicleState.UNLOCALIZED
    np.testing.assert_allclose(before['trajectory'][1][0], np.zeros(3), atol=1e-6)
    assert {event.vehicle: event.in_map for event in before['events']} == {
        'robot1': True, 'robot2': False,
    }  # fmt: skip
    # the common grid is that of robot1 alone
    assert before['grid'].known().sum() > 1000
    assert same_grid(before['grid'], before['alone'])


def test_it_joins_where_it_is(joined):
    drive, before = joined
    (join,) = before['joins']
    assert (join.vehicle, join.other) == ('robot2', 'robot1')
    assert 6.0 < join.distance_driven < 30.0
    here, there = (
        drive.routes[name][round(stamp / 0.3)]
        for name, stamp in ((join.vehicle, join.stamp), (join.other, join.other_stamp))
    )
    off = there.between(here).between(join.relative)
    assert math.hypot(off.x, off.y) < 0.15
    agent = drive.agent
    assert VehicleState.UNLOCALIZED not in states(agent).values()
    assert all(event.in_map for event in agent.take_events()[-10:])
    for name, route in ROUTES.items():
        assert errors(agent, name, route).mean() < 0.1
    assert math.dist(agent.home('robot2')[:2], REVERSE[0][:2]) < 0.2
    assert agent.home('robot1') == ROUTE[0]
    belief = agent.belief.filters[0]
    assert belief.groups.of(0) is belief.groups.of(1)


def test_the_scans_from_before_enter_the_map(joined):
    drive, before = joined
    only = [s for s in drive.agent.laser_map.scans if s.vehicle == 'robot2']
    assert len(only) > 50
    after = drive.agent.grid.known().sum()
    assert after > 1.2 * before['grid'].known().sum()


def test_the_same_records_join_at_the_same_moment(joined):
    """Also with a checkpoint before: the search that is going on is begun again in both."""
    _, before = joined
    again = Drive()
    again.run(60)
    again.run(len(ROUTE), until=lambda agent: agent.is_in_map('robot2'))
    assert again.ticks == before['tick']
    assert again.agent.take_joins() == before['joins']


def test_odometry_that_begins_anywhere_or_anew_neither_pauses_nor_joins():
    agent = Agent(CONFIG, {'robot1': ROUTE[0], 'robot2': None}, seed=1)
    agent.add('robot2', OdometryReading(0.0, Pose2(5.0, 3.0, 1.0)))
    assert agent.track('robot2').placement.doubt == ''
    agent.add('robot2', OdometryReading(0.5, Pose2(5.1, 3.0, 1.0)))
    agent.add('robot2', OdometryReading(60.0, Pose2(0.0, 0.0, 0.0)))
    assert agent.track('robot2').placement.displaced
    assert not agent.is_in_map('robot2')


def test_the_planner_leaves_it_out_until_then():
    drive = Drive()
    drive.run(20)
    planner = TeamPlanner(drive.agent)
    result = planner.plan(drive.agent.now)
    assert 'robot2' not in result.plans
    assert 'robot1' in result.plans
    drive.agent.set_pose('robot2', REVERSE[19], 1e-4 * np.eye(3))
    assert drive.agent.is_in_map('robot2')
    assert 'robot2' in planner.plan(drive.agent.now).plans


def test_a_search_for_a_join_goes_on_after_a_checkpoint(tmp_path):
    drive = Drive()
    drive.run(100)
    path = drive.agent.save_state(tmp_path / 'state.npz')
    other = Drive()
    other.agent.load_state(path)
    one, two = (item.agent._team.loops.state_dict() for item in (drive, other))
    assert one.keys() == two.keys()
    for name in one:
        np.testing.assert_array_equal(one[name], two[name])
    assert not other.agent.is_in_map('robot2')
    assert len(one['global_search/pending']) > 0
    np.testing.assert_array_equal(
        drive.agent.belief.keyframes_in_map(), other.agent.belief.keyframes_in_map()
    )
