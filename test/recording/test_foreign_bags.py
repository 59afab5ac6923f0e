"""Recordings of other people's robots: topics by type, mounts of /tf_static, odd stamps."""

import json
import math

import numpy as np
import pytest
from foreign_robots import HALF_HEIGHT, HALF_WIDTH, Robot
from scipy import ndimage

from explore_slam import messages
from explore_slam.agent import Agent, AgentConfig
from explore_slam.cli.main import main
from explore_slam.data import LaserScan, OdometryReading
from explore_slam.geometry import Pose2, quaternion_from_rotation, rotation_matrix
from explore_slam.messages.topics import TopicKind
from explore_slam.recording import BagReader, BagWriter, Replay
from explore_slam.recording.recorded_transforms import recorded_transforms
from explore_slam.recording.rosbags_types import MESSAGES
from explore_slam.results.replay_run import replay_bag
from explore_slam.settings import with_values
from explore_slam.sweeps import Sweep

TF = 'tf2_msgs/msg/TFMessage'
SCAN, ODOMETRY = TopicKind.SCAN.message_type, TopicKind.ODOMETRY.message_type
START = Pose2(-2.0, -1.0, 0.0)


def turned_robot():
    return Robot(
        'robot1', START, (-0.1, 0.05, 0.2, 0.0, 0.0, math.pi / 2), 'odom', 'base_footprint',
        'rplidar_link',
    )  # fmt: skip


def write_bag(path, *, transforms=True, scan_ahead=0.0, stamped=True, scan='/scan', broken=False):
    """A robot with a lidar at +90 degrees drives for 12 s; return its true poses by time."""
    robot, rng = turned_robot(), np.random.default_rng(3)
    x, y, z, roll, pitch, yaw = robot.mount
    turn = quaternion_from_rotation(rotation_matrix(roll, pitch, yaw))
    truth = {}
    with BagWriter(path) as writer:
        if transforms:
            link = messages.transform_message(
                MESSAGES, 3.0, robot.base_frame, robot.laser_frame, (x, y, z), turn
            )
            writer.write_message('/tf_static', TF, 1000.0, MESSAGES.make(TF, transforms=[link]))
        for tick in range(120):
            robot.advance(rng)
            now = 1000.0 + 0.1 * tick
            truth[now] = robot.pose
            stamp = now if stamped else 0.0
            reading = OdometryReading(stamp, robot.odometry)
            frames = robot.odom_frame, robot.base_frame
            odometry = messages.odometry_message(MESSAGES, reading, *frames)
            if broken and tick % 3:
                odometry.pose.pose.position.x = math.nan
            writer.write_message('/odom', ODOMETRY, now, odometry)
            record = LaserScan(
                stamp + (scan_ahead if stamped else 0.0), robot.angle_min, math.tau / 360,
                robot.ranges(rng), 0.12, 12.0,
            )  # fmt: skip
            message = messages.scan_message(MESSAGES, record, robot.laser_frame)
            writer.write_message(scan, SCAN, now, message)
    return truth


def check_map_and_pose(data, truth):
    """Extent of the map and poses at the end are right to 5 cm."""
    (vehicle,) = data.vehicles
    stamp, pose = vehicle.estimated.stamps[-1], vehicle.estimated.poses[-1]
    nearest = min(truth, key=lambda time: abs(time - stamp))
    assert nearest == pytest.approx(stamp, abs=0.01)
    assert stamp > 1010.0
    assert math.dist(pose[:2], truth[nearest][:2]) < 0.05
    cells = data.grid.to_trinary()
    walls = data.grid.to_point(np.argwhere(cells == 100))
    low, high = np.percentile(walls, 1, axis=0), np.percentile(walls, 99, axis=0)
    assert np.abs(low - (-HALF_WIDTH, -HALF_HEIGHT)).max() < 0.05
    assert np.abs(high - (HALF_WIDTH, HALF_HEIGHT)).max() < 0.05


STARTS = {'robot1': START}


def test_a_turned_lidar_maps_right_by_its_static_transform(tmp_path):
    truth = write_bag(tmp_path / 'bag')
    data = replay_bag(tmp_path / 'bag', starts=STARTS, options={'particles': 20})
    check_map_and_pose(data, truth)
    assert data.metrics['unusable'] == []
    assert 'from /tf_static' in data.metrics['mounts']['robot1']['rplidar_link']
    assert any('yaw 90.0°, from /tf_static' in note for note in data.notes)


def test_a_frame_in_the_namespace_of_a_vehicle_goes_before_a_shared_one_of_that_name(tmp_path):
    def link(x):
        pose = (x, 0.0, 0.0), quaternion_from_rotation(rotation_matrix(0.0, 0.0, 0.0))
        made = messages.transform_message(MESSAGES, 3.0, 'base_link', 'laser', *pose)
        return MESSAGES.make(TF, transforms=[made])

    with BagWriter(tmp_path / 'bag') as writer:
        writer.write_message('/robot1/tf_static', TF, 1000.0, link(0.1))
        writer.write_message('/tf_static', TF, 1000.1, link(-0.2))
    with BagReader(tmp_path / 'bag') as bag:
        trees = recorded_transforms(bag, ['robot1', 'robot2'])
    found = {name: tree.lookup('base_link', 'laser').position[0] for name, tree in trees.items()}
    assert found == {'robot1': 0.1, 'robot2': -0.2}


