"""Mounts from transforms and from settings; what is inverted, tilted or contradictory is named."""

import logging
import math
from types import SimpleNamespace

import numpy as np
import pytest

from explore_slam import messages
from explore_slam.data import LaserScan, SweepTiming
from explore_slam.errors import ConfigError
from explore_slam.geometry import (
    Pose2,
    Pose3,
    quaternion_from_rotation,
    roll_pitch_yaw,
    rotation_matrix,
)
from explore_slam.messages.base import OPTICAL
from explore_slam.messages.sensor_mounts import SensorMounts, shared_frames
from explore_slam.messages.transforms import TransformTree
from explore_slam.messages.vehicle_settings import (
    VehicleConfig,
    settings_of_vehicles,
    vehicle_settings,
)
from explore_slam.mounts import ExplicitMounts
from explore_slam.recording.rosbags_types import MESSAGES
from explore_slam.sweeps import SweepConfig
from explore_slam.vision import CameraMount

SCAN = LaserScan(1.0, -1.0, 0.5, np.ones(5, np.float32), 0.1, 8.0)


def turn(roll=0.0, pitch=0.0, yaw=0.0):
    return quaternion_from_rotation(rotation_matrix(roll, pitch, yaw))


def tree_of(*links):
    """A tree of (parent, child, position, quaternion)."""
    tree = TransformTree()
    tree.add(message_of(*links))
    return tree


def message_of(*links):
    """A tf2_msgs/TFMessage of (parent, child, position, quaternion)."""
    return SimpleNamespace(
        transforms=[
            messages.transform_message(MESSAGES, 0.0, parent, child, place, rotation)
            for parent, child, place, rotation in links
        ]
    )


def odometry(base='base_link', frame='odom'):
    return SimpleNamespace(child_frame_id=base, header=SimpleNamespace(frame_id=frame))


def test_a_scan_gets_the_settings_of_the_vehicle_for_its_sweeps():
    own = VehicleConfig(sweep=SweepConfig(0.1, 'backward', 'last'))
    scan = LaserScan(1.0, -1.0, 0.1, np.ones(21, np.float32), 0.0, 8.0, time_increment=1e-4)
    placed = SensorMounts('r', TransformTree(), own).place_scan(scan, 'laser')
    assert placed.timing == SweepTiming(0.1, 'backward', 'last')
    assert placed.time_increment == 1e-4


def test_a_frame_is_found_through_its_ancestors():
    tree = tree_of(
        ('/odom', 'base_footprint', (9.0, 9.0, 0.0), turn(yaw=1.0)),
        ('base_footprint', 'base_link', (0.0, 0.0, 0.1), turn()),
        ('base_link', 'mast', (0.1, 0.0, 0.5), turn(yaw=math.pi / 2)),
        ('mast', '/laser', (0.2, 0.0, 0.0), turn(yaw=math.pi / 2)),
    )
    found = tree.lookup('base_footprint', 'laser')
    assert np.allclose(found.position, (0.1, 0.2, 0.6))
    assert np.allclose(found.rotation, rotation_matrix(0.0, 0.0, math.pi))
    back = tree.lookup('laser', 'base_footprint')
    assert np.allclose(found.compose(back).position, 0.0)
    assert tree.lookup('base_link', 'camera') is None
    assert 'mast' in tree
    assert 'camera' not in tree


def test_a_frame_of_the_vehicle_goes_before_one_of_that_name_on_a_shared_topic():
    own = message_of(('base_link', 'laser', (0.1, 0.0, 0.0), turn()))
    other = message_of(('base_link', 'laser', (-0.2, 0.0, 0.0), turn()))
    for order in ((own, other), (other, own)):
        tree = TransformTree()
        for message in order:
            tree.add(message, shared=message is other)
        assert tree.lookup('base_link', 'laser').position == (0.1, 0.0, 0.0)
    tree.add(other)  # but the vehicle may move its own
    assert tree.lookup('base_link', 'laser').position == (-0.2, 0.0, 0.0)


def test_transforms_that_are_none_and_circles_are_harmless():
    tree = tree_of(
        ('base_link', 'laser', (math.nan, 0.0, 0.0), turn()),
        ('base_link', 'camera', (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)),
        ('a', 'b', (1.0, 0.0, 0.0), turn()),
        ('b', 'a', (1.0, 0.0, 0.0), turn()),
    )
    assert tree.lookup('base_link', 'laser') is None
    assert tree.lookup('base_link', 'camera') is None
    assert tree.lookup('base_link', 'a') is None


