"""Obstacles in depth images: in the map for plans, kept in files, and for path followers."""

import math
from dataclasses import replace

import numpy as np
import pytest
from vision.depth_scenes import TABLE, cast, frame

from explore_slam.agent import Agent, AgentConfig
from explore_slam.data import LaserScan, OdometryReading
from explore_slam.errors import AgentError
from explore_slam.geometry import Pose2
from explore_slam.settings import with_values
from explore_slam.vision import CameraMount
from explore_slam.vision.obstacles import ObstacleDetector

START = Pose2(1.0, 2.0, 0.5)
USUAL = {'particles': 50, 'scan_matching': False}
SIX = np.full(181, 6.0, np.float32)  # m: a laser that looks below tables


def drive(record, **values):
    """Return an agent with a vehicle before a table; record: makes what it sees at a time."""
    agent = Agent(with_values(AgentConfig(), {**USUAL, **values}), {'robot1': START}, seed=1)
    for tick in range(12):
        stamp = 0.1 * tick
        agent.add('robot1', OdometryReading(stamp, Pose2(0.02 * tick, 0.0, 0.0)))
        agent.add('robot1', LaserScan(stamp, -1.57, 0.01745, SIX, 0.1, 8.0))
        if tick % 2 == 1 and record is not None:
            agent.add('robot1', record(stamp - 0.02))
    return agent


def image(stamp):
    return frame(cast(tables=[TABLE], limit=3.5), stamp)


def view(stamp):
    return ObstacleDetector().detect(image(stamp))


def is_occupied(agent, ahead, left=0.0):
    """Return whether the map is occupied at a place, seen from the start."""
    place = START.compose(Pose2(ahead, left, 0.0))
    ((row, column),) = agent.grid.to_cell([place[:2]])
    return agent.grid.to_trinary()[row, column] == 100


@pytest.mark.parametrize('record', [image, view], ids=['in the agent', 'on the vehicle'])
def test_a_table_is_in_the_map_though_the_laser_looks_below_it(record):
    agent = drive(record)
    for ahead in (1.75, 2.1, 2.5):
        assert is_occupied(agent, ahead, 0.3)
    assert not is_occupied(agent, 1.2)
    assert not is_occupied(agent, 2.1, 1.0)
    assert agent.grid is agent.grid  # made once for one state of the map
    grid = agent.laser_map.grid
    ((row, column),) = grid.to_cell([START.compose(Pose2(2.1, 0.3, 0.0))[:2]])
    assert grid.to_trinary()[row, column] == 0
    (view,) = agent.take_views('robot1')
    assert view.stamp == pytest.approx(1.08)


def test_without_the_setting_and_without_images_the_map_is_that_of_the_laser():
    off = drive(image, depth_obstacles=False)
    assert off.grid is off.laser_map.grid
    assert not is_occupied(off, 2.1, 0.3)
    none = drive(None)
    assert none.grid is none.laser_map.grid


@pytest.mark.parametrize('later', [0.0, 0.01, -0.01])
def test_each_of_two_cameras_shows_its_obstacles(later, tmp_path):
    """Also where both take their images at one moment."""
    left = CameraMount(0.1, 0.0, 0.4, 0.0, 0.0, math.pi / 2.0)

    def both(agent, stamp):
        empty = replace(frame(cast(limit=3.5), stamp), sensor='front')
        table = frame(cast(tables=[TABLE], limit=3.5), stamp + later)
        for one in (empty, replace(table, sensor='left', mount=left.optical_pose)):
            agent.add('robot1', one)

    agent = Agent(with_values(AgentConfig(), USUAL), {'robot1': START}, seed=1)
    for tick in range(12):
        agent.add('robot1', OdometryReading(0.1 * tick, Pose2(0.02 * tick, 0.0, 0.0)))
        agent.add('robot1', LaserScan(0.1 * tick, -1.57, 0.01745, SIX, 0.1, 8.0))
        if tick % 2 == 1:
            both(agent, 0.1 * tick - 0.02)
    assert is_occupied(agent, 0.3, 2.0)
    assert {view.sensor for view in agent.take_views('robot1')} == {'front', 'left'}
    assert not agent.take_views('robot1')
    path = agent.save_state(tmp_path / 'state.npz')
    other = Agent(agent.config, {'robot1': START}, seed=1)
    other.load_state(path)
    assert [item.sensor for item in other.obstacle_map.views] == [
        item.sensor for item in agent.obstacle_map.views
    ]
    assert is_occupied(other, 0.3, 2.0)


