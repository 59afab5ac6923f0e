"""What happens in the first hour with a vehicle, measured with emulated hardware.

    python benchmarks/vehicle_first_hour.py --boot 20

Lasers whose power follows their port, devices left at other baud rates, motors that stay off, a
driver that is restarted. No ROS: base and laser as the driver's supervisor uses them.
"""

import argparse
import logging
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

from explore_slam.settings import with_values
from explore_slam.simulation.emulators.arcos_robot import ArcosRobot
from explore_slam.simulation.emulators.kinematic_body import KinematicBody
from explore_slam.simulation.emulators.lms200_scanner import Lms200Scanner
from explore_slam.simulation.emulators.serial_line import SerialLine
from explore_slam.vehicle import DriverConfig, PioneerRobot, Supervisor, make_base, make_laser

LASER_RATES = (9600, 19200, 38400, 500000)  # Bd
ROBOT_RATES = (9600, 19200, 38400, 57600, 115200)  # Bd
LIMIT = 120.0  # s for a first scan


class CountingScanner(Lms200Scanner):
    """An LMS-200 that counts how often its power was switched on."""

    power_cycles = 0

    def set_power(self, on: bool, now: float) -> None:
        """Switch the supply."""
        self.power_cycles += on
        super().set_power(on, now)


def first_scan(scanner: Lms200Scanner, folder: Path, powered: bool) -> tuple[float, str]:
    """Return the time (s) from start to first scan, and what the driver says then."""
    came = threading.Event()
    with SerialLine(scanner, folder / 'laser', powered=powered) as line:
        config = with_values(DriverConfig(), {'laser_port': line.path})
        part = Supervisor('laser', make_laser(config, time.time), lambda _: came.set())
        began = time.monotonic()
        part.start()
        found = came.wait(LIMIT)
        taken = time.monotonic() - began
        part.stop()
    return (taken if found else float('inf')), part.health.message


def boot(folder: Path, seconds: float) -> None:
    """Measure the start of a laser that boots when its port is opened."""
    for name, options in (
        ('power from the port', {}),
        ('the same, answers while it boots', {'answers_while_booting': True}),
    ):
        scanner = CountingScanner(KinematicBody().scan, boot_time=seconds, **options)
        taken, _ = first_scan(scanner, folder, True)
        print(f'{name}, boots for {seconds:.0f} s: first scan after {taken:.1f} s, '
              f'{scanner.power_cycles} power cycles', flush=True)  # fmt: skip


def stuck_rates(folder: Path) -> None:
    """Measure how long devices that were left at other baud rates take to be found."""
    for streaming in (False, True):
        for rate in LASER_RATES:
            scanner = Lms200Scanner(KinematicBody().scan, baud=rate, streaming=streaming)
            taken, text = first_scan(scanner, folder, False)
            state = 'streaming' if streaming else 'silent'
            print(f'laser left at {rate} Bd, {state}: first scan after {taken:.1f} s: {text}',
                  flush=True)  # fmt: skip
    for rate in ROBOT_RATES:
        with SerialLine(ArcosRobot(KinematicBody(), baud=rate), folder / 'base') as line:
            robot = base(line.path, folder)
            began = time.monotonic()
            robot.connect()
            print(f'robot left at {rate} Bd: connected after {time.monotonic() - began:.1f} s')
            robot.close()


def base(port: str, folder: Path) -> PioneerRobot:
    """Return the driver of a base."""
    values = {'base_port': port, 'odometry_file': str(folder / 'odometry.json')}
    made = make_base(with_values(DriverConfig(), values), time.time)
    assert isinstance(made, PioneerRobot)
    return made


def poll(robot: PioneerRobot, until: Callable[[], bool], speed: float = 0.0) -> None:
    """Poll a robot until a condition holds, at most 10 s."""
    end = time.monotonic() + 10.0
    while not until() and time.monotonic() < end:
        robot.set_velocity(speed, 0.0)
        robot.poll(0.02)


def restart(folder: Path) -> None:
    """Compare the odometry before and after a driver was killed in mid-run."""
    device = ArcosRobot(KinematicBody(), baud=115200)
    with SerialLine(device, folder / 'base') as line:
        robot = base(line.path, folder)
        robot.connect()
        robot.enable_motors(True)
        poll(robot, lambda: robot.packets > 0)
        poll(robot, lambda: device.odometry().x > 1.0, 0.5)
        assert robot._port is not None
        robot._port.close()  # as SIGKILL leaves it
        end = time.monotonic() + 5.0
        while device.body.velocity() != (0.0, 0.0) and time.monotonic() < end:
            time.sleep(0.05)
        following = base(line.path, folder)
        following.connect()
        states = []
        while not states:
            states = following.poll(0.1)
        x = states[0].odometry.pose.x
        print(f'driver killed at 0.5 m/s and restarted: odometry says {x:.3f} m, the vehicle is '
              f'at {device.odometry().x:.3f} m')  # fmt: skip
        following.close()


def main() -> int:
    """Run all cases."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n', maxsplit=1)[0])
    parser.add_argument('--boot', type=float, default=20.0, help='s (default 20)')
    arguments = parser.parse_args()
    logging.basicConfig(level=logging.ERROR)
    with tempfile.TemporaryDirectory() as folder:
        boot(Path(folder), arguments.boot)
        stuck_rates(Path(folder))
        restart(Path(folder))
    return 0


if __name__ == '__main__':
    sys.exit(main())