@pytest.mark.parametrize('yaw', [0.0, math.pi / 2, -3.0])
def test_a_scan_gets_the_mount_of_its_frame(yaw):
    mounts = SensorMounts('r', tree_of(('base_link', 'laser', (0.1, -0.2, 0.3), turn(yaw=yaw))))
    mounts.add_odometry(odometry())
    assert mounts.is_known('laser')
    placed = mounts.place_scan(SCAN, 'laser')
    assert placed.mount == pytest.approx(Pose2(0.1, -0.2, yaw))
    assert placed.angle_increment == SCAN.angle_increment
    assert mounts.report() == {'laser': str(mounts.used['laser'])}
    assert '/tf_static' in mounts.report()['laser']


def test_an_inverted_laser_turns_the_other_way():
    """The direction of every beam is that of the transform in space."""
    rotation = rotation_matrix(math.pi, 0.0, 2.0)
    mounts = SensorMounts(
        'r', tree_of(('base_link', 'laser', (0.0, 0.0, 0.3), turn(math.pi, 0, 2)))
    )
    mounts.add_odometry(odometry())
    placed = mounts.place_scan(SCAN, 'laser')
    beams = np.stack([np.cos(SCAN.angles), np.sin(SCAN.angles), np.zeros(5)])
    expected = (rotation @ beams)[:2]
    angles = placed.angles + placed.mount.theta
    assert np.allclose(np.stack([np.cos(angles), np.sin(angles)]), expected, atol=1e-9)


def test_a_tilted_laser_is_named_once(caplog):
    mounts = SensorMounts('r', tree_of(('base_link', 'laser', (0, 0, 1), turn(pitch=0.4))))
    mounts.add_odometry(odometry())
    with caplog.at_level(logging.WARNING, 'explore_slam'):
        for _ in range(3):
            mounts.place_scan(SCAN, 'laser')
    assert len(caplog.records) == 1
    assert 'tilted by 23°' in caplog.text


def test_settings_apply_without_transforms_and_contradictions_are_named_once(caplog):
    own = VehicleConfig(laser_mount=(0.3, 0.0, 1.0))
    empty = SensorMounts('r', TransformTree(), own)
    assert empty.place_scan(SCAN, 'laser').mount == pytest.approx(Pose2(0.3, 0.0, 1.0))
    assert 'r.laser_mount' in empty.report()['laser']
    team = SensorMounts('r', TransformTree(), team=ExplicitMounts(Pose2(0.2, 0.0, 0.0)))
    assert team.place_scan(SCAN, 'laser').mount == Pose2(0.2, 0.0, 0.0)
    default = SensorMounts('r', TransformTree())
    assert default.place_scan(SCAN, 'laser').mount is None
    both = SensorMounts('r', tree_of(('base_link', 'laser', (0.1, 0.0, 0.0), turn())), own)
    both.add_odometry(odometry())
    caplog.clear()
    with caplog.at_level(logging.WARNING, 'explore_slam'):
        placed = [both.place_scan(SCAN, 'laser') for _ in range(3)]
    assert placed[0].mount == Pose2(0.1, 0.0, 0.0)
    assert len(caplog.records) == 1
    assert 'x 0.100' in caplog.text
    assert 'x 0.300' in caplog.text


def test_a_mount_that_nobody_gives_is_a_warning_and_so_is_one_that_comes_late(caplog):
    caplog.set_level(logging.INFO, 'explore_slam')
    tree = TransformTree()
    mounts = SensorMounts('r', tree)
    mounts.add_odometry(odometry())
    for _ in range(3):
        mounts.place_scan(SCAN, 'laser')
    (record,) = caplog.records
    assert record.levelname == 'WARNING'
    assert (
        'no transform leads from base_link to laser, and r.laser_mount is not set' in caplog.text
    )
    caplog.clear()
    tree.add(message_of(('base_link', 'laser', (0.1, 0.0, 0.0), turn(yaw=math.pi / 2))))
    for _ in range(3):
        mounts.place_scan(SCAN, 'laser')
    (record,) = caplog.records
    assert record.levelname == 'WARNING'
    assert 'yaw 90.0°, from /tf_static; until now it was the default settings' in caplog.text
    assert 'call the service reset' in caplog.text


