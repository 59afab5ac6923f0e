"""The agent without ROS: records in, poses and map out; what is malformed changes nothing."""

import math
from dataclasses import replace

import numpy as np
import pytest
from grids import same_grid
from synthetic import ROOM, SyntheticVehicle, SyntheticWorld

from explore_slam.agent import Agent, AgentConfig, TeamPlanner
from explore_slam.data import (
    InterRobotObservation,
    LandmarkObservations,
    OdometryReading,
    VehicleState,
)
from explore_slam.errors import AgentError
from explore_slam.exploration import ExplorationStatus
from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.settings import with_values

STARTS = {'robot1': Pose2(-1.0, -1.5, 0.0), 'robot2': Pose2(1.0, 1.5, math.pi)}
CONFIG = with_values(AgentConfig(), {'particles': 100})


def make_team(config=CONFIG, seed=1):
    world = SyntheticWorld()
    agent = Agent(config, STARTS, seed)
    team = {
        name: SyntheticVehicle(world, pose, seed=number)
        for number, (name, pose) in enumerate(STARTS.items())
    }
    return agent, team


def drive(agent, team, ticks, scans=True):
    for tick in range(ticks):
        for name, vehicle in team.items():
            agent.add(name, vehicle.advance())
            if tick % 5 == 0:
                agent.add(name, vehicle.landmarks())
            if scans and tick % 3 == 0:
                agent.add(name, vehicle.scan())


@pytest.fixture(scope='module')
def driven():
    agent, team = make_team()
    drive(agent, team, 200)
    return agent, team


def test_poses_are_far_better_than_odometry(driven):
    agent, team = driven
    for name, vehicle in team.items():
        pose, covariance = agent.estimate(name)
        alone = STARTS[name].compose(vehicle.odometry)
        assert vehicle.error_of(pose) < 0.05
        assert vehicle.error_of(pose) < 0.5 * vehicle.error_of(alone)
        assert np.linalg.eigvalsh(covariance).min() > 0.0


def test_the_grid_shows_the_walls_where_they_are(driven):
    agent, _ = driven
    grid = agent.grid
    occupied = grid.to_point(np.argwhere(grid.known() & (grid.probability() > 0.65)))
    assert len(occupied) > 300
    off_the_wall = np.abs(np.abs(occupied).max(axis=1) - ROOM)
    assert np.median(off_the_wall) < 0.06
    assert np.quantile(off_the_wall, 0.95) < 0.15
    inside = grid.to_cell(np.array([[0.0, 0.0], [1.0, 0.5]]))
    assert (grid.probability()[inside[:, 0], inside[:, 1]] < 0.2).all()


def test_vehicles_are_no_walls():
    """Two vehicles that see each other all the time leave no trace in the map."""
    agent, team = make_team()
    first, second = team.values()
    first.pose = first.start = Pose2(-1.0, 0.0, 0.0)
    agent.start_poses.update(robot1=Pose2(-1.0, 0.0, 0.0), robot2=Pose2(1.0, 0.0, math.pi))
    second.pose = Pose2(1.0, 0.0, math.pi)
    agent.reset()
    for tick in range(20):
        for name, vehicle in team.items():
            vehicle.step = IDENTITY
            agent.add(name, vehicle.advance())
            scan = vehicle.scan()
            ahead = np.abs(scan.angles) < 0.1
            scan.ranges[ahead] = 1.65  # the body of the other one
            agent.add(name, scan)
        agent.advance(2.2 * tick)
    cells = agent.grid.to_cell(np.array([[0.75, 0.0], [-0.75, 0.0]]))
    assert (agent.grid.probability()[cells[:, 0], cells[:, 1]] < 0.5).all()


def test_the_same_records_give_the_same_belief_and_map(driven):
    agent, _team = driven
    again, team2 = make_team()
    drive(again, team2, 200)
    assert again.estimate('robot1')[0] == agent.estimate('robot1')[0]
    assert same_grid(again.grid, agent.grid)
    np.testing.assert_array_equal(again.landmarks().means, agent.landmarks().means)


def test_records_wait_for_odometry_and_are_used_when_it_comes():
    agent, team = make_team()
    vehicle = team['robot1']
    readings = [vehicle.advance() for _ in range(5)]
    seen = vehicle.landmarks()
    for reading in readings[:-1]:
        agent.add('robot1', reading)
    agent.add('robot1', seen)
    agent.take_events()
    assert len(agent.landmarks().ids) == 0
    agent.add('robot1', readings[-1])
    (event,) = agent.take_events()
    assert event.update.inserted == len(seen)
    assert event.stamp == seen.stamp


