"""Simulator with emulated hardware, drivers over its ptys: topics as from real vehicles."""

import math
import os
import subprocess
import sys
import time

import numpy as np
import pytest
import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from ros_domain import own_domain
from sensor_msgs.msg import LaserScan

from explore_slam.messages import odometry_record, scan_record, seconds, twist_message
from explore_slam.nodes.ros_types import MESSAGES

DOMAIN = str(own_domain(73))
VEHICLES = ('robot1', 'robot2')


@pytest.fixture
def processes(tmp_path):
    """Start the simulator in hardware mode and a driver for each vehicle."""
    environment = {
        **os.environ, 'ROS_DOMAIN_ID': DOMAIN, 'ROS_PYTHON_CHECK_FIELDS': '1', 'MUJOCO_GL': 'egl',
    }  # fmt: skip
    ports = tmp_path / 'ports'

    def start(module, *arguments):
        node = [sys.executable, '-m', 'explore_slam.nodes.executables', module]
        command = [*node, '--ros-args', *arguments]
        return subprocess.Popen(command, env=environment)

    simulator = start(
        'simulator', '-p', 'world:=small', '-p', f'hardware:={ports}',
        '-p', 'real_time_factor:=1.0', '-p', 'simulated_camera_rate:=0.0',
        '-p', 'simulated_scan_rate:=25.0', '-p', 'simulated_odometry_rate:=50.0',
    )  # fmt: skip
    drivers = [
        start(
            'pioneer_driver', '-r', f'__ns:=/{name}', '-p', f'base_port:={ports}/{name}_base',
            '-p', f'laser_port:={ports}/{name}_laser', '-p', 'enable_camera:=false',
            '-p', 'motors_at_start:=true', '-p', 'use_sim_time:=true',
        )
        for name in VEHICLES
    ]  # fmt: skip
    yield
    for process in (*drivers, simulator):
        process.terminate()
    for process in (*drivers, simulator):
        try:
            process.wait(8.0)
        except subprocess.TimeoutExpired:
            process.kill()


@pytest.mark.usefixtures('processes')
def test_simulated_vehicles_drive_through_serial_protocols():
    pytest.importorskip('mujoco', reason='the simulator needs mujoco')
    context = rclpy.Context()
    context.init(domain_id=int(DOMAIN))
    node = rclpy.create_node('observer', context=context)
    executor = rclpy.executors.SingleThreadedExecutor(context=context)
    executor.add_node(node)
    got = {}
    for name in VEHICLES:
        for topic, kind in (('odom', Odometry), ('scan', LaserScan), ('ground_truth', Odometry)):
            got[name, topic] = []
            node.create_subscription(kind, f'/{name}/{topic}', got[name, topic].append, 10)
    outputs = {name: node.create_publisher(Twist, f'/{name}/cmd_vel', 1) for name in VEHICLES}
    end, sent = time.monotonic() + 90.0, 0.0
    start = {}

    def moved(name):
        pose = odometry_record(got[name, 'ground_truth'][-1]).pose
        return start[name].between(pose)

    while time.monotonic() < end:
        executor.spin_once(timeout_sec=0.02)
        if not all(got.values()):
            continue
        start = start or {
            name: odometry_record(got[name, 'ground_truth'][0]).pose for name in VEHICLES
        }
        if time.monotonic() - sent > 0.05:
            sent = time.monotonic()
            for name, output in outputs.items():
                output.publish(twist_message(MESSAGES, 0.0, 0.4 if name == 'robot1' else -0.4))
        if moved('robot1').theta > 1.0 and moved('robot2').theta < -1.0:
            break
    assert moved('robot1').theta > 1.0
    assert moved('robot2').theta < -1.0
    for name in VEHICLES:
        truth = {round(seconds(m.header.stamp), 2): m for m in got[name, 'ground_truth']}
        readings = [odometry_record(m) for m in got[name, 'odom']]
        assert len(readings) > 20
        for reading in readings[-10:]:
            nearest = min(truth, key=lambda stamp, at=reading.stamp: abs(stamp - at))
            pose = start[name].between(odometry_record(truth[nearest]).pose)
            error = math.remainder(reading.pose.theta - pose.theta, math.tau)
            assert abs(error) < 0.12  # odometry noise, and 0.4 rad/s times the error of the stamp
        ranges = np.asarray(scan_record(got[name, 'scan'][-1]).ranges)
        assert np.isfinite(ranges).mean() > 0.5
    node.destroy_node()
    context.try_shutdown()
