"""A bag played over live topics reaches the agent's node, which finds what a replay finds."""

import time

import numpy as np
import pytest
import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from ros_domain import own_domain

from explore_slam.data import LandmarkObservations
from explore_slam.geometry import Pose2
from explore_slam.live.processes import NodeProcess, NodeProcesses, one_machine_environment
from explore_slam.messages import planar_pose, seconds
from explore_slam.nodes.player import Player
from explore_slam.recording import BagReader, BagWriter, Event, TopicKind
from explore_slam.recording.events import odometry_event, start_event, truth_event, write_event
from explore_slam.results.replay_run import replay_bag

DOMAIN = own_domain(88)
START = Pose2(0.5, -0.5, 0.2)


def make_bag(path) -> dict[float, Pose2]:
    """One vehicle on a circle, odometry that drifts, eight landmarks around; return the truth."""
    rng = np.random.default_rng(2)
    angles = np.arange(8) * np.pi / 4
    landmarks = np.column_stack([3 * np.cos(angles), 1 + 3 * np.sin(angles), np.full(8, 0.3)])
    descriptors = np.eye(8, 128, dtype=np.float32)
    truth = {}
    with BagWriter(path) as writer:
        write_event(writer, start_event('robot1', 1.0, START))
        true, odometry = START, Pose2(0, 0, 0)
        for index in range(240):
            stamp = 1.0 + 0.05 * index
            truth[round(stamp, 3)] = true
            write_event(writer, odometry_event('robot1', stamp, odometry))
            write_event(writer, truth_event('robot1', stamp, true))
            if index % 10 == 5:
                apart = landmarks[:, :2] - true[:2]
                c, s = np.cos(true.theta), np.sin(true.theta)
                local = np.column_stack([apart @ [c, s], apart @ [-s, c], landmarks[:, 2]])
                seen = LandmarkObservations(
                    stamp,
                    local + rng.normal(0, 0.01, local.shape),
                    np.repeat(1e-4 * np.eye(3)[None], 8, axis=0),
                    descriptors,
                )
                write_event(writer, Event(stamp, 'robot1', TopicKind.LANDMARKS, seen))
            true = true.compose(Pose2(0.02, 0.0, 0.02))
            odometry = odometry.compose(Pose2(0.022, 0.0, 0.023))
    return truth


def test_live_and_replayed_the_agent_finds_the_same(tmp_path):
    truth = make_bag(tmp_path / 'bag')
    environment = {**one_machine_environment(), 'ROS_DOMAIN_ID': str(DOMAIN)}
    arguments = ['--ros-args', '-p', 'use_sim_time:=true', '-p', 'vehicles:=[robot1]']
    arguments += ['-p', f'start_poses:=[{START.x}, {START.y}, {START.theta}]']
    arguments += ['-p', 'vision:=vehicle', '-p', 'explore:=false', '-p', 'particles:=100']
    poses: list[tuple[float, Pose2]] = []
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=DOMAIN)
    node = rclpy.create_node('listener', context=context)
    node.create_subscription(
        PoseWithCovarianceStamped,
        '/robot1/pose',
        lambda m: poses.append((seconds(m.header.stamp), planar_pose(m.pose.pose))),
        QoSProfile(depth=100),
    )
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    agent = NodeProcess('agent', 'agent_node', arguments)
    with (
        NodeProcesses([agent], tmp_path / 'logs', environment) as processes,
        BagReader(tmp_path / 'bag') as bag,
    ):
        player = Player(bag, rate=2.0, context=context)
        # the agent compiles its kernels before it listens
        deadline = time.monotonic() + 60.0
        while {'/robot1/odom', '/robot1/landmarks'} & set(player.unmatched):
            processes.check()
            assert time.monotonic() < deadline, 'the agent does not listen'
            time.sleep(0.1)
        while not player.done:
            wait = player.step()
            executor.spin_once(timeout_sec=min(wait, 0.02))
        deadline = time.monotonic() + 10.0
        while time.monotonic() < deadline and (not poses or poses[-1][0] < 12.4):
            executor.spin_once(timeout_sec=0.05)
        player.destroy_node()
    executor.shutdown()
    node.destroy_node()
    rclpy.shutdown(context=context)

    assert len(poses) > 20
    errors = [
        np.hypot(pose.x - true.x, pose.y - true.y)
        for stamp, pose in poses
        if (true := truth.get(round(stamp, 3))) is not None
    ]
    assert len(errors) > 20
    assert np.sqrt(np.mean(np.square(errors))) < 0.05
    replayed = replay_bag(tmp_path / 'bag', options={'particles': 100}).metrics['vehicles'][
        'robot1'
    ]
    assert replayed['online']['position_rms'] < 0.05
    assert replayed['odometry']['position_rms'] > 0.15
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(
        replayed['online']['position_rms'], abs=0.02
    )