def test_late_records_are_counted_and_left_out():
    agent, team = make_team()
    drive(agent, team, 20)
    before = agent.estimate('robot1')[0]
    agent.add('robot1', OdometryReading(1.5, Pose2(9.0, 9.0, 0.0)))
    agent.add('robot1', LandmarkObservations.empty(0.1))
    assert agent.estimate('robot1')[0] == before
    counts = agent.summary()['robot1']
    assert counts['late_odometry'] == 1
    assert counts['late_observations'] == 1


def test_unknown_vehicles_are_named():
    agent, _ = make_team()
    observation = InterRobotObservation(1.0, 'robot9', np.zeros(2), np.eye(2))
    for call in (
        lambda: agent.add('robot9', OdometryReading(1.0, IDENTITY)),
        lambda: agent.add('robot1', observation),
        lambda: agent.estimate('robot9'),
        lambda: agent.set_pose('robot9', IDENTITY, np.eye(3)),
    ):
        with pytest.raises(AgentError, match=r"unknown vehicle 'robot9'.*robot1.*robot2"):
            call()
    with pytest.raises(AgentError, match='start_poses is empty'):
        Agent(CONFIG, {})


def test_a_clock_that_jumps_back_loses_nothing(caplog):
    agent, team = make_team()
    drive(agent, team, 100)
    held = len(agent.landmarks().ids)
    for vehicle in team.values():
        vehicle.stamp = 0.0
    drive(agent, team, 100)
    assert 'went back' in caplog.text
    assert len(agent.landmarks().ids) >= held
    for name, vehicle in team.items():
        assert vehicle.error_of(agent.estimate(name)[0]) < 0.06


def test_the_motion_until_a_clock_jumps_back_is_kept():
    """Scans go on at the keyframe that was the newest, which has an anchor already."""
    agent, team = make_team()
    vehicle = team['robot1']
    for ticks in (43, 44, 47, 51):
        for tick in range(ticks):
            agent.add('robot1', vehicle.advance())
            if tick % 3 == 0:
                agent.add('robot1', vehicle.scan())
        before = agent.estimate('robot1')[0]
        vehicle.stamp = 0.0
        agent.add('robot1', OdometryReading(0.01, vehicle.odometry))
        after = agent.estimate('robot1')[0]
        assert before.between(after) == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)


def test_a_driver_that_was_restarted_with_an_earlier_clock_leaves_the_vehicle_lost(caplog):
    agent, team = make_team()
    drive(agent, team, 60)
    pose = agent.estimate('robot1')[0]
    agent.add('robot1', OdometryReading(0.5, IDENTITY))
    agent.add('robot1', OdometryReading(0.6, Pose2(0.01, 0.0, 0.0)))
    (state,) = [item.state for item in agent.statuses() if item.vehicle == 'robot1']
    assert state is VehicleState.LOST
    assert math.dist(agent.estimate('robot1')[0][:2], pose[:2]) < 0.2
    assert caplog.text.count('the driver was restarted') == 1


def test_a_base_that_is_reset_under_way_does_not_move_the_vehicle(caplog):
    agent, team = make_team()
    drive(agent, team, 60)
    for vehicle in team.values():
        vehicle.odometry = IDENTITY
    drive(agent, team, 60)
    assert 'reset of the base' in caplog.text
    for name, vehicle in team.items():
        assert vehicle.error_of(agent.estimate(name)[0]) < 0.06


def test_without_camera_scans_still_make_a_map():
    agent, team = make_team()
    for tick in range(120):
        for name, vehicle in team.items():
            agent.add(name, vehicle.advance())
            if tick % 3 == 0:
                agent.add(name, vehicle.scan())
    assert len(agent.trajectory('robot1')[0]) > 5
    assert agent.grid.known().sum() > 5000


def test_pause_ignores_measurements_but_follows_odometry():
    agent, team = make_team()
    drive(agent, team, 40)
    held = len(agent.landmarks().ids)
    agent.paused = True
    drive(agent, team, 40)
    assert len(agent.landmarks().ids) == held
    assert agent.summary()['robot1']['ignored_while_paused'] > 0
    agent.paused = False
    drive(agent, team, 40)
    for name, vehicle in team.items():
        assert vehicle.error_of(agent.estimate(name)[0]) < 0.06


