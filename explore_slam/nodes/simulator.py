"""Node `simulator`: vehicles in a simulated world with the very topics of real ones.

It publishes simulated time on /clock and the truth on `<vehicle>/ground_truth`; it listens to
`<vehicle>/cmd_vel`, and to `<vehicle>/pose` for how far the agent has come.
"""

import logging
import math
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped, Twist
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock

from explore_slam.errors import ConfigError
from explore_slam.geometry import Pose2
from explore_slam.messages import seconds
from explore_slam.nodes.simulation_pace import Pace, PaceConfig
from explore_slam.nodes.simulator_outputs import Frames, VehicleOutputs, clock_message
from explore_slam.nodes.vehicle_support import (
    OK,
    WARN,
    RosLogHandler,
    changed_settings,
    declare_settings,
    diagnostics_message,
    run_node,
)
from explore_slam.settings import Section, section, setting
from explore_slam.simulation import SimulationConfig, Simulator, World
from explore_slam.simulation.emulators.hardware_bridge import HardwareBridge
from explore_slam.simulation.worlds.world import world_path

REPORT_PERIOD = 1.0  # wall s between diagnostics
CLOCK_REPEAT = 0.02  # wall s after which /clock is said again while time is held
# what may change under way
CHANGEABLE = {field.name for field in fields(PaceConfig)} | {'command_timeout', 'use_sim_time'}


@dataclass(frozen=True)
class SimulatorNodeConfig(Section):
    """All parameters of the simulator node."""

    world: str = setting(
        'office', 'world file, YAML file of a map_server map, or name of a world of the package'
    )
    vehicles: tuple[str, ...] = setting(
        ('robot1', 'robot2'), 'names of the vehicles, which are their namespaces'
    )
    start_poses: tuple[float, ...] = setting(
        (math.nan,),
        'start of each vehicle in the world: x (m), y (m), heading (rad); '
        'a single NaN takes those of the world file',
    )
    seed: int = setting(0, 'seed of all noise', low=0)
    command_timeout: float = setting(
        0.6, 'a vehicle without a velocity command for longer stops', unit='s', low=0.05, high=60.0
    )
    hardware: str = setting(
        '',
        'folder for serial ports <vehicle>_base and <vehicle>_laser of emulated hardware, which '
        "then takes the place of cmd_vel, odom and scan: '' is off; wants real_time_factor 1",
    )
    map_frame: str = setting('map', 'frame of the ground truth')
    odom_frame: str = setting('odom', "frame of odometry, behind the vehicle's name and a slash")
    robot_base_frame: str = setting(
        'base_link', "frame of a vehicle, behind the vehicle's name and a slash"
    )
    pace: PaceConfig = section(PaceConfig)
    simulation: SimulationConfig = section(SimulationConfig)

    def starts(self, world: World) -> dict[str, Pose2]:
        """Return vehicle -> start pose; ConfigError when names and numbers do not fit."""
        names, values = self.vehicles, self.start_poses
        if not names or len(set(names)) != len(names):
            raise ConfigError(f'vehicles is {list(names)}, expected one or more different names')
        if len(values) == 1 and math.isnan(values[0]):
            missing = [name for name in names if name not in world.starts]
            if missing:
                raise ConfigError(
                    f'world {world.name!r} suggests start poses for {list(world.starts)}, not for '
                    f'{missing}: set start_poses'
                )
            return {name: world.starts[name] for name in names}
        if len(values) != 3 * len(names):
            raise ConfigError(
                f'start_poses has {len(values)} numbers, expected {3 * len(names)}: x, y and '
                f'heading of each of {list(names)}'
            )
        rows = [values[3 * i : 3 * i + 3] for i in range(len(names))]
        return {name: Pose2(*map(float, row)) for name, row in zip(names, rows, strict=True)}


