"""Node `simulator`: vehicles in a simulated world with the topics of real ones.

It publishes simulated time on /clock and true poses on `<vehicle>/ground_truth`. It subscribes to
`<vehicle>/cmd_vel`, and to `<vehicle>/pose` to pace simulated time by the progress of the agent.
"""

import logging
import math
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.node import Node

from explore_slam.errors import ConfigError
from explore_slam.geometry import Pose2
from explore_slam.messages import seconds
from explore_slam.messages.frames import FrameNames
from explore_slam.messages.topics import GlobalTopic, VehicleTopic
from explore_slam.nodes import shared_parameters
from explore_slam.nodes.endpoints import publisher, subscribe
from explore_slam.nodes.node_support import (
    OK,
    REPORT_PERIOD,
    WARN,
    WARNING_PERIOD,
    RosLogHandler,
    changed_settings,
    declare_settings,
    diagnostics_message,
    run_node,
    warn_of_unknown_parameters,
)
from explore_slam.nodes.simulation_pace import Pace, PaceConfig
from explore_slam.nodes.simulator_outputs import VehicleOutputs, clock_message
from explore_slam.nodes.velocity_topic import VelocityInput
from explore_slam.settings import Section, section, setting
from explore_slam.simulation import (
    SimulationConfig,
    Simulator,
    World,
    load_world,
    world_path,
)
from explore_slam.simulation.emulators.hardware_bridge import HardwareBridge

_CLOSE_TIMEOUT = 10.0  # s for a step of the simulation and the release of the renderer
CLOCK_REPEAT = 0.02  # wall s after which /clock is repeated while time is held
# settings that may change at run time
CHANGEABLE = {field.name for field in fields(PaceConfig)} | {
    'simulated_command_timeout',
    'use_sim_time',
}


@dataclass(frozen=True)
class SimulatorNodeConfig(Section):
    """All parameters of the simulator node."""

    world: str = setting(
        'office',
        'World file, YAML file of a map_server map, or name of a world of the package',
        tier='basic',
    )
    vehicles: tuple[str, ...] = shared_parameters.vehicles()
    spawn_poses: tuple[float, ...] = setting(
        (math.nan,),
        'Where each vehicle is at first in the world: x (m), y (m), heading (rad); '
        'a single NaN selects those of the world file',
        tier='basic',
    )
    seed: int = setting(0, 'Seed of all noise', low=0)
    simulated_command_timeout: float = setting(
        0.6,
        'Simulated time without a velocity command after which a vehicle stops; like '
        'command_timeout of the driver of a real vehicle',
        unit='s',
        low=0.05,
        high=60.0,
    )
    hardware: str = setting(
        '',
        'Folder for serial ports <vehicle>_base and <vehicle>_laser of emulated hardware, which '
        'then replaces cmd_vel, odom and scan; empty: none; requires real_time_factor 1',
    )
    laser_boot_time: float = setting(
        0.0,
        'Time for which the lasers of the emulated hardware boot, whose power their serial port '
        'switches as on many Pioneers; 0: they have power all the time',
        unit='s',
        low=0.0,
        high=600.0,
    )
    map_frame: str = shared_parameters.map_frame()
    odom_frame: str = shared_parameters.odom_frame()
    robot_base_frame: str = shared_parameters.robot_base_frame()
    pace: PaceConfig = section(PaceConfig)
    simulation: SimulationConfig = section(SimulationConfig)

    def starts(self, world: World) -> dict[str, Pose2]:
        """Return vehicle -> start pose; ConfigError when names and numbers do not fit."""
        names, values = self.vehicles, self.spawn_poses
        shared_parameters.check_names(names)
        if len(values) == 1 and math.isnan(values[0]):
            missing = [name for name in names if name not in world.starts]
            if missing:
                raise ConfigError(
                    f'world {world.name!r} suggests start poses for {list(world.starts)}, not for '
                    f'{missing}: set spawn_poses'
                )
            return {name: world.starts[name] for name in names}
        poses = shared_parameters.start_poses(names, values, 'spawn_poses')
        known = {name: pose for name, pose in poses.items() if pose is not None}
        if len(known) < len(poses):
            raise ConfigError(f'spawn_poses has nan for {sorted(set(poses) - set(known))}')
        return known

    def frames(self, vehicle: str) -> FrameNames:
        """Return the frames of a vehicle."""
        return FrameNames(vehicle, self.map_frame, self.odom_frame, self.robot_base_frame)


