"""A live exploration: simulator, drivers and agent as processes, monitored until it is complete.

The run folder is written from the topics alone, as it would be with real vehicles.
"""

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
import yaml
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from explore_slam.errors import ConfigError, ExploreSlamError
from explore_slam.exploration import paths_of
from explore_slam.files import write_text
from explore_slam.geometry import Pose2
from explore_slam.live.processes import (
    NodeProcess,
    NodeProcesses,
    config_folder,
    interrupts_held,
    use_one_machine,
)
from explore_slam.live.run_monitor import RunMonitor, RunState
from explore_slam.mapping import OccupancyGrid
from explore_slam.messages.sweep_status import SWEEP_KEY
from explore_slam.nodes.agent_parameters import AgentNodeConfig
from explore_slam.results.reachable_area import ReachableArea
from explore_slam.results.run_data import RunData, RunRecorder
from explore_slam.results.run_folder import RunFolder
from explore_slam.settings import load_settings, save_settings, values_of, with_values
from explore_slam.simulation import SimulationConfig, load_world, world_path
from explore_slam.slam import OdometryCalibration

ENDS = ('exploration_complete', 'exploration_incomplete', 'returned_to_origin')
SETTLE = 3.0  # wall s to wait for the last results
# diagnostics of the agent that become metrics
AGENT_METRICS = (
    'ros_latency_median_s', 'ros_latency_p95_s', 'wall_latency_median_s', 'wall_latency_p95_s',
    'frame_mean_ms', 'plan_mean_ms', 'frame_count',
)  # fmt: skip
# Hz; emulated devices send the newest record at rates of their own, so it must be renewed often
HARDWARE_RATES = {'simulated_scan_rate': 25.0, 'simulated_odometry_rate': 50.0}
SIM_TIME = {'use_sim_time': True}
FOLLOWER = 'path_follower'  # module of the node that moves a vehicle
START_LIMIT = 240.0  # wall s within which the agent must publish its first pose


@dataclass(frozen=True)
class LiveRunOptions:
    """Options of a live run; settings are agent parameters by name."""

    world: str = 'office'
    vehicles: int = 2
    seed: int = 0
    settings: Mapping[str, Any] = field(default_factory=dict)
    vision: str = 'agent'
    hardware: bool = False
    record: bool = False
    real_time_factor: float = 0.0
    laser_boot_time: float = 0.0  # s; 0: the emulated lasers have power all the time
    wall_time_limit: float = 900.0  # s