def test_silent_vehicles_are_reported():
    agent, team = make_team()
    drive(agent, team, 20)
    for _ in range(50):
        agent.add('robot1', team['robot1'].advance())
    states = {status.vehicle: status.state for status in agent.statuses()}
    assert states['robot2'] is VehicleState.SILENT
    assert states['robot1'] is not VehicleState.SILENT


def test_state_round_trips_through_a_file(tmp_path):
    agent, team = make_team()
    drive(agent, team, 80)
    path = agent.save_state(tmp_path / 'state.npz')
    pose, grid = agent.estimate('robot1')[0], agent.grid
    other = Agent(CONFIG, STARTS, seed=5)
    other.load_state(path)
    np.testing.assert_array_equal(other.landmarks().means, agent.landmarks().means)
    assert same_grid(other.grid, grid)
    assert tuple(other.estimate('robot1')[0]) == pytest.approx(tuple(pose))
    for vehicle in team.values():
        vehicle.odometry = IDENTITY  # the bases were switched off and on
    drive(other, team, 60)
    for name, vehicle in team.items():
        assert vehicle.error_of(other.estimate(name)[0]) < 0.06


def test_a_bad_state_file_changes_nothing(tmp_path, driven):
    agent, _ = driven
    before = agent.estimate('robot1')[0]
    path = tmp_path / 'state.npz'
    for content in (None, b'', b'garbage'):
        if content is not None:
            path.write_bytes(content)
        with pytest.raises(AgentError, match=r'state cannot be loaded: .*state\.npz'):
            agent.load_state(path)
    assert agent.estimate('robot1')[0] == before
    agent.save_state(path)
    before = agent.estimate('robot1')[0]
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(AgentError, match='state cannot be loaded'):
        agent.load_state(path)
    path.write_bytes(whole)
    with pytest.raises(AgentError, match=r"is of vehicles \['robot1', 'robot2'\]"):
        Agent(CONFIG, {'other': IDENTITY}).load_state(path)
    assert agent.estimate('robot1')[0] == before


def test_reset_forgets_everything():
    agent, team = make_team()
    drive(agent, team, 30)
    agent.reset()
    assert len(agent.landmarks().ids) == 0
    assert tuple(agent.estimate('robot1')[0]) == pytest.approx(tuple(STARTS['robot1']))
    assert agent.grid.known().sum() == 0


def test_a_person_may_relocate_a_vehicle():
    agent, team = make_team()
    drive(agent, team, 20)
    place = Pose2(2.0, 2.0, 1.0)
    agent.set_pose('robot1', place, np.diag([0.01, 0.01, 0.01]))
    pose, _ = agent.belief.estimate('robot1')
    assert tuple(pose) == pytest.approx(tuple(place), abs=1e-6)


def test_the_team_plans_and_a_closed_room_is_complete(driven):
    agent, _ = driven
    planner = TeamPlanner(agent)
    assert planner.result.status is ExplorationStatus.STARTED
    results = [planner.plan(20.0 + 2.0 * cycle) for cycle in range(12)]
    assert results[-1].status is ExplorationStatus.COMPLETE
    planner.return_home()
    result = planner.plan(60.0)
    assert result.status is ExplorationStatus.RETURNING
    for name, plan in result.plans.items():
        np.testing.assert_allclose(plan.waypoints[-1], STARTS[name][:2], atol=0.15)
    planner.pause(True)
    assert planner.plan(62.0).status is ExplorationStatus.PAUSED


def test_dedicated_maps_leave_inter_robot_observations_out():
    agent, team = make_team(with_values(CONFIG, {'maps': 'dedicated'}))
    drive(agent, team, 30)
    observation = InterRobotObservation(2.9, 'robot2', np.array([2.0, 0.0]), 0.01 * np.eye(2))
    agent.add('robot1', observation)
    drive(agent, team, 4)  # it waits for the scan after it
    assert agent.summary()['robot1']['unused_inter_robot_observations'] == 1
    for name, vehicle in team.items():
        assert vehicle.error_of(agent.estimate(name)[0]) < 0.05


def test_scans_make_odometry_better_where_nothing_else_is_seen():
    errors = {}
    for matching in (True, False):
        agent, team = make_team(with_values(CONFIG, {'scan_matching': matching}))
        for tick in range(150):
            for name, vehicle in team.items():
                agent.add(name, vehicle.advance())
                if tick % 2 == 0:
                    agent.add(name, vehicle.scan())
        errors[matching] = {n: v.error_of(agent.estimate(n)[0]) for n, v in team.items()}
        counts = agent.summary()['robot1']
        assert ('matched_scans' in counts) is matching
    for name in STARTS:
        assert errors[True][name] < 0.03
        assert errors[True][name] < 0.5 * errors[False][name]


