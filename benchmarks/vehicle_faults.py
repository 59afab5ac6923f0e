"""Time from a fault until the robot is commanded to stop, measured at the emulated robot.

    python benchmarks/vehicle_faults.py --runs 3

Pioneer and LMS-200 are emulated, driver and follower are processes, and this script stands in for
the agent: plan, pose at 5 Hz, heartbeat at 10 Hz. Each fault occurs at 0.4 m/s. Required: 0.3 s
plus one status packet (0.1 s); by the watchdog of the robot where the driver is killed; after a
cable is pulled and plugged in again, data within 3 s.
"""

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import LaserScan

from explore_slam.messages import estimate_message, odometry_record, path_message
from explore_slam.messages.topics import VehicleTopic
from explore_slam.nodes.endpoints import publisher
from explore_slam.nodes.heartbeat import Heartbeat
from explore_slam.nodes.node_support import now_seconds
from explore_slam.nodes.ros_types import MESSAGES
from explore_slam.simulation.emulators.arcos_robot import WATCHDOG
from explore_slam.simulation.emulators.kinematic_body import KinematicBody
from explore_slam.simulation.emulators.vehicle_emulator import VehicleEmulator

PACKET = 0.1  # s between status packets
REQUIRED = 0.3 + PACKET  # s
FAULTS = (
    'silent agent', 'silent laser', 'SIGKILL of the follower', 'SIGTERM of the driver',
    'SIGKILL of the driver', 'SIGINT twice to the driver', 'front bumper', 'cable of the base',
    'cable of the laser',
)  # fmt: skip


class Scene:
    """One vehicle with all its processes on a long straight path."""

    def __init__(self, folder: Path) -> None:
        self.body = KinematicBody()
        self.emulator = VehicleEmulator(folder, 'robot1', self.body, self.body.scan).start()
        self.node = rclpy.create_node('agent_stand_in')
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.received = {'odom': 0, 'scan': 0}
        self.odometry = None
        self.node.create_subscription(Odometry, 'robot1/odom', self._on_odometry, 10)
        self.node.create_subscription(LaserScan, 'robot1/scan', self._on_scan, 10)
        self.plan = publisher(self.node, VehicleTopic.PLAN, 'robot1')
        self.pose = self.node.create_publisher(PoseWithCovarianceStamped, 'robot1/pose', 10)
        self.heartbeat = Heartbeat(self.node, ['robot1'])
        self.poses = self.node.create_timer(0.2, self._send_pose)
        self.spinning = threading.Thread(target=self.executor.spin, daemon=True)
        self.spinning.start()
        ports = {
            'base_port': f'{folder}/robot1_base', 'laser_port': f'{folder}/robot1_laser',
            'enable_camera': 'false', 'motors_at_start': 'true', 'motors_after_reconnect': 'true',
            'odometry_file': f'{folder}/odometry.json',
        }  # fmt: skip
        self.driver = self._start('pioneer_driver', ports)
        self.follower = self._start('path_follower', {})
        path = np.column_stack([np.arange(0.0, 60.0), np.zeros(60)])
        self.plan.publish(path_message(MESSAGES, now_seconds(self.node), 'map', path))

    def _start(self, module: str, parameters: dict[str, str]) -> 'subprocess.Popen[bytes]':
        options = [w for name, value in parameters.items() for w in ('-p', f'{name}:={value}')]
        return subprocess.Popen(
            [sys.executable, '-m', 'explore_slam.nodes.executables', module, '--ros-args', '-r',
             '__ns:=/robot1', '--log-level', 'fatal', *options],
        )  # fmt: skip

    def _on_odometry(self, message: Odometry) -> None:
        self.received['odom'] += 1
        self.odometry = odometry_record(message)

    def _on_scan(self, _: LaserScan) -> None:
        self.received['scan'] += 1

    def _send_pose(self) -> None:
        if self.odometry is not None:
            stamp, pose = self.odometry.stamp, self.odometry.pose
            message = estimate_message(MESSAGES, stamp, 'map', pose, np.eye(3) * 1e-4)
            self.pose.publish(message)

    def wait(self, condition: object, limit: float) -> float:
        """Return the time (s) until a condition holds; inf after the limit."""
        began = time.monotonic()
        while time.monotonic() < began + limit:
            if condition():
                return time.monotonic() - began
            time.sleep(0.002)
        return float('inf')

    def inject(self, fault: str) -> None:
        """Inject a fault."""
        if fault == 'silent agent':
            self.heartbeat.stop()
            self.poses.cancel()
        elif fault == 'silent laser':
            self.emulator.laser_line.faults.silent = True
        elif fault == 'SIGKILL of the follower':
            self.follower.kill()
        elif fault == 'SIGKILL of the driver':
            self.driver.kill()
        elif fault == 'SIGTERM of the driver':
            self.driver.terminate()
        elif fault == 'SIGINT twice to the driver':
            self.driver.send_signal(signal.SIGINT)
            self.driver.send_signal(signal.SIGINT)
        elif fault == 'front bumper':
            self.emulator.robot.faults.front_bumpers = 1
        elif fault == 'cable of the base':
            self.emulator.base_line.unplug()
        else:
            self.emulator.laser_line.unplug()

    def measure(self, fault: str) -> tuple[str, float]:
        """Return the name of the measured time and its value (s)."""
        speed = self.wait(lambda: self.body.velocity()[0] > 0.39, 30.0)
        if speed == float('inf'):
            return 'did not drive', speed
        time.sleep(float(np.random.default_rng().uniform(0.5, 1.0)))
        self.inject(fault)
        if not fault.startswith('cable'):
            return 'stop commanded', self.wait(
                lambda: self.emulator.robot.commanded == (0.0, 0.0), 5.0
            )
        time.sleep(1.5)
        line, topic = (
            (self.emulator.base_line, 'odom')
            if fault.endswith('base')
            else (self.emulator.laser_line, 'scan')
        )
        count = self.received[topic]
        line.plug()
        return f'{topic} again', self.wait(lambda: self.received[topic] > count, 10.0)

    def close(self) -> None:
        """Stop all processes and the emulators."""
        for process in (self.follower, self.driver):
            process.terminate()
        for process in (self.follower, self.driver):
            process.wait(10.0)
        self.emulator.stop()
        self.executor.shutdown()
        self.spinning.join(2.0)
        self.node.destroy_node()


def main() -> int:
    """Run the measurement; return 1 if a requirement is violated."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n', maxsplit=1)[0])
    parser.add_argument('--runs', type=int, default=3)
    arguments = parser.parse_args()
    os.environ.setdefault('ROS_DOMAIN_ID', '75')
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    rclpy.init()
    worst = 0
    for fault in FAULTS:
        values, what = [], ''
        for _ in range(arguments.runs):
            with tempfile.TemporaryDirectory() as folder:
                scene = Scene(Path(folder))
                try:
                    what, value = scene.measure(fault)
                finally:
                    scene.close()
            values.append(value)
        required = 3.0 if fault.startswith('cable') else REQUIRED
        if fault == 'SIGKILL of the driver':
            required = WATCHDOG + PACKET
        worst += max(values) > required
        text = ' '.join(f'{value:.3f}' for value in values)
        print(f'{fault:28} {what}: {text} s (required {required:.1f} s)', flush=True)
    rclpy.try_shutdown()
    return int(worst > 0)


if __name__ == '__main__':
    sys.exit(main())
