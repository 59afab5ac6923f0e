"""Planning for the agent's team: states, the operator's requests, reports of followers."""

import logging

import numpy as np
import pytest
from synthetic import SyntheticVehicle, SyntheticWorld

from explore_slam.agent import Agent, AgentConfig, TeamPlanner
from explore_slam.battery import BatteryConfig
from explore_slam.data import (
    BatteryReading,
    FollowerReport,
    FollowerState,
    OdometryReading,
    VehicleBody,
    VehicleState,
)
from explore_slam.errors import AgentError
from explore_slam.exploration import ExplorationConfig, ExplorationStatus, PlanningMode
from explore_slam.geometry import Pose2
from explore_slam.settings import with_values

DRIVING = FollowerReport(FollowerState.DRIVING)
BLOCKED = FollowerReport(FollowerState.BLOCKED, 'obstacle')
START = Pose2(-1.0, -1.5, 0.0)
CONFIG = with_values(AgentConfig(), {'particles': 20, 'empty_searches': 1})


class HalfRoom(SyntheticWorld):
    """The laser sees the left half of its beams only: much remains to be explored."""

    def scan_from(self, stamp, pose, beams=181):
        scan = super().scan_from(stamp, pose, beams)
        scan.ranges[: beams // 2] = float('nan')
        return scan


def make(world_type=HalfRoom, ticks=3, config=CONFIG):
    agent = Agent(config, {'robot1': START}, 1)
    vehicle = SyntheticVehicle(world_type(), START, speed=0.0, turn=0.0)
    for _ in range(ticks):
        agent.add('robot1', vehicle.advance())
        agent.add('robot1', vehicle.scan())
    return agent, TeamPlanner(agent), vehicle


def test_without_a_map_exploration_has_started_and_is_not_paused():
    _, planner, _ = make(ticks=0)
    result = planner.plan(1.0)
    assert (result.status, result.searched) == (ExplorationStatus.STARTED, False)
    planner.pause(True)
    assert planner.plan(2.0).status is ExplorationStatus.PAUSED


def test_a_search_that_fails_later_is_a_pause():
    agent, planner, _ = make()
    assert planner.plan(1.0).searched
    agent.advance(100.0)  # the vehicle is silent
    result = planner.plan(100.0)
    assert (result.status, result.searched) == (ExplorationStatus.PAUSED, False)
    assert agent.statuses()[0].state is VehicleState.SILENT


def test_plan_and_state_are_stored_in_the_track():
    agent, planner, _ = make()
    result = planner.plan(1.0)
    track = agent.track('robot1')
    assert track.plan is result.plans['robot1'] is planner.result.plans['robot1']
    assert track.state is VehicleState.DRIVING
    (status,) = agent.statuses()
    assert (status.state, status.goal) == (VehicleState.DRIVING, track.plan.goal)
    planner.pause(True)
    planner.plan(2.0)
    assert (track.plan, track.state) == (None, VehicleState.WAITING)
    assert agent.statuses()[0].goal is None


def test_the_planner_knows_the_size_of_each_vehicle_also_after_a_reset():
    large = VehicleBody(0.6, 0.2)
    agent = Agent(CONFIG, {'robot1': START, 'robot2': START}, 1, {'robot2': large})
    for _ in range(2):
        snapshots = [TeamPlanner(agent)._snapshot(status) for status in agent.statuses()]
        assert [snapshot.body for snapshot in snapshots] == [VehicleBody(), large]
        agent.reset()


def test_a_vehicle_called_home_returns_and_is_home():
    agent, planner, vehicle = make()
    planner.plan(1.0)
    agent.set_pose('robot1', Pose2(-1.0, 1.0, 0.0), 1e-4 * np.eye(3))
    planner.return_home()
    result = planner.plan(2.0)
    track = agent.track('robot1')
    assert result.status is ExplorationStatus.RETURNING
    assert track.state is VehicleState.RETURNING
    assert tuple(track.plan.goal[:2]) == pytest.approx(START[:2], abs=0.15)
    agent.set_pose('robot1', START, 1e-4 * np.eye(3))
    assert planner.plan(3.0).status is ExplorationStatus.RETURNED
    assert track.state is VehicleState.HOME
    assert vehicle.stamp > 0.0


def report_voltage(planner, voltage, start):
    """Report a voltage for 6 s; return whether it has changed the level."""
    readings = [start + 0.5 * step for step in range(13)]
    changes = [planner.report_battery('robot1', BatteryReading(voltage), now) for now in readings]
    return any(changes)


def test_a_low_battery_brings_the_vehicle_home_and_a_critical_one_stops_it(caplog):
    caplog.set_level(logging.INFO)
    agent, _, _ = make()
    planner = TeamPlanner(agent, {'robot1': BatteryConfig(11.5, 11.0)})
    track = agent.track('robot1')
    agent.set_pose('robot1', Pose2(-1.0, 1.0, 0.0), 1e-4 * np.eye(3))
    planner.set_goal('robot1', Pose2(0.5, 1.0, 0.0))
    assert tuple(planner.plan(1.0).plans['robot1'].goal[:2]) == pytest.approx((0.5, 1.0), abs=0.1)
    assert not report_voltage(planner, 12.0, 1.0)
    assert report_voltage(planner, 11.4, 10.0)
    assert 'robot1: battery low: 11.4 V, battery_low is 11.5 V; it drives home; the goal' in (
        caplog.text
    )
    result = planner.plan(20.0)
    assert tuple(result.plans['robot1'].goal[:2]) == pytest.approx(START[:2], abs=0.15)
    assert (track.state, result.status) == (
        VehicleState.RETURNING, ExplorationStatus.IN_PROGRESS,
    )  # fmt: skip
    planner.set_goal('robot1', Pose2(0.5, 1.0, 0.0))  # to a charger, say
    result = planner.plan(21.0)
    assert tuple(result.plans['robot1'].goal[:2]) == pytest.approx((0.5, 1.0), abs=0.1)
    assert track.state is VehicleState.DRIVING
    assert report_voltage(planner, 10.9, 30.0)
    result = planner.plan(40.0)
    assert (track.plan, track.state) == (None, VehicleState.BATTERY_CRITICAL)
    assert result.status is ExplorationStatus.INCOMPLETE
    with pytest.raises(AgentError, match='robot1 cannot be sent anywhere: battery critical'):
        planner.set_goal('robot1', Pose2(0.5, 1.0, 0.0))
    planner.reset()  # does not charge it
    assert planner.plan(41.0).plans == {}
    assert report_voltage(planner, 12.8, 50.0)
    assert planner.plan(60.0).plans.keys() == {'robot1'}
    assert track.state is VehicleState.DRIVING


def test_a_vehicle_with_a_low_battery_is_home_when_it_gets_there():
    agent, _, _ = make()
    planner = TeamPlanner(agent, {'robot1': BatteryConfig(11.5, 11.0)})
    report_voltage(planner, 11.4, 0.0)
    planner.plan(10.0)
    assert agent.track('robot1').state is VehicleState.HOME


def test_a_room_that_is_known_is_done():
    world = SyntheticWorld
    agent = Agent(CONFIG, {'robot1': START}, 1)
    vehicle = SyntheticVehicle(world(), START, speed=0.0, turn=1.0)
    for _ in range(70):
        agent.add('robot1', vehicle.advance())
        agent.add('robot1', vehicle.scan())
    planner = TeamPlanner(agent)
    statuses = [planner.plan(10.0 + k).status for k in range(12)]
    assert statuses[-1] is ExplorationStatus.COMPLETE
    assert agent.track('robot1').state is VehicleState.DONE


def test_a_follower_that_becomes_blocked_is_reported_once():
    agent, planner, _ = make()
    first = planner.plan(1.0).plans['robot1']
    planner.report_follower('robot1', DRIVING, 1.5)
    assert planner.plan(2.0).plans['robot1'] is first
    planner.report_follower('robot1', BLOCKED, 2.5)
    second = planner.plan(3.0).plans['robot1']
    assert second is not first
    assert agent.track('robot1').state is VehicleState.BLOCKED
    planner.report_follower('robot1', BLOCKED, 3.5)
    assert planner.plan(4.0).plans['robot1'] is second
    planner.report_follower('robot1', DRIVING, 4.5)
    planner.plan(5.0)
    assert agent.track('robot1').state is VehicleState.DRIVING


def test_the_goals_of_a_teleoperated_vehicle_go_to_the_others_while_it_is_mapped():
    starts = {'robot1': START, 'robot2': START.compose(Pose2(0.0, 0.9, 0.0))}
    agent = Agent(CONFIG, starts, 1)
    team = {
        name: SyntheticVehicle(HalfRoom(), start, speed=0.0, turn=0.0)
        for name, start in starts.items()
    }
    for _ in range(3):
        for name, vehicle in team.items():
            agent.add(name, vehicle.advance())
            agent.add(name, vehicle.scan())
    planner = TeamPlanner(agent)
    assert set(planner.plan(1.0).plans) == set(starts)
    planner.report_follower('robot1', FollowerReport(FollowerState.TELEOPERATED), 1.5)
    assert set(planner.plan(2.0).plans) == {'robot2'}
    assert agent.track('robot1').state is VehicleState.TELEOPERATED
    before = agent.map_pose('robot1')
    team['robot1'] = SyntheticVehicle(HalfRoom(), START, speed=0.5, turn=0.0)
    for _ in range(12):
        agent.add('robot1', team['robot1'].advance())
        agent.add('robot1', team['robot1'].scan())
    assert agent.map_pose('robot1').x > before.x + 0.3  # it goes on being localized and mapped
    planner.report_follower('robot1', DRIVING, 3.0)
    assert set(planner.plan(4.0).plans) == set(starts)


def test_a_report_of_an_unknown_vehicle_is_refused():
    _, planner, _ = make()
    with pytest.raises(AgentError, match="unknown vehicle 'robot9'"):
        planner.report_follower('robot9', DRIVING, 1.0)


def test_reset_forgets_plan_and_mode():
    agent, planner, _ = make()
    first = planner.plan(1.0).plans['robot1']
    planner.return_home()
    planner.reset()
    assert agent.track('robot1').plan is None
    assert planner.mode is PlanningMode.EXPLORE
    result = planner.plan(2.0)
    assert result.status is ExplorationStatus.STARTED
    assert result.plans['robot1'] is not first


def test_other_settings_start_a_new_planner_and_equal_ones_do_not():
    _, planner, _ = make()
    first = planner.plan(1.0).plans['robot1']
    planner.configure(with_values(ExplorationConfig(), {'empty_searches': 1}))
    assert planner.plan(2.0).plans['robot1'] is first
    planner.configure(with_values(ExplorationConfig(), {'empty_searches': 2}))
    assert planner.plan(3.0).plans['robot1'] is not first


def test_a_lost_vehicle_gets_no_plan():
    agent, planner, vehicle = make()
    assert planner.plan(1.0).plans
    for lost, deviation in ((False, 0.9), (True, 1.1)):
        covariance = np.diag([deviation**2, 0.01, 0.01])
        agent.set_pose('robot1', START, covariance)
        agent.add('robot1', OdometryReading(vehicle.stamp + deviation, vehicle.odometry))
        (status,) = agent.statuses()
        assert (status.state is VehicleState.LOST) is lost
