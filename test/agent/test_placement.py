"""Restarts of agent and driver do no harm: no vehicle drives on an unconfirmed pose."""

import numpy as np
import pytest
from synthetic import SyntheticVehicle, SyntheticWorld

from explore_slam.agent import Agent, AgentConfig, TeamPlanner
from explore_slam.data import OdometryReading, VehicleState
from explore_slam.errors import AgentError, SlamError
from explore_slam.exploration import ExplorationStatus
from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.settings import with_values

START = Pose2(-1.0, -1.5, 0.0)
CONFIG = with_values(AgentConfig(), {'particles': 20, 'empty_searches': 1})
TIGHT = np.diag([0.01, 0.01, 0.01])


def drive(agent, vehicle, ticks, *, landmarks=False, offset=IDENTITY):
    for tick in range(ticks):
        reading = vehicle.advance()
        agent.add('robot1', OdometryReading(reading.stamp, offset.compose(reading.pose)))
        agent.add('robot1', vehicle.scan())
        if landmarks and tick % 5 == 0:
            agent.add('robot1', vehicle.landmarks())


def make(seed=1):
    return Agent(CONFIG, {'robot1': START}, seed), SyntheticVehicle(SyntheticWorld(), START)


def test_an_agent_that_starts_while_a_vehicle_is_under_way_stays_paused(caplog):
    agent, vehicle = make()
    planner = TeamPlanner(agent)
    drive(agent, vehicle, 20, offset=Pose2(4.0, 1.0, 0.5))
    assert planner.plan(2.0).status is ExplorationStatus.PAUSED
    assert planner.result.plans == {}
    assert caplog.text.count('odometry begins at (4.00 m, 1.00 m, 0.50 rad)') == 1
    planner.pause(False)  # the operator confirms the start pose
    assert planner.plan(2.5).searched


def test_a_vehicle_that_is_placed_need_not_be_confirmed():
    agent, vehicle = make()
    planner = TeamPlanner(agent)
    drive(agent, vehicle, 3, offset=Pose2(4.0, 1.0, 0.5))
    agent.set_pose('robot1', vehicle.pose, TIGHT)
    drive(agent, vehicle, 20, offset=Pose2(4.0, 1.0, 0.5))
    assert planner.plan(2.5).searched


def test_a_vehicle_is_placed_where_it_is_now():
    agent, vehicle = make()
    for _ in range(30):  # without scans there are no keyframes on the way
        agent.add('robot1', vehicle.advance())
    given = Pose2(1.0, 2.0, -1.0)
    before = agent.estimate('robot1')
    with pytest.raises(SlamError, match='covariance'):
        agent.set_pose('robot1', given, np.diag([1.0, -1.0, 1.0]))
    for x in (1e7, 1e300):
        with pytest.raises(AgentError, match='from the nearest vehicle, expected at most'):
            agent.set_pose('robot1', Pose2(x, 0.0, 0.0), TIGHT)
    assert agent.estimate('robot1')[0] == before[0]
    agent.set_pose('robot1', given, 1e-4 * TIGHT)
    assert tuple(agent.estimate('robot1')[0]) == pytest.approx(given, abs=0.01)


def test_odometry_from_zero_needs_no_confirmation():
    agent, vehicle = make()
    planner = TeamPlanner(agent)
    drive(agent, vehicle, 20)
    assert planner.plan(2.0).searched


def test_a_reset_away_from_the_start_pauses(caplog):
    agent, vehicle = make()
    planner = TeamPlanner(agent)
    drive(agent, vehicle, 60)
    agent.reset()
    planner.reset()
    drive(agent, vehicle, 5)
    assert planner.plan(7.0).status is ExplorationStatus.PAUSED
    assert 'may not be at its start pose' in caplog.text


