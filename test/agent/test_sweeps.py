"""Scans whose beams are measured one after the other: in the map, in closures, around vehicles."""

import math

import numpy as np
import pytest

from explore_slam.agent import Agent, AgentConfig, checkpoint
from explore_slam.agent.measurements import scans
from explore_slam.agent.team import Team
from explore_slam.data import LandmarkObservations, LaserScan, OdometryReading, SweepTiming
from explore_slam.errors import AgentError
from explore_slam.geometry import IDENTITY, Pose2, to_world
from explore_slam.settings import with_values
from explore_slam.simulation.worlds.walls import box, distances_along, distances_from
from explore_slam.sweeps import Sweep

ROOM = np.concatenate([box(-4.0, -3.0, 8.0, 6.0), box(1.5, 1.0, 1.0, 1.0)])
BEAMS, RATE = 180, 5.0
MOUNT = Pose2(0.1, 0.0, 0.0)
USUAL = Sweep(0.2)
FEW = with_values(AgentConfig(), {'particles': 20})


def pose_at(stamp):
    """The vehicle turns by 0.9 rad/s; it accelerates for a second after it has stood for one."""
    moving = max(stamp - 1.0, 0.0)
    return Pose2(0.0, 0.0, 0.45 * min(moving, 1.0) ** 2 + 0.9 * max(moving - 1.0, 0.0))


def sweep_from(begin, sweep=USUAL, **changes):
    """The scan whose first beam is measured then."""
    angles = -math.pi + 2.0 * math.pi / BEAMS * np.arange(BEAMS)
    stamp = begin - sweep.begin
    poses = [pose_at(stamp + time) for time in sweep.times(BEAMS)]
    lasers = np.array([pose.compose(MOUNT) for pose in poses])
    ranges = distances_along(ROOM, lasers[:, :2], angles + lasers[:, 2])
    values = {'time_increment': sweep.duration / (BEAMS - 1), 'mount': MOUNT, **changes}
    return LaserScan(
        stamp, angles[0], angles[1] - angles[0], ranges.astype(np.float32), 0.1, 9.0, **values
    )


def turn(agent, until, sweep=USUAL, wheels=1.05, **changes):
    """Add odometry, which turns too far, and scans in the order of their arrival."""
    for tick in range(round(20.0 * until)):
        stamp = 0.05 * tick
        agent.add('a', OdometryReading(stamp, Pose2(0.0, 0.0, wheels * pose_at(stamp).theta)))
        if tick % 4 == 0 and tick:
            agent.add('a', sweep_from(stamp - 0.2, sweep, **changes))


def wrong_cells(agent):
    """Share of the occupied cells more than 0.1 m from the walls."""
    occupied = np.argwhere(agent.grid.to_trinary() == 100)
    assert len(occupied) > 100
    return float(np.mean(distances_from(ROOM, agent.grid.to_point(occupied)) > 0.1))


@pytest.mark.parametrize(
    ('sweep', 'changes'),
    [
        (Sweep(0.2), {}),
        (Sweep(0.2, backward=True), {'timing': SweepTiming(None, 'backward')}),
        (Sweep(0.2, last=True), {'timing': SweepTiming(None, 'auto', 'last')}),
        (Sweep(0.2, True, True), {'timing': SweepTiming(0.2, 'backward', 'last'),
                                  'time_increment': 0.0}),
    ],
)  # fmt: skip
def test_the_map_of_a_turning_vehicle_is_right(sweep, changes):
    agent = Agent(FEW, {'a': IDENTITY})
    turn(agent, 8.0, sweep, **changes)
    assert wrong_cells(agent) <= 0.01
    assert agent.summary()['a']['deskewed_scans'] >= 38
    assert agent.map_pose('a').between(pose_at(7.95)).theta == pytest.approx(
        0.0, abs=0.015
    )  # 5 % of the turn since the last match


def test_without_it_the_map_is_wrong():
    agent = Agent(FEW, {'a': IDENTITY})
    turn(agent, 8.0, timing=SweepTiming(0.0))
    assert wrong_cells(agent) > 0.2
    assert 'deskewed_scans' not in agent.summary()['a']


def test_clouds_that_close_loops_are_undistorted():
    agent = Agent(FEW, {'a': IDENTITY})
    turn(agent, 6.0)
    stamp, cloud = agent.track('a').clouds[-1]
    assert distances_from(ROOM, to_world(pose_at(stamp), cloud.points)).max() < 0.03


def test_scans_of_one_moment_are_used_as_they_are():
    agent = Agent(FEW, {'a': IDENTITY})
    agent.add('a', OdometryReading(0.0, IDENTITY))
    scan = sweep_from(0.0, time_increment=0.0)
    agent.add('a', scan)
    assert [item.scan for item in agent.laser_map.scans] == [scan]
    assert agent.laser_map.scans[0].scan is scan