class SimulatorNode(Node):
    """Adapter between topics and Simulator; one worker thread owns the simulator and OpenGL."""

    def __init__(self, **options: Any) -> None:
        super().__init__('simulator', **options)
        self._log_handler = RosLogHandler(self)
        logging.getLogger('explore_slam').addHandler(self._log_handler)
        self.config = declare_settings(self, SimulatorNodeConfig())
        warn_of_unknown_parameters(self)
        self._worker = ThreadPoolExecutor(1, thread_name_prefix='simulator')
        self._hardware: HardwareBridge | None = None
        self._inputs: VelocityInput | None = None
        self._wake = threading.Condition()
        self._stopping = False
        self.simulator: Simulator = self._worker.submit(self._make_simulator).result()
        try:
            self._connect()
        except BaseException:  # the renderer must be released by the thread that has made it
            self.stop()
            raise

    def _connect(self) -> None:
        """Offer the topics of the vehicles, and begin to simulate."""
        names = self.simulator.vehicles
        if self.config.hardware:
            self._hardware = HardwareBridge(
                Path(self.config.hardware), names, self.config.seed, self.config.laser_boot_time
            )
            for name, ports in self._hardware.paths.items():
                self.get_logger().info(f'{name}: base at {ports[0]}, laser at {ports[1]}')
        self._commands: dict[str, tuple[float, float]] = {}
        self._last_command = dict.fromkeys(names, -math.inf)
        self._pace = Pace(self.config.pace, names, time.monotonic())
        self._clock_output = publisher(self, GlobalTopic.CLOCK)
        self._diagnostics = publisher(self, GlobalTopic.DIAGNOSTICS)
        self._outputs = self._make_outputs()
        if self._hardware is None:
            takers = {name: partial(self._on_velocity, name) for name in names}
            self._inputs = VelocityInput(self, takers)
        for name in names:
            subscribe(self, VehicleTopic.POSE, partial(self._on_pose, name), name)
        self.add_on_set_parameters_callback(self._on_parameters)
        self._reported = (0.0, time.monotonic())
        self._malformed = 0
        self._run = self._worker.submit(self._work)
        self.create_timer(0.2, self._check_worker)
        self.get_logger().info(
            f'world {self.simulator.world.name}: ' + ', '.join(names) + ' are at their start poses'
        )

    def _make_simulator(self) -> Simulator:
        world = load_world(world_path(self.config.world))
        starts = self.config.starts(world)
        return Simulator(world, starts, self.config.simulation, self.config.seed)

    def _make_outputs(self) -> dict[str, VehicleOutputs]:
        config = self.config
        outputs = {
            name: VehicleOutputs(self, config.frames(name)) for name in self.simulator.vehicles
        }
        for output in outputs.values():
            output.publish_mounts(config.simulation)
        return outputs

    # -- callbacks -------------------------------------------------------------------------------

    def _on_velocity(self, vehicle: str, linear: float, angular: float) -> None:
        if not (math.isfinite(linear) and math.isfinite(angular)):
            self._malformed += 1
            self.get_logger().warning(
                f'{vehicle}/cmd_vel is ({linear}, {angular}), expected finite m/s and rad/s; '
                'the vehicle stops',
                throttle_duration_sec=WARNING_PERIOD,
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
        """Apply the settings of the pace; all others are fixed after the start."""
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
        """Raise the exception that ended the worker, if any."""
        if self._run.done():
            self._run.result()

    # -- the worker ------------------------------------------------------------------------------

    def _work(self) -> None:
        simulator = self.simulator
        while self._wait_for_turn():
            self._apply_commands()
            for event in simulator.step():
                velocity = simulator.velocity(event.vehicle)
                if self._hardware is None or not self._hardware.forward(event, velocity):
                    self._outputs[event.vehicle].publish(event, velocity)
            if self._hardware is not None:
                self._hardware.advance(simulator.time)
            self._clock_output.publish(clock_message(simulator.time))
            self._report()

    def _wait_for_turn(self) -> bool:
        """Wait as long as the pace demands; return False when the node ends."""
        while not self._stopping:
            with self._wake:
                delay = self._pace.delay(self.simulator.time, time.monotonic())
                if delay <= 0.0:
                    return True
                if self._wake.wait(min(delay, CLOCK_REPEAT)):
                    continue
            # best-effort subscribers may have missed the time at which all now wait
            self._clock_output.publish(clock_message(self.simulator.time))
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
            elif now - last > self.config.simulated_command_timeout:
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
        """End the worker and release the renderer."""
        self._stopping = True
        if self._inputs is not None:
            self._inputs.close()
            self._inputs = None
        with self._wake:
            self._wake.notify()
        if self._hardware is not None:
            self._hardware.close()
        closed = self._worker.submit(self.simulator.close)
        self._worker.shutdown(wait=False)
        try:
            closed.result(timeout=_CLOSE_TIMEOUT)
        except TimeoutError:
            self.get_logger().error(
                f'the simulation has not ended within {_CLOSE_TIMEOUT:.0f} s of the request'
            )
        logging.getLogger('explore_slam').removeHandler(self._log_handler)


def main(arguments: list[str] | None = None) -> int:
    """Run the node; the entry point of the executable."""
    return run_node(SimulatorNode, arguments)