def test_mounts_that_are_known_from_the_beginning_are_information(caplog):
    caplog.set_level(logging.INFO, 'explore_slam')
    mounts = SensorMounts('r', tree_of(('base_link', 'laser', (0.1, 0.0, 0.0), turn())))
    mounts.add_odometry(odometry())
    mounts.place_scan(SCAN, 'laser')
    given = ExplicitMounts(Pose2(0.2, 0.0, 0.0))
    SensorMounts('r', TransformTree(), team=given).place_scan(SCAN, 'laser')
    # a node of the vehicle reads scans before the transforms have come: it draws no map with them
    tree = TransformTree()
    follower = SensorMounts('r', tree, mapping=False)
    follower.add_odometry(odometry())
    follower.place_scan(SCAN, 'laser')
    tree.add(message_of(('base_link', 'laser', (0.1, 0.0, 0.0), turn())))
    follower.place_scan(SCAN, 'laser')
    assert [record.levelname for record in caplog.records] == ['INFO'] * 4


def test_frames_that_vehicles_share_are_named_with_the_vehicles():
    def vehicle(name, base, odom, laser):
        mounts = SensorMounts(name, tree_of((base, laser, (0.1, 0.0, 0.0), turn())))
        mounts.add_odometry(odometry(base, odom))
        mounts.place_scan(SCAN, laser)
        return mounts

    stock = [vehicle(name, 'base_link', 'odom', 'laser') for name in ('robot1', 'robot2')]
    odom, laser = shared_frames(stock, ())
    assert odom.startswith("robot1 and robot2 have the same odometry frame 'odom'")
    assert laser.startswith("robot1 and robot2 have the same sensor frame 'laser'")
    assert 'set robot1.laser_mount or camera_mount and robot2.laser_mount or camera_mount' in laser
    assert shared_frames(stock, {'robot1', 'robot2'}) == []
    assert shared_frames(stock[:1], ()) == []
    prefixed = [vehicle(n, f'{n}/base_link', f'{n}/odom', f'{n}/laser') for n in ('a', 'b')]
    assert shared_frames(prefixed, ()) == []
    silent = [SensorMounts(name, TransformTree()) for name in ('a', 'b')]
    assert shared_frames(silent, ()) == []


def test_settings_decide_where_robots_publish_the_same_static_frame(caplog):
    ahead, behind = Pose2(0.1, 0.0, 0.0), Pose2(-0.2, 0.0, math.pi / 2)
    bringups = [
        message_of(
            ('base_link', 'plate', (0.0, 0.0, 0.1), turn()),
            ('plate', 'laser', (x, y, 0.0), turn(yaw=yaw)),
        )
        for x, y, yaw in (ahead, behind)
    ]
    robots = {}
    for name, config in (
        ('robot1', VehicleConfig(laser_mount=tuple(ahead))),
        ('robot2', VehicleConfig(laser_mount=tuple(behind))),
        ('robot3', VehicleConfig()),
    ):
        tree = TransformTree()
        robots[name] = SensorMounts(name, tree, config)
        robots[name].add_odometry(odometry())
        for message in bringups:
            for _ in range(2):
                tree.add(message, shared=True, static=True)
    with caplog.at_level(logging.WARNING, 'explore_slam'):
        mounts = {name: one.place_scan(SCAN, 'laser').mount for name, one in robots.items()}
    assert mounts['robot1'] == ahead
    assert mounts['robot2'] == behind
    assert tuple(mounts['robot3']) == pytest.approx(tuple(behind))  # nothing better is known
    assert [record.getMessage() for record in caplog.records] == [
        f'{name}: /tf_static has had different poses of laser, as if several robots published it; '
        f'{name}.laser_mount is used'
        for name in ('robot1', 'robot2')
    ]


def test_a_transform_of_the_vehicle_or_one_that_moves_is_not_contradicted():
    tree = TransformTree()
    tree.add(message_of(('base_link', 'laser', (0.1, 0.0, 0.0), turn())), shared=True, static=True)
    tree.add(message_of(('base_link', 'laser', (0.2, 0.0, 0.0), turn())), shared=True, static=True)
    assert tree.is_contradicted('base_link', 'laser')
    tree.add(message_of(('base_link', 'laser', (0.3, 0.0, 0.0), turn())))  # of the vehicle
    assert not tree.is_contradicted('base_link', 'laser')
    for x in (0.1, 0.2):
        tree.add(message_of(('base_link', 'arm', (x, 0.0, 0.0), turn())), shared=True)
    tree.add(message_of(('base_link', 'arm', (0.3, 0.0, 0.0), turn())), shared=True, static=True)
    assert not tree.is_contradicted('base_link', 'arm')
    assert tree.lookup('base_link', 'laser').position[0] == 0.3