def test_a_scan_waits_until_odometry_covers_its_sweep():
    agent = Agent(FEW, {'a': IDENTITY})
    agent.add('a', OdometryReading(0.0, IDENTITY))
    agent.add('a', sweep_from(0.0))
    agent.add('a', OdometryReading(0.15, IDENTITY))
    assert agent.laser_map.scans == ()
    agent.add('a', OdometryReading(0.21, IDENTITY))
    (item,) = agent.laser_map.scans
    assert item.scan.stamp == pytest.approx(0.1)  # the middle of the sweep
    assert item.scan.undone_sweep == pytest.approx(0.2)


def test_other_measurements_wait_for_an_earlier_sweep():
    agent = Agent(with_values(FEW, {'scan_matching': False}), {'a': IDENTITY})
    agent.add('a', OdometryReading(0.0, IDENTITY))
    agent.add('a', sweep_from(0.0))
    agent.add('a', LandmarkObservations.empty(0.12))
    agent.add('a', OdometryReading(0.15, IDENTITY))
    assert [event.stamp for event in agent.take_events()] == [0.0]
    agent.add('a', OdometryReading(0.21, IDENTITY))
    assert [event.stamp for event in agent.take_events()] == [0.12]
    assert agent.laser_map.scans[0].keyframe == 0


def test_a_clock_that_jumps_back_drops_incomplete_sweeps():
    agent = Agent(FEW, {'a': IDENTITY})
    agent.add('a', OdometryReading(50.0, IDENTITY))
    agent.add('a', sweep_from(50.0))
    for stamp in (1.0, 1.1, 60.0):
        agent.add('a', OdometryReading(stamp, IDENTITY))
    assert agent.laser_map.scans == ()


def test_the_oldest_of_too_many_sweeps_is_dropped():
    agent = Agent(with_values(FEW, {'measurement_queue_length': 2}), {'a': IDENTITY})
    agent.add('a', OdometryReading(0.0, IDENTITY))
    for number in range(3):
        agent.add('a', sweep_from(0.2 * number))
    assert agent.summary()['a']['dropped_without_odometry'] == 1
    agent.add('a', OdometryReading(1.0, IDENTITY))
    assert agent.summary()['a']['deskewed_scans'] == 2


def test_the_disc_around_another_vehicle_covers_its_motion_within_the_sweep():
    team = Team(FEW, {'a': IDENTITY, 'b': Pose2(2.0, 0.0, 0.0)}, 1)
    for stamp, x in ((0.0, 0.0), (0.1, 0.05), (0.2, 0.1)):
        team.track('b').odometry.add(OdometryReading(stamp, Pose2(x, 0.0, 0.0)))
    moment = LaserScan(0.1, -1.0, 0.1, np.ones(21, np.float32), 0.0, 8.0)
    usual = team.body_radius(team.track('b'), moment)
    swept = LaserScan(
        0.1, -1.0, 0.1, np.ones(21, np.float32), 0.0, 8.0, time_increment=0.01,
        bearings=np.zeros(21, np.float32),
    )  # fmt: skip
    assert team.body_radius(team.track('b'), swept) == pytest.approx(usual + 0.05)


def test_a_saved_state_keeps_the_bearings(tmp_path):
    agent = Agent(FEW, {'a': IDENTITY})
    turn(agent, 3.0)
    agent.add('a', OdometryReading(3.2, Pose2(0.0, 0.0, 0.0)))
    agent.add('a', sweep_from(3.2, time_increment=0.0, scan_time=0.2))
    before = agent.grid.probability().copy()
    path = agent.save_state(tmp_path / 'state.npz')
    other = Agent(FEW, {'a': IDENTITY})
    other.load_state(path)
    assert [item.scan.bearings is None for item in other.laser_map.scans] == [
        item.scan.bearings is None for item in agent.laser_map.scans
    ]
    np.testing.assert_array_equal(other.grid.probability(), before)


def test_a_state_of_the_version_before_is_refused(tmp_path, monkeypatch):
    agent = Agent(FEW, {'a': IDENTITY})
    agent.add('a', OdometryReading(0.0, IDENTITY))
    monkeypatch.setattr(checkpoint, 'VERSION', 3)
    path = agent.save_state(tmp_path / 'state.npz')
    monkeypatch.undo()
    with pytest.raises(AgentError, match='has agent state version 3, expected 5'):
        Agent(FEW, {'a': IDENTITY}).load_state(path)


def test_release_needs_odometry_of_the_whole_sweep():
    team = Team(FEW, {'a': IDENTITY}, 1)
    track = team.track('a')
    track.odometry.add(OdometryReading(0.0, IDENTITY))
    scans.enqueue_scan(team, track, sweep_from(0.0))
    scans.release_sweeps(team, track)
    assert track.sweeps.first == pytest.approx(0.1)
    assert len(track.waiting) == 0