def test_without_transforms_the_setting_of_the_vehicle_serves(tmp_path):
    truth = write_bag(tmp_path / 'bag', transforms=False)
    options = {'particles': 20, 'robot1.laser_mount': [-0.1, 0.05, math.pi / 2]}
    data = replay_bag(tmp_path / 'bag', starts=STARTS, options=options)
    check_map_and_pose(data, truth)
    assert 'robot1.laser_mount' in data.metrics['mounts']['robot1']['rplidar_link']


def test_stamps_of_zero_fall_back_to_the_log_time(tmp_path):
    truth = write_bag(tmp_path / 'bag', stamped=False)
    data = replay_bag(tmp_path / 'bag', starts=STARTS, options={'particles': 20})
    check_map_and_pose(data, truth)
    assert sum('stamp zero: the log time is used' in note for note in data.notes) == 2


def test_scans_ahead_of_odometry_are_named_and_an_offset_repairs_them(tmp_path, capsys):
    truth = write_bag(tmp_path / 'bag', scan_ahead=30.0)
    arguments = ['replay', str(tmp_path / 'bag'), '--out', str(tmp_path), '--no-progress']
    arguments += ['--start', 'robot1=-2,-1,0', '--particles', '20']
    assert main(arguments) == 1
    printed = capsys.readouterr()
    assert printed.err.count('stamps on /scan are 30.000 s ahead of those on /odom') == 1
    assert 'of 120 measurements of robot1 lie outside its odometry' in printed.err
    options = {'particles': 20, 'scan_time_offset': -30.0}
    data = replay_bag(tmp_path / 'bag', starts=STARTS, options=options)
    check_map_and_pose(data, truth)
    assert data.metrics['unusable'] == []


def test_a_topic_of_which_most_is_unusable_ends_with_the_reason(tmp_path, capsys):
    write_bag(tmp_path / 'bag', broken=True, scan='/front/scan')
    arguments = ['replay', str(tmp_path / 'bag'), '--out', str(tmp_path), '--no-progress']
    arguments += ['--topic', 'robot1.scan=/front/scan', '--particles', '20']
    assert main(arguments) == 1
    text = capsys.readouterr().err
    assert 'of 120 messages on /odom unusable' in text
    assert 'pose is (nan' in text
    metrics = json.loads((tmp_path / 'latest' / 'metrics.json').read_text())
    assert metrics['unusable']


@pytest.mark.data
def test_the_turtlebot_with_a_turned_lidar_matches_all_its_scans(recordings):
    data = replay_bag(recordings('bags/turtlebot_lidar_turned'))
    counts = data.metrics['agent']['robot1']
    assert counts['matched_scans'] > 250
    assert counts.get('unmatched_scans', 0) <= 1
    assert 'yaw 90.0°, from /tf_static' in data.metrics['mounts']['robot1']['rplidar_link']


def replayed(folder, settings):
    """The agent after the replay of a bag."""
    with BagReader(folder) as bag:
        replay = Replay(bag, settings=settings)
        agent = Agent(with_values(AgentConfig(), {'particles': 20}), replay.start_poses())
        replay.feed(agent)
    return agent


def entropy_near(cells, grid):
    """Mean entropy (bit) of the known cells of a grid at points (N, 2) m."""
    rows = grid.to_cell(cells)
    rows = rows[grid.contains(rows)]
    known = grid.known()[rows[:, 0], rows[:, 1]]
    p = np.clip(grid.probability()[rows[:, 0], rows[:, 1]][known].astype(float), 1e-6, 1 - 1e-6)
    return float(-(p * np.log2(p) + (1.0 - p) * np.log2(1.0 - p)).mean())


@pytest.mark.data
def test_the_lidar_of_the_turtlebot_measures_its_beams_against_their_order(recordings):
    """Its messages state time_increment, but their scans agree when it is taken backward."""
    folder = recordings('bags/turtlebot_lidar_turned')
    cases = {
        'moment': {'sweep_time': 0.0},
        'forward': {'sweep_direction': 'forward', 'sweep_stamp': 'last'},
        'backward': {'sweep_direction': 'backward', 'sweep_stamp': 'last'},
        'found': {},
    }
    agents = {name: replayed(folder, settings) for name, settings in cases.items()}
    found = agents['found'].track('robot1').sweeps.of('').judge.found
    assert found == Sweep(pytest.approx(0.134, abs=0.003), backward=True, last=True)
    assert agents['found'].found_sweeps() == {'robot1': {'': found}}
    assert agents['backward'].found_sweeps() == {'robot1': {}}  # the settings give it
    grids = {name: agent.grid for name, agent in agents.items()}
    near = np.concatenate(
        [
            grid.to_point(
                np.argwhere(ndimage.binary_dilation(grid.to_trinary() == 100, iterations=3))
            )
            for grid in grids.values()
        ]
    )
    near = np.unique(np.floor(near / 0.05).astype(int), axis=0) * 0.05 + 0.025
    entropy = {name: entropy_near(near, grid) for name, grid in grids.items()}
    assert entropy['forward'] > 1.02 * entropy['moment']
    assert entropy['backward'] < 0.98 * entropy['moment']
    assert entropy['found'] < 0.98 * entropy['moment']