def test_frames_wait_for_the_next_scan_but_not_for_ever():
    agent, team = make_team()
    vehicle = team['robot1']
    for _ in range(3):
        agent.add('robot1', vehicle.advance())
        agent.add('robot1', vehicle.scan())
    agent.add('robot1', vehicle.advance())
    agent.take_events()
    seen = vehicle.landmarks()
    agent.add('robot1', seen)
    assert not agent.take_events()
    agent.add('robot1', vehicle.advance())
    assert not agent.take_events()
    agent.add('robot1', vehicle.scan())
    assert [event.stamp for event in agent.take_events()] == [seen.stamp]
    agent.add('robot1', vehicle.advance())
    silent = vehicle.landmarks()
    agent.add('robot1', silent)
    for _ in range(4):  # no scan any more
        agent.add('robot1', vehicle.advance())
    assert [event.stamp for event in agent.take_events()] == [silent.stamp]


def test_a_scan_from_before_the_newest_keyframe_is_not_matched():
    agent, team = make_team()
    vehicle = team['robot1']
    for _ in range(4):
        agent.add('robot1', vehicle.advance())
        agent.add('robot1', vehicle.scan())
    late = vehicle.scan()
    for _ in range(8):
        agent.add('robot1', vehicle.advance())
    agent.add('robot1', vehicle.landmarks())
    agent.add('robot1', vehicle.advance())
    track = agent.track('robot1')
    assert track.keyframe.stamp > late.stamp
    until, counts = track.matched_until, track.counts['matched_scans']
    agent.add('robot1', replace(late, stamp=late.stamp + 0.05))
    assert (track.matched_until, track.counts['matched_scans']) == (until, counts)
    agent.add('robot1', vehicle.scan())
    assert track.matched_until == vehicle.stamp


@pytest.mark.parametrize(('silence', 'silent'), [(2.9, False), (3.1, True)])
def test_a_vehicle_is_silent_after_the_timeout(silence, silent):
    agent, team = make_team()
    drive(agent, team, 20)
    agent.advance(team['robot1'].stamp + silence)
    states = {status.state for status in agent.statuses()}
    assert (states == {VehicleState.SILENT}) is silent


def test_time_goes_forward_except_where_the_clock_jumps_back():
    agent, _ = make_team()
    agent.advance(10.0)
    agent.advance(9.5)
    assert agent.now == 10.0
    agent.advance(8.0)
    assert agent.now == 8.0
    with pytest.raises(AgentError, match='time is nan'):
        agent.advance(math.nan)


def test_the_estimate_follows_odometry_between_keyframes():
    agent, team = make_team()
    drive(agent, team, 30)
    vehicle = team['robot1']
    before, covariance = agent.estimate('robot1')
    place = agent.map_pose('robot1')
    last = agent.track('robot1').odometry.pose
    for _ in range(3):
        agent.add('robot1', vehicle.advance())
    moved = last.between(agent.track('robot1').odometry.pose)
    # its odometry is corrected by a calibration of about a percent
    pose, later = agent.estimate('robot1')
    np.testing.assert_allclose(pose, before.compose(moved), atol=0.01)
    np.testing.assert_allclose(agent.map_pose('robot1'), place.compose(moved), atol=0.01)
    assert np.linalg.det(later) > np.linalg.det(covariance)


def test_settings_can_be_replaced_and_those_of_the_filter_at_the_next_reset():
    agent, team = make_team()
    drive(agent, team, 10)
    agent.configure(
        with_values(CONFIG, {'particles': 30, 'minimum_travel_distance': 9.0, 'laser_x': 0.7})
    )
    track = agent.track('robot1')
    assert track.selector.config.minimum_travel_distance == 9.0
    assert len(agent.belief.particle_poses('robot1')) == 100
    agent.reset()
    assert len(agent.belief.particle_poses('robot1')) == 30
    assert agent.now == 0.0


def test_what_must_not_change_is_not_saved_twice(tmp_path):
    agent, team = make_team()
    drive(agent, team, 21)
    for name in STARTS:
        agent.add(name, team[name].advance())
    count = len(agent.trajectory('robot1')[0])
    agent.save_state(tmp_path / 'state.npz')
    assert len(agent.trajectory('robot1')[0]) == count + 1
    agent.save_state(tmp_path / 'state.npz')
    assert len(agent.trajectory('robot1')[0]) == count + 1