class SimulatorNode(Node):
    """Adapter between topics and Simulator; one worker thread owns the simulator and OpenGL."""

    def __init__(self, **options: Any) -> None:
        super().__init__('simulator', **options)
        self._log_handler = RosLogHandler(self)
        logging.getLogger('explore_slam').addHandler(self._log_handler)
        self.config = declare_settings(self, SimulatorNodeConfig())
        self._worker = ThreadPoolExecutor(1, thread_name_prefix='simulator')
        self.simulator: Simulator = self._worker.submit(self._make_simulator).result()
        names = self.simulator.vehicles
        self._hardware: HardwareBridge | None = None
        if self.config.hardware:
            self._hardware = HardwareBridge(Path(self.config.hardware), names, self.config.seed)
            for name, ports in self._hardware.paths.items():
                self.get_logger().info(f'{name}: base at {ports[0]}, laser at {ports[1]}')
        self._wake = threading.Condition()
        self._stopping = False
        self._commands: dict[str, tuple[float, float]] = {}
        self._last_command = dict.fromkeys(names, -math.inf)
        self._pace = Pace(self.config.pace, names, time.monotonic())
        self._time_out = self.create_publisher(Clock, '/clock', QoSProfile(depth=10))
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._outputs = self._make_outputs()
        for name in names:
            if self._hardware is None:
                self.create_subscription(
                    Twist, f'{name}/cmd_vel', partial(self._on_velocity, name), QoSProfile(depth=1)
                )
            self.create_subscription(
                PoseWithCovarianceStamped, f'{name}/pose', partial(self._on_pose, name), 10
            )
        self.add_on_set_parameters_callback(self._on_parameters)
        self._reported = (0.0, time.monotonic())
        self._malformed = 0
        self._run = self._worker.submit(self._work)
        self.create_timer(0.2, self._check_worker)
        self.get_logger().info(
            f'world {self.simulator.world.name}: ' + ', '.join(names) + ' stand at their starts'
        )

    def _make_simulator(self) -> Simulator:
        world = World.load(world_path(self.config.world))
        starts = self.config.starts(world)
        return Simulator(world, starts, self.config.simulation, self.config.seed)

    def _make_outputs(self) -> dict[str, VehicleOutputs]:
        config = self.config
        frames = Frames(config.map_frame, config.odom_frame, config.robot_base_frame)
        outputs = {
            name: VehicleOutputs(self, name, frames, config.simulation)
            for name in self.simulator.vehicles
        }
        for output in outputs.values():
            output.publish_mounts(config.simulation)
        return outputs

    # -- callbacks -------------------------------------------------------------------------------

    def _on_velocity(self, vehicle: str, message: Twist) -> None:
        linear, angular = float(message.linear.x), float(message.angular.z)
        if not (math.isfinite(linear) and math.isfinite(angular)):
            self._malformed += 1
            self.get_logger().warning(
                f'{vehicle}/cmd_vel is ({linear}, {angular}), expected finite m/s and rad/s; '
                'the vehicle stops',
                throttle_duration_sec=5.0,
            )
            linear = angular = 0.0
        with self._wake:
            self._commands[vehicle] = (linear, angular)
            moving = linear != 0.0 or angular != 0.0
            self._pace.report_command(vehicle, moving, self.simulator.time, time.monotonic())
            self._wake.notify()

    def _on_pose(self, vehicle: str, message: PoseWithCovarianceStamped) -> None:
        with self._wake:
            self._pace.report_pose(vehicle, seconds(message.header.stamp), time.monotonic())
            self._wake.notify()

    def _on_parameters(self, parameters: list[Any]) -> Any:
        """Take over what paces time; everything else is set at the start."""
        config, result = changed_settings(self.config, parameters)
        fixed = [item.name for item in parameters if item.name not in CHANGEABLE]
        if fixed:
            result.successful, result.reason = False, f'{", ".join(fixed)}: set at start only'
        elif result.successful:
            with self._wake:
                self.config = config
                self._pace.config = config.pace
                self._wake.notify()
        return result

    def _check_worker(self) -> None:
        """Pass on what ended the worker, if anything did."""
        if self._run.done():
            self._run.result()

    # -- the worker ------------------------------------------------------------------------------

    def _work(self) -> None:
        simulator = self.simulator
        while self._wait_for_turn():
            self._apply_commands()
            for event in simulator.step():
                velocity = simulator.velocity(event.vehicle)
                if self._hardware is None or not self._hardware.take(event, velocity):
                    self._outputs[event.vehicle].publish(event, velocity)
            if self._hardware is not None:
                self._hardware.advance(simulator.time)
            self._time_out.publish(clock_message(simulator.time))
            self._report()

    def _wait_for_turn(self) -> bool:
        """Wait as the pace wants it; return False when the node ends."""
        while not self._stopping:
            with self._wake:
                delay = self._pace.delay(self.simulator.time, time.monotonic())
                if delay <= 0.0:
                    return True
                if self._wake.wait(min(delay, CLOCK_REPEAT)):
                    continue
            # best-effort listeners may have missed the time that all now wait at
            self._time_out.publish(clock_message(self.simulator.time))
            self._report()
        return False

    def _apply_commands(self) -> None:
        if self._hardware is not None:
            for vehicle, command in self._hardware.commands().items():
                self.simulator.set_velocity(vehicle, *command)
            return
        with self._wake:
            commands, self._commands = self._commands, {}
        now = self.simulator.time
        for vehicle, last in self._last_command.items():
            if vehicle in commands:
                self._last_command[vehicle] = now
                self.simulator.set_velocity(vehicle, *commands[vehicle])
            elif now - last > self.config.command_timeout:
                self.simulator.set_velocity(vehicle, 0.0, 0.0)

    def _report(self) -> None:
        sim, wall = self.simulator.time, time.monotonic()
        last_sim, last_wall = self._reported
        if wall - last_wall < REPORT_PERIOD:
            return
        self._reported = (sim, wall)
        factor = (sim - last_sim) / (wall - last_wall)
        values: dict[str, Any] = {
            'time_s': sim,
            'real_time_factor': factor,
            'held_by': self._pace.holder,
            'malformed_messages': self._malformed,
        }
        parts = {'time': (OK, f'{factor:.1f} times real time', values)}
        for vehicle, count in self.simulator.collisions.items():
            text = f'{count} collisions' if count else 'no collision'
            parts[vehicle] = (WARN if count else OK, text, {'collisions': count})
        self._diagnostics.publish(diagnostics_message(self, parts))

    def stop(self) -> None:
        """End the worker and free the renderer."""
        self._stopping = True
        with self._wake:
            self._wake.notify()
        if self._hardware is not None:
            self._hardware.close()
        self._worker.submit(self.simulator.close)
        self._worker.shutdown(wait=True)
        logging.getLogger('explore_slam').removeHandler(self._log_handler)


def main(arguments: list[str] | None = None) -> int:
    """Run the node; the entry point of the executable."""
    return run_node(SimulatorNode, arguments)


if __name__ == '__main__':
    sys.exit(main())
