"""Hardware driver on emulated devices: latency from last serial byte to topic, losses, CPU load.

    python benchmarks/vehicle_driver.py --seconds 600

An emulated Pioneer at 9600 Bd (status at 10 Hz) and an emulated LMS-200 streaming at 38400 Bd run
in a process of their own, the driver in another; this one subscribes. Times are those of
CLOCK_MONOTONIC, which all processes share.
"""

import argparse
import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import LaserScan

from explore_slam.messages import odometry_record, twist_message
from explore_slam.nodes.ros_types import MESSAGES
from explore_slam.simulation.emulators.kinematic_body import KinematicBody
from explore_slam.simulation.emulators.vehicle_emulator import VehicleEmulator
from explore_slam.vehicle.arcos_packets import PacketDecoder
from explore_slam.vehicle.arcos_status import parse_status
from explore_slam.vehicle.lms200_scan import parse_scan, scan_ranges
from explore_slam.vehicle.lms200_telegrams import Reply, TelegramDecoder

Event = tuple[float, tuple[int, ...]]  # time (monotonic, s), content that identifies it
SETTLE = 3.0  # s before and after the measured window


def emulate(folder: str, pipe: Connection) -> None:
    """Emulate both devices; at the end send the times of all status packets and scans."""
    body = KinematicBody()
    body.obstacles = [(4.0, 0.0, 0.7), (-3.0, 3.0, 0.5), (0.0, -4.0, 1.0), (-3.0, -1.0, 0.4)]
    sent: dict[str, list[Event]] = {'odom': [], 'scan': []}
    packets, telegrams = PacketDecoder(), TelegramDecoder()

    def on_base(when: float, data: bytes) -> None:
        for payload in packets.feed(data):
            if (status := parse_status(payload)) is not None:
                sent['odom'].append((when, (status.x, status.y, status.heading)))

    def on_laser(when: float, data: bytes) -> None:
        for telegram in telegrams.feed(data):
            scan = parse_scan(telegram.data) if telegram.command == Reply.SCAN else None
            if scan is not None:
                sent['scan'].append((when, identity(scan_ranges(scan, 14))))

    emulator = VehicleEmulator(Path(folder), 'robot1', body, body.scan)
    emulator.base_line.on_sent, emulator.laser_line.on_sent = on_base, on_laser
    with emulator:
        pipe.send('ready')
        pipe.recv()
    pipe.send(sent)


def cpu_seconds(process: int) -> float:
    """Return the CPU time (s) of a process."""
    fields = Path(f'/proc/{process}/stat').read_text().rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')


def identity(ranges: np.ndarray) -> tuple[int, ...]:
    """Return the ranges (mm) as identity of a scan, unique while the vehicle drives."""
    finite = np.where(np.isfinite(ranges), ranges, 0.0)
    return tuple(np.rint(1000.0 * finite).astype(int).tolist())


def on_odometry(got: list[Event], message: Odometry) -> None:
    """Record the arrival of a message and its counters (1 mm, 15 bits)."""
    now, pose = time.monotonic(), odometry_record(message).pose
    x, y = (round(1000.0 * value) & 0x7FFF for value in pose[:2])
    got.append((now, (x, y, round(pose.theta / (np.pi / 2048)))))


def on_scan(got: list[Event], message: LaserScan) -> None:
    """Record the arrival of a message and its ranges."""
    now = time.monotonic()
    got.append((now, identity(np.asarray(message.ranges))))


def match(sent: list[Event], came: list[Event]) -> tuple[list[float], int]:
    """Return latencies (s) of received events, in order, and the number of lost ones."""
    delays, missing, at = [], 0, 0
    for when, what in sent:
        window = range(at, min(at + 10, len(came)))
        found = next((i for i in window if came[i][1] == what and came[i][0] >= when), None)
        if found is None:
            missing += 1
        else:
            delays.append(came[found][0] - when)
            at = found + 1
    return delays, missing


def measure(
    folder: str, seconds: float
) -> tuple[dict[str, list[Event]], float, tuple[float, float]]:
    """Return messages by topic, CPU load of the driver, and the measured window."""
    arguments = {
        'base_port': f'{folder}/robot1_base', 'laser_port': f'{folder}/robot1_laser',
        'enable_camera': 'false', 'motors_at_start': 'true',
    }  # fmt: skip
    options = [word for name, value in arguments.items() for word in ('-p', f'{name}:={value}')]
    driver = subprocess.Popen(
        [sys.executable, '-m', 'explore_slam.nodes.executables', 'pioneer_driver', '--ros-args',
         *options, '-r', '__ns:=/robot1', '--log-level', 'warn'],
    )  # fmt: skip
    rclpy.init()
    node = rclpy.create_node('observer', namespace='/robot1')
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    got: dict[str, list[Event]] = {'odom': [], 'scan': []}
    node.create_subscription(Odometry, 'odom', partial(on_odometry, got['odom']), 50)
    node.create_subscription(LaserScan, 'scan', partial(on_scan, got['scan']), 50)
    velocity = node.create_publisher(Twist, 'cmd_vel', 1)
    node.create_timer(0.05, lambda: velocity.publish(twist_message(MESSAGES, 0.3, 0.3)))
    while not all(got.values()):
        executor.spin_once(timeout_sec=0.1)
    start = time.monotonic() + SETTLE
    end = start + seconds
    cpu = None
    while time.monotonic() < end + SETTLE:
        executor.spin_once(timeout_sec=0.1)
        if cpu is None and time.monotonic() >= start:
            cpu = cpu_seconds(driver.pid)
    share = (cpu_seconds(driver.pid) - cpu) / (seconds + SETTLE)
    driver.terminate()
    driver.wait(10.0)
    node.destroy_node()
    rclpy.try_shutdown()
    return got, share, (start, end)


def main() -> int:
    """Run the measurement; return 1 if a message was lost."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n', maxsplit=1)[0])
    parser.add_argument('--seconds', type=float, default=60.0)
    arguments = parser.parse_args()
    os.environ.setdefault('ROS_DOMAIN_ID', '74')
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    with tempfile.TemporaryDirectory() as folder:
        here, there = multiprocessing.get_context('spawn').Pipe()
        emulator = multiprocessing.get_context('spawn').Process(
            target=emulate, args=(folder, there)
        )
        emulator.start()
        here.recv()
        got, share, (start, end) = measure(folder, arguments.seconds)
        here.send('end')
        sent = here.recv()
        emulator.join()
    print(f'{arguments.seconds:.0f} s on {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}')
    lost = 0
    for name in got:
        # What was sent in the window must arrive, perhaps after its end.
        inside = [event for event in sent[name] if start <= event[0] < end]
        came = [event for event in got[name] if event[0] >= start]
        found, missing = match(inside, came)
        lost += missing
        delays = 1e3 * np.array(found)
        print(
            f'{name}: {len(inside)} sent, {missing} lost; last byte to topic: median '
            f'{np.median(delays):.1f} ms, p99 {np.percentile(delays, 99):.1f} ms, '
            f'largest {delays.max():.1f} ms'
        )
    print(f'CPU load of the driver: {100.0 * share:.1f} % of one core')
    return 0 if lost == 0 else 1


if __name__ == '__main__':
    sys.exit(main())