class LiveRun:
    """Starts the processes, yields the state to the caller, and writes the run folder."""

    def __init__(self, options: LiveRunOptions, runs: Path) -> None:
        self.options = options
        self.world = load_world(world_path(options.world))
        self.starts = self._starts()
        self.config = self._config()
        paths = self.config.agent.exploration.paths
        radius = paths_of(paths, self.config.team.body.record).planning_radius
        path = world_path(options.world)
        self.area = ReachableArea.of_file(path, self.starts.values(), radius)
        title = f'Live exploration of {self.world.name}, {options.vehicles} vehicles'
        self.recorder = RunRecorder(title, self.starts, self.config.agent.slam.particles)
        self.folder = RunFolder.create(runs)
        self.monitor: RunMonitor | None = None
        self.complete = False
        self._last_status = ''  # at the end of the run: the agent goes on until it is stopped

    def _starts(self) -> dict[str, Pose2]:
        known = dict(self.world.starts)
        count = self.options.vehicles
        if not 1 <= count <= len(known):
            raise ConfigError(
                f'vehicles is {count}, expected 1 to {len(known)}: '
                f'world {self.world.name!r} has that many start poses'
            )
        return dict(list(known.items())[:count])

    def _config(self) -> AgentNodeConfig:
        base = load_settings(AgentNodeConfig(), config_folder() / 'agent.yaml')
        values = {
            'vehicles': list(self.starts),
            'start_poses': [float(v) for pose in self.starts.values() for v in pose],
            **values_of(SimulationConfig().laser_mount),  # where there is no tf2_msgs
            'seed': self.options.seed,
            'vision': self.options.vision,
            **self.options.settings,
        }
        return with_values(base, values)

    # -- processes -------------------------------------------------------------------------------

    def nodes(self) -> list[NodeProcess]:
        """Return all nodes of the run."""
        directory = self.folder.path
        agent_file = directory / 'agent.yaml'
        save_settings(with_values(self.config, {'run_directory': str(directory)}), agent_file)
        nodes = [
            NodeProcess('simulator', 'simulator', self._simulator_arguments()),
            NodeProcess('agent', 'agent_node', _parameters(agent_file, SIM_TIME)),
        ]
        for name in self.starts:
            nodes += self._driver(name)
        if self.options.record:
            bag = str(directory / 'bag')
            arguments = [bag, '--sim-time', '--vehicles', *self.starts]
            nodes.append(NodeProcess('recorder', 'recorder', arguments))
        return nodes

    def _simulator_arguments(self) -> list[str]:
        values: dict[str, Any] = {
            'world': str(world_path(self.options.world).resolve()),
            'vehicles': list(self.starts),
            'spawn_poses': [float(v) for pose in self.starts.values() for v in pose],
            'seed': self.options.seed,
            'real_time_factor': self.options.real_time_factor,
        }
        if self.options.hardware:
            values.update(hardware=str(self._ports()), real_time_factor=1.0, **HARDWARE_RATES)
            values['laser_boot_time'] = self.options.laser_boot_time
        return _parameters(self._write('simulator', values), {})

    def _ports(self) -> Path:
        return self.folder.path / 'ports'

    def _write(self, name: str, values: dict[str, Any]) -> Path:
        path = self.folder.path / f'{name}.yaml'
        write_text(path, yaml.safe_dump({'/**': {'ros__parameters': values}}))
        return path

    def _driver(self, name: str) -> list[NodeProcess]:
        """Return the processes of one vehicle."""
        mount = values_of(SimulationConfig().laser_mount)
        told = {**SIM_TIME, **values_of(self.config.team.body), **mount}
        follower = _parameters(None, told, name)
        nodes = [NodeProcess(f'{name}_follower', FOLLOWER, follower)]
        if self.options.vision == 'vehicle':
            vision_file = self.folder.path / 'vision.yaml'
            save_settings(self.config.agent.vision, vision_file)
            arguments = _parameters(vision_file, SIM_TIME, name)
            nodes.append(NodeProcess(f'{name}_features', 'feature_extractor', arguments))
        if self.options.hardware:
            ports = {
                'base_port': f'{self._ports()}/{name}_base',
                'laser_port': f'{self._ports()}/{name}_laser',
                'enable_camera': False,
                'motors_at_start': True,
                'odometry_file': f'{self._ports()}/{name}_odometry.json',
                **mount,
                **SIM_TIME,
            }
            driver = _parameters(self._write(f'{name}_driver', ports), {}, name)
            nodes.append(NodeProcess(f'{name}_driver', 'pioneer_driver', driver))
        return nodes

    # -- the run ---------------------------------------------------------------------------------

    def run(self) -> Iterator[RunState]:
        """Run to the end; yield the state ten times a second. Always end all processes."""
        environment = use_one_machine(self.folder.path / 'logs' / 'ros')
        nodes = self.nodes()
        # a recording must begin before the vehicles move: they do once their followers run
        last = [node for node in nodes if self.options.record and node.module == FOLLOWER]
        first = [node for node in nodes if node not in last]
        processes = NodeProcesses(first, self.folder.path / 'logs', environment)
        with processes, self._monitor() as monitor:
            executor = SingleThreadedExecutor()
            executor.add_node(monitor)
            began = time.monotonic()
            try:
                if self.options.record:
                    self._await_recorder(executor, monitor, processes, began)
                processes.start(last)
                yield from self._follow(executor, monitor, processes, began)
                self._settle(executor, monitor)
            finally:
                executor.remove_node(monitor)

    @contextmanager
    def _monitor(self) -> Iterator[RunMonitor]:
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        try:
            self.monitor = RunMonitor(self.starts, self.recorder, self.area, self.config.map_frame)
            yield self.monitor
            self.monitor.destroy_node()
        finally:
            rclpy.try_shutdown()

    def _await_recorder(
        self,
        executor: SingleThreadedExecutor,
        monitor: RunMonitor,
        processes: NodeProcesses,
        began: float,
    ) -> None:
        """Spin until the recorder has subscribed to the topics of all vehicles."""
        while not monitor.is_recorded():
            with interrupts_held():
                executor.spin_once(timeout_sec=0.1)
            processes.check()
            if time.monotonic() - began > START_LIMIT:
                raise ExploreSlamError(
                    f'the recorder has not subscribed to all topics after {START_LIMIT:.0f} s; '
                    f'see {self.folder.path}/logs'
                )

    def _follow(
        self,
        executor: SingleThreadedExecutor,
        monitor: RunMonitor,
        processes: NodeProcesses,
        began: float,
    ) -> Iterator[RunState]:
        while True:
            until = time.monotonic() + 0.1
            while time.monotonic() < until:
                with interrupts_held():
                    executor.spin_once(timeout_sec=0.05)
            processes.check()
            yield monitor.state
            if monitor.state.status in ENDS:
                self.complete = True
                self._last_status = monitor.state.status
                return
            elapsed = time.monotonic() - began
            if elapsed > START_LIMIT and not monitor.state.poses:
                raise ExploreSlamError(
                    f'no pose from the agent after {elapsed:.0f} s; see {self.folder.path}/logs'
                )
            if elapsed > self.options.wall_time_limit:
                self.recorder.add_note(
                    f'The run was ended at its time limit of {self.options.wall_time_limit:.0f} s.'
                )
                return

    def _settle(self, executor: SingleThreadedExecutor, monitor: RunMonitor) -> None:
        """Have the map saved, and wait for the last map, landmarks and trajectories."""
        answer = monitor.ask_for_map()
        end = time.monotonic() + SETTLE
        while time.monotonic() < end and not (
            answer.done() and time.monotonic() > end - SETTLE / 2
        ):
            with interrupts_held():
                executor.spin_once(timeout_sec=0.1)

    @property
    def has_results(self) -> bool:
        """Whether the agent has published a pose, so that there is something to write."""
        return self.monitor is not None and bool(self.monitor.state.poses)

    # -- results ---------------------------------------------------------------------------------

    def finish(self) -> RunData:
        """Write the run folder and return its data."""
        state = RunState() if self.monitor is None else self.monitor.state
        grid = None
        if state.grid is not None and state.grid[0].size:  # the first map may have no cells
            cells, resolution, origin = state.grid
            config = with_values(self.config.agent.mapping, {'resolution': round(resolution, 6)})
            probability = np.where(cells >= 0, cells / 100.0, 0.5)
            grid = OccupancyGrid.from_probability(probability, cells >= 0, origin, config)
        extra = self._extra(state)
        left_out = extra['area_left_out']
        if left_out > 0.0:
            self.recorder.add_note(
                f'The operator has left out {left_out:.1f} m² of the reachable area; the explored '
                'part is that of the rest.'
            )
        data = self.recorder.finish(
            state.trajectories,
            calibrations={
                name: OdometryCalibration(**found)
                for name, found in extra['odometry_calibration'].items()
                if found
            },
            grid=grid,
            landmarks=state.landmarks,
            settings=self.config,
            extra=extra,
        )
        self.folder.write_run(data)
        return data

    def _extra(self, state: RunState) -> dict[str, Any]:
        _, agent = self._values('agent: agent')
        _, clock = self._values('simulator: time')
        collisions = {
            name: int(self._values(f'simulator: {name}')[1].get('collisions', 0))
            for name in self.starts
        }
        left_out = 0.0 if self.monitor is None else self.monitor.area_left_out
        health = {name: self._values(f'agent: vehicle {name}')[1] for name in self.starts}
        return {
            'status': self._last_status or state.status or 'not started',
            'complete': self.complete,
            'duration': state.stamp,
            'unreached_frontiers': int(agent.get('unreached_frontiers', 0)),
            'unreached_m2': float(agent.get('unreached_m2', 0.0)),
            'area_left_out': left_out,
            'real_time_factor': float(clock.get('real_time_factor', 'nan')),
            'collisions': collisions,
            'agent': {name: float(agent[name]) for name in AGENT_METRICS if name in agent},
            'odometry_calibration': {
                name: {
                    key: float(found[f'odometry_{key}'])
                    for key in OdometryCalibration._fields
                    if f'odometry_{key}' in found
                }
                for name, found in health.items()
            },
            'sweeps': {
                name: {
                    key.removeprefix(SWEEP_KEY): value
                    for key, value in found.items()
                    if key.startswith(SWEEP_KEY)
                }
                for name, found in health.items()
            },
            'dropped_frames': {
                name: int(found.get('dropped_frames', 0)) for name, found in health.items()
            },
        }

    def _values(self, name: str) -> tuple[str, dict[str, str]]:
        return ('', {}) if self.monitor is None else self.monitor.values(name)


def _parameters(path: Path | None, values: Mapping[str, Any], namespace: str = '') -> list[str]:
    arguments = ['--ros-args']
    if path is not None:
        arguments += ['--params-file', str(path)]
    for name, value in values.items():
        arguments += ['-p', f'{name}:={str(value).lower() if isinstance(value, bool) else value}']
    if namespace:
        arguments += ['-r', f'__ns:=/{namespace}']
    return arguments