def test_obstacles_are_saved_and_loaded(tmp_path):
    agent = drive(image)
    path = agent.save_state(tmp_path / 'state.npz')
    other = Agent(agent.config, {'robot1': START}, seed=1)
    other.load_state(path)
    assert len(other.obstacle_map.views) == len(agent.obstacle_map.views) > 0
    np.testing.assert_array_equal(other.grid.to_trinary(), agent.grid.to_trinary())
    assert is_occupied(other, 2.1, 0.3)


def test_a_state_of_an_earlier_version_is_refused_by_its_number(tmp_path):
    path = drive(None).save_state(tmp_path / 'state.npz')
    content = dict(np.load(path))
    content['agent_version'] = np.array(4)
    np.savez(path, **content)
    with pytest.raises(AgentError, match='version 4, expected 5'):
        drive(None).load_state(path)


@pytest.mark.parametrize('matching', [True, False])
def test_the_vehicle_without_a_laser_maps_with_the_scans_of_its_camera(matching):
    config = with_values(AgentConfig(), USUAL | {'scan_matching': matching})
    agent = Agent(config, {'robot1': START}, seed=1, camera_scans=['robot1'])
    for tick in range(12):
        agent.add('robot1', OdometryReading(0.1 * tick, Pose2(0.02 * tick, 0.0, 0.0)))
        agent.add('robot1', frame(cast(wall=2.2 - 0.02 * tick, limit=3.5), 0.1 * tick))
    assert len(agent.laser_map.scans) > 0
    assert is_occupied(agent, 2.22)
    assert not is_occupied(agent, 1.9)
    # narrow scans do not correct its odometry, but they are searched for loops
    assert agent.tracks['robot1'].odometry.pose == agent.tracks['robot1'].odometry.reading
    assert 'matched_scans' not in agent.summary()['robot1']
    anchors = list(agent.loops.search.anchors)
    assert anchors
    assert all(len(anchor.cloud) > 0 for anchor in anchors)
    other = drive(image)
    assert all(item.scan.ranges.size == 181 for item in other.laser_map.scans)


def test_beams_without_return_of_a_camera_are_free(tmp_path):
    """The floor is seen there, however few other beams are long."""
    mount = CameraMount(0.1, 0.0, 0.4, 0.0, 0.1, 0.0)
    agent = Agent(
        with_values(AgentConfig(), {'particles': 50}),
        {'robot1': START},
        seed=1,
        camera_scans=['robot1'],
    )
    for tick in range(40):
        depth = cast(mount=mount, wall=12.0, limit=8.0)
        depth[:, :40] = 1.0 + 0.002 * (tick % 7)  # something near, in an eighth of the view
        agent.add('robot1', OdometryReading(0.1 * tick, Pose2(0.05 * tick, 0.0, 0.0)))
        agent.add('robot1', replace(frame(depth, 0.1 * tick), mount=mount.optical_pose))
    path = agent.save_state(tmp_path / 'state.npz')
    other = Agent(agent.config, {'robot1': START}, seed=1, camera_scans=['robot1'])
    other.load_state(path)
    for one in (agent, other):
        assert one.grid.known().any()  # drawn
        share, free = one.no_returns['robot1']
        assert share > 0.5
        assert free
        grid = one.laser_map.grid
        ((row, column),) = grid.to_cell([START.compose(Pose2(4.0, -0.5, 0.0))[:2]])
        assert grid.to_trinary()[row, column] == 0


def test_motion_is_not_measured_by_scans_of_a_camera_alone():
    with pytest.raises(AgentError, match='robot1 is scan, expected wheels'):
        Agent(
            AgentConfig(), {'robot1': START}, sources={'robot1': 'scan'}, camera_scans=['robot1']
        )