def test_a_loaded_state_is_confirmed_where_its_vehicle_still_stands(tmp_path, caplog):
    agent, vehicle = make()
    planner = TeamPlanner(agent)
    drive(agent, vehicle, 60, landmarks=True)
    path = agent.save_state(tmp_path / 'state.npz')
    agent.load_state(path)
    drive(agent, vehicle, 5)
    assert planner.plan(7.0).searched
    drive(agent, vehicle, 60)
    agent.load_state(path)  # meanwhile it has driven on
    drive(agent, vehicle, 5)
    assert planner.plan(14.0).status is ExplorationStatus.PAUSED
    assert 'its pose differs from the loaded state by' in caplog.text
    fresh = Agent(CONFIG, {'robot1': START}, 1)
    fresh.load_state(path)
    assert 'its motion since the state was saved is unknown' in caplog.text
    assert TeamPlanner(fresh).plan(14.0).status is ExplorationStatus.PAUSED


def restarted():
    """An agent whose vehicle was carried away while its driver was restarted."""
    agent, vehicle = make()
    drive(agent, vehicle, 80, landmarks=True)
    vehicle.odometry = IDENTITY
    vehicle.pose = vehicle.pose.compose(Pose2(0.5, 0.4, 0.6))
    vehicle.stamp += 3.0
    agent.add('robot1', OdometryReading(vehicle.stamp, IDENTITY))
    return agent, vehicle


def test_a_displaced_vehicle_stands_until_it_is_placed(caplog):
    agent, vehicle = restarted()
    planner = TeamPlanner(agent)
    known = int(agent.grid.known().sum())
    drive(agent, vehicle, 10)
    (status,) = agent.statuses()
    assert status.state is VehicleState.LOST
    assert planner.plan(agent.now).plans == {}
    planner.pause(False)  # a resume places nobody
    assert planner.plan(agent.now).plans == {}
    # its scans do not enter the map at the wrong pose
    assert int(agent.grid.known().sum()) == known
    assert agent.summary()['robot1']['scans_while_displaced'] == 10
    assert caplog.text.count('it stays stopped until it is relocalized') == 1
    agent.set_pose('robot1', vehicle.pose, TIGHT)
    drive(agent, vehicle, 5)
    assert agent.statuses()[0].state is not VehicleState.LOST


class HalfRoom(SyntheticWorld):
    """The laser sees the left half of its beams only: much remains to be explored."""

    def scan_from(self, stamp, pose, beams=181):
        scan = super().scan_from(stamp, pose, beams)
        scan.ranges[: beams // 2] = float('nan')
        return scan


@pytest.mark.parametrize('cause', ['driver restarted', 'lost', 'silent'])
def test_the_only_vehicle_stops_when_it_must_not_drive(cause):
    agent = Agent(CONFIG, {'robot1': START}, 1)
    vehicle = SyntheticVehicle(HalfRoom(), START, speed=0.4, turn=0.0)
    planner = TeamPlanner(agent)
    drive(agent, vehicle, 20)
    plan = planner.plan(agent.now).plans['robot1']
    assert agent.track('robot1').plan is plan
    assert not planner.must_withdraw
    if cause == 'driver restarted':
        vehicle.stamp += 2.5
        vehicle.odometry = IDENTITY
        agent.add('robot1', OdometryReading(vehicle.stamp, IDENTITY))
        assert planner.must_withdraw
    elif cause == 'lost':
        agent.set_pose('robot1', vehicle.pose, np.diag([25.0, 25.0, 1.0]))
        drive(agent, vehicle, 1)
    else:
        agent.advance(agent.now + 60.0)
    result = planner.plan(agent.now)
    assert result.plans == {}
    assert agent.track('robot1').plan is None
    assert not planner.must_withdraw


def test_a_displaced_vehicle_is_relocalized_by_its_landmarks(caplog):
    agent, vehicle = restarted()
    caplog.set_level('INFO')
    drive(agent, vehicle, 150, landmarks=True)
    assert 'relocalized by its landmarks' in caplog.text
    assert agent.statuses()[0].state is not VehicleState.LOST
    assert vehicle.error_of(agent.estimate('robot1')[0]) < 0.1