def test_cameras_by_optical_frame_by_body_frame_and_by_setting(caplog):
    body = Pose3((0.2, 0.0, 0.4), turn(pitch=0.3))
    optical = body.compose(Pose3((0.0, 0.0, 0.0), OPTICAL))
    tree = tree_of(
        ('base_link', 'cam_optical_frame', optical.position, optical.quaternion),
        ('base_link', 'cam_link', (0.2, 0.0, 0.4), turn()),
    )
    mounts = SensorMounts('r', tree, VehicleConfig(camera_mount=(0.2, 0.0, 0.4, 0.0, 0.3, 0.0)))
    mounts.add_odometry(odometry())
    with caplog.at_level(logging.WARNING, 'explore_slam'):
        found = mounts.optical_pose('cam_optical_frame')
        assert not caplog.records
        mounts.optical_pose('cam_link')
    assert 'is no optical frame' in caplog.text
    # the mount of the settings and that of the transform are the same to vision
    config = CameraMount(0.2, 0.0, 0.4, 0.0, 0.3, 0.0)
    points = np.array([[0.1, -0.2, 2.0], [0.0, 0.0, 1.0]])
    assert np.allclose(
        CameraMount.from_optical(found).to_vehicle(points), config.to_vehicle(points)
    )
    unknown = mounts.optical_pose('elsewhere')
    assert np.allclose(CameraMount.from_optical(unknown), config)
    assert np.allclose(config.optical_pose.rotation, found.rotation)


def test_base_and_odometry_frames_are_named_by_the_messages_or_set():
    mounts = SensorMounts('r', TransformTree())
    assert (mounts.odom, mounts.base) == ('r/odom', 'r/base_link')
    mounts.add_odometry(odometry('/tb/base_footprint', '/tb/odom'))
    assert (mounts.odom, mounts.base) == ('tb/odom', 'tb/base_footprint')
    given = VehicleConfig(odom_frame='o', robot_base_frame='b')
    mounts = SensorMounts('r', TransformTree(), given)
    mounts.add_odometry(odometry())
    assert (mounts.odom, mounts.base) == ('o', 'b')
    nameless = SensorMounts('r', tree_of(('base_footprint', 'laser', (0, 0, 0), turn())))
    nameless.add_odometry(odometry('', ''))
    assert (nameless.odom, nameless.base) == ('r/odom', 'base_footprint')


def test_vehicles_differ_by_their_own_settings():
    team = VehicleConfig(vision='none')
    own = {'r2.vision': 'agent', 'r2.laser_mount': [0.0, 0.0, 3.1]}
    made = vehicle_settings(team, own, ['r1', 'r2'])
    assert (made['r1'].vision, made['r2'].vision) == ('none', 'agent')
    assert made['r2'].laser_pose() == pytest.approx(Pose2(0.0, 0.0, 3.1))
    assert made['r1'].laser_pose() is None
    with pytest.raises(
        ConfigError, match=r"r2: there is no setting 'vison'; did you mean 'vision'"
    ):
        vehicle_settings(team, {'r2.vison': 'none'}, ['r2'])
    with pytest.raises(ConfigError, match=r"'r3.vision'; did you mean 'r[12].vision'"):
        vehicle_settings(team, {'r3.vision': 'none'}, ['r1', 'r2'])
    with pytest.raises(ConfigError, match=r'r1: laser_mount is \[0.1, 0.2\], expected 3 finite'):
        vehicle_settings(team, {'r1.laser_mount': [0.1, 0.2]}, ['r1'])
    with pytest.raises(ConfigError, match='vision: none'):
        settings_of_vehicles({'vision': False}, ['r1'])
    with pytest.raises(ConfigError, match="there is no setting 'vison'; did you mean 'vision'"):
        settings_of_vehicles({'r1.vison': 'none'}, ['r1'])
    # settings of vehicles that a recording does not hold do no harm
    assert settings_of_vehicles({'r9.vision': 'none'}, ['r1'])['r1'].vision == 'agent'


@pytest.mark.parametrize('angles', [(0.1, -0.4, 2.0), (3.0, 0.2, -1.0), (0.0, math.pi / 2, 0.7)])
def test_roll_pitch_yaw_give_the_rotation_back(angles):
    rotation = rotation_matrix(*angles)
    assert np.allclose(rotation_matrix(*roll_pitch_yaw(rotation)), rotation, atol=1e-7)
