"""The agent on topics while its node is configured: filter, map and planner, and their worker.

Callbacks convert and enqueue; one worker thread owns the agent and does everything slow.
"""

import threading
import time
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from nav_msgs.srv import GetMap
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.task import Future
from rclpy.timer import Timer
from std_msgs.msg import Bool
from std_srvs.srv import SetBool, Trigger

from explore_slam.agent import Agent, TeamPlanner, explicit_mounts
from explore_slam.data import BatteryReading, FollowerReport, OdometryReading
from explore_slam.errors import DataError, ExploreSlamError
from explore_slam.exploration import PlanningMode
from explore_slam.geometry import Pose2
from explore_slam.messages.clocks import NamedProblems, StampProblem
from explore_slam.messages.frame_pairing import FRAME
from explore_slam.messages.imu import IMU
from explore_slam.messages.odometry import ODOMETRY
from explore_slam.messages.sensor_mounts import SensorMounts, shared_frames
from explore_slam.messages.sweep_status import SWEEP_KEY, named_sweeps
from explore_slam.messages.topics import (
    GlobalTopic,
    TeamTopic,
    Topic,
    TopicKind,
    VehicleTopic,
)
from explore_slam.messages.vehicle_settings import VehicleConfig
from explore_slam.nodes.agent_inputs import (
    LIMITS,
    OperatorPose,
    PlannerSink,
    VehicleInputs,
    operator_polygon,
)
from explore_slam.nodes.agent_outputs import AgentOutputs
from explore_slam.nodes.agent_parameters import AgentNodeConfig
from explore_slam.nodes.agent_statistics import AgentStatistics, explain_delay
from explore_slam.nodes.endpoints import LatchedOrNotSubscription, publisher, subscribe
from explore_slam.nodes.heartbeat import Heartbeat
from explore_slam.nodes.inbox import Inbox, Item
from explore_slam.nodes.map_outputs import map_message
from explore_slam.nodes.node_support import (
    REPORT_PERIOD,
    SILENCE,
    diagnostics_message,
    now_seconds,
)
from explore_slam.nodes.plan_outputs import PlanOutputs
from explore_slam.nodes.transform_listener import TransformListener
from explore_slam.sweeps import Sweep

POLL_PERIOD = 0.05  # s that the worker waits for an item before it does periodic work
_RELEASE_PERIOD = 0.2  # s between looks at messages that wait for transforms
_BEHIND_PERIOD = 10.0  # s between warnings that the agent is behind
_JOIN_TIMEOUT = 5.0  # s for the worker to finish what it does
_PROMPT = ('navigator', 'battery')  # kinds that do not wait for measurements
_PERIODIC = ('plan', 'map', 'map update', 'landmarks')


class AgentSession:
    """The configured agent. Inactive, it answers services, and neither measures nor publishes."""

    def __init__(
        self, node: Node, config: AgentNodeConfig, vehicle_configs: Mapping[str, VehicleConfig]
    ) -> None:
        self._node = node
        self.config = config
        self._vehicle_configs = dict(vehicle_configs)
        bodies = {name: one.view.of(one.body.record) for name, one in vehicle_configs.items()}
        sources = {name: one.odometry for name, one in vehicle_configs.items()}
        seeing = [name for name, one in vehicle_configs.items() if one.has_camera_scans]
        self.agent = Agent(config.agent, config.poses(), config.seed, bodies, sources, seeing)
        batteries = {name: one.battery for name, one in vehicle_configs.items()}
        self.planner = TeamPlanner(self.agent, batteries)
        self.planner.pause(not config.explore)
        self.inbox = Inbox({**LIMITS, FRAME.name: config.frame_queue}, prompt=_PROMPT)
        self.outputs = AgentOutputs(node, config)
        navigators = {name: one.navigator for name, one in vehicle_configs.items()}
        self.plans = PlanOutputs(node, navigators, config.map_frame, self._on_navigator)
        self.statistics = AgentStatistics()
        self._inputs: dict[str, VehicleInputs] = {}
        self._diagnostics = publisher(node, GlobalTopic.DIAGNOSTICS)
        self._due = dict.fromkeys(_PERIODIC, -np.inf)
        self._posed = dict.fromkeys(config.vehicles, -np.inf)
        self._sweeps: dict[str, dict[str, Sweep]] = {name: {} for name in config.vehicles}
        self._reported = time.monotonic()
        self._named_problems = NamedProblems()
        self._shared_frames: set[str] = set()
        self._unmeasured: set[str] = set()  # vehicles whose battery limits have no effect
        self._silence_timer: Timer | None = None
        self._active = False
        self._asked: set[Future] = set()  # by services, and not answered yet
        self._publishing = threading.Lock()  # held while the worker publishes
        self._offer_services()
        self._worker = threading.Thread(target=self._work, name='agent', daemon=True)
        self._worker.start()

    # -- life cycle ------------------------------------------------------------------------------

    def activate(self) -> None:
        """Listen to the vehicles and to the operator, plan and publish."""
        node = self._node
        self._inputs = self._listen()
        Heartbeat(node, self.config.vehicles)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._silence_timer = node.create_timer(SILENCE, self._explain_silence, clock=steady)
        node.create_timer(_RELEASE_PERIOD, self._release_held, clock=steady)
        self._due = dict.fromkeys(_PERIODIC, -np.inf)
        paused = self.planner.mode is PlanningMode.PAUSED
        self.outputs.status('exploration_paused' if paused else 'exploration_started')
        self._active = True

    def deactivate(self) -> None:
        """Stop the vehicles; the state is kept."""
        with self._publishing:
            self._active = False
        self.plans.stop(now_seconds(self._node))
        self.outputs.status('exploration_paused')

    def close(self) -> None:
        """End the worker; requests that it has not begun are refused."""
        self.inbox.close()
        self._worker.join(timeout=_JOIN_TIMEOUT)
        for future in list(self._asked):
            if not future.done():
                future.set_result((False, 'the agent was cleaned up before it could answer'))

    def configure(self, config: AgentNodeConfig) -> None:
        """Replace the settings; planning and publishing change at once, filter and grid later."""

        def apply(_: Any) -> None:
            self.config = config
            self.outputs.configure(config)
            self.agent.configure(config.agent)
            self.planner.configure(config.agent.exploration)

        self.inbox.put('request', 'parameters', apply, None)

    # -- wiring ----------------------------------------------------------------------------------

    def _listen(self) -> dict[str, VehicleInputs]:
        subscribe(self._node, TeamTopic.RESUME, self._on_resume)
        subscribe(
            self._node,
            GlobalTopic.SELECTED_INITIAL_POSE,
            lambda message: self._for_selected(TopicKind.INITIAL_POSE, message),
        )
        subscribe(
            self._node,
            GlobalTopic.SELECTED_GOAL_POSE,
            lambda message: self._for_selected(VehicleTopic.GOAL_POSE, message),
        )
        for topic in (TeamTopic.AREA, TeamTopic.KEEP_OUT):
            LatchedOrNotSubscription(self._node, topic, partial(self._on_polygon, topic))
        names = list(self.config.vehicles)
        transforms = TransformListener(self._node, names)
        given = explicit_mounts(self.config.agent)
        mounts = {
            name: SensorMounts(name, transforms.trees[name], config, given)
            for name, config in self._vehicle_configs.items()
        }
        return {
            name: VehicleInputs(
                self._node,
                mounts[name],
                names,
                self.inbox,
                sink=self.agent,
                planner=PlannerSink(self._place, self._send_to_goal, self._take_battery),
                transforms=transforms,
                map_frame=self.config.map_frame,
            )
            for name in names
        }

    def _for_selected(self, topic: Topic, message: Any) -> None:
        """Pass what the operator sends without a namespace to the selected vehicle."""
        vehicle = self.config.selected
        if vehicle is None:
            self._node.get_logger().warning(
                f'/{topic.value} is ignored: set the parameter selected_vehicle to one of '
                f'{list(self.config.vehicles)}'
            )
        else:
            self._inputs[vehicle].take(topic, message)

    def _send_to_goal(self, item: tuple[str, Pose2]) -> None:
        vehicle, goal = item
        self.planner.set_goal(vehicle, goal)
        self._node.get_logger().info(
            f'{vehicle} is sent to x {goal.x:.2f} m, y {goal.y:.2f} m by the operator'
        )
        self._due['plan'] = -np.inf

    def _take_battery(self, item: tuple[str, BatteryReading]) -> None:
        vehicle, reading = item
        if self.planner.report_battery(vehicle, reading, now_seconds(self._node)):
            self._due['plan'] = -np.inf
        problem = self.planner.batteries[vehicle].unmeasured
        if problem and vehicle not in self._unmeasured:
            self._unmeasured.add(vehicle)
            self._node.get_logger().warning(f'{vehicle}: {problem}')

    def _on_polygon(self, topic: TeamTopic, message: Any) -> None:
        """Take an area to explore or a keep-out area."""
        try:
            corners = operator_polygon(message, self.config.map_frame)
        except DataError as error:
            self._node.get_logger().warning(f'{topic.value}: {error}; message omitted')
            return

        def take(_: Any) -> None:
            areas = self.planner.areas
            change = areas.set_area if topic is TeamTopic.AREA else areas.add_keep_out
            change(corners)
            self._due['plan'] = -np.inf  # no vehicle drives on into it
            left_out = areas.area_left_out(self.agent.grid)
            change_made = 'a polygon' if corners else 'cleared'
            self._node.get_logger().info(
                f'{topic.value}: {change_made}; {left_out:.1f} m² of the map are excluded'
            )

        self.inbox.put('request', topic.value, take, None)

    def _place(self, item: tuple[str, OperatorPose]) -> None:
        """Place a vehicle where the operator sees it now, however far behind the agent is."""
        vehicle, given = item
        for kind in (IMU, ODOMETRY):
            for motion in self.inbox.take_out(vehicle, kind.name):
                motion.take(motion.payload)
        self.agent.set_pose(vehicle, given.pose, given.covariance)
        x, y, yaw = given.pose
        self._node.get_logger().info(
            f'{vehicle} is placed by the operator at x {x:.2f} m, y {y:.2f} m, yaw {yaw:.2f} rad'
        )
        self._omit_earlier(vehicle)

    def _omit_earlier(self, vehicle: str | None = None) -> None:
        """Leave out waiting measurements: they belong to the poses before a change."""
        omitted = self.inbox.take_out(vehicle)
        if omitted:
            self._node.get_logger().info(
                f'{len(omitted)} measurements from before the change are left out'
            )

    def _offer_services(self) -> None:
        directory = Path(self.config.run_directory)

        def save_map() -> str:
            return f'map written to {self.agent.save_map(directory / "map")}'

        def save_state() -> str:
            return f'state written to {self.agent.save_state(directory / "state.npz")}'

        def load_state() -> str:
            path = directory / 'state.npz'
            self.agent.load_state(path)
            self._omit_earlier()
            return f'state read from {path}'

        def reset() -> str:
            self.agent.reset()
            self.planner.reset()
            self._omit_earlier()
            self._due['plan'] = -np.inf
            return 'filter, map and targets are cleared; the vehicles are at their start poses'

        def return_home() -> str:
            self.planner.return_home()
            self._due['plan'] = -np.inf
            return 'the vehicles return to their start poses'

        # a request that waits for the worker must not keep the node from other callbacks
        group = ReentrantCallbackGroup()
        offered = [
            (Trigger, action.__name__, self._answer_with(action))
            for action in (save_map, save_state, load_state, reset, return_home)
        ]
        offered += [
            (SetBool, 'pause_new_measurements', self._on_pause),
            (GetMap, 'get_map', self._on_get_map),
        ]
        for kind, name, answer in offered:
            self._node.create_service(kind, name, answer, callback_group=group)

    def _answer_with(self, action: Any) -> Any:
        async def answer(_request: Any, response: Any) -> Any:
            response.success, response.message = await self._ask(action)
            return response

        return answer

    async def _on_pause(self, request: Any, response: Any) -> Any:
        def pause() -> str:
            self.agent.paused = bool(request.data)
            return 'new measurements are ' + ('ignored' if request.data else 'used again')

        response.success, response.message = await self._ask(pause)
        return response

    async def _on_get_map(self, _request: Any, response: Any) -> Any:
        def read() -> str:
            now, frame = now_seconds(self._node), self.config.map_frame
            response.map = map_message(now, frame, self.agent.grid)
            return ''

        await self._ask(read)
        return response

    def _ask(self, action: Any) -> Future:
        """Have the worker run an action; the future holds (success, message)."""
        future = Future(executor=self._node.executor)
        self._asked.add(future)
        future.add_done_callback(self._asked.discard)

        def run(_: Any) -> None:
            try:
                future.set_result((True, action()))
            except ExploreSlamError as error:
                self._node.get_logger().error(f'{action.__name__}: {error}')
                future.set_result((False, str(error)))

        self.inbox.put('request', action.__name__, run, None)
        return future

    def _on_navigator(self, vehicle: str, report: FollowerReport) -> None:
        if not self._active:
            return
        now = now_seconds(self._node)

        def take(_: Any) -> None:
            self.planner.report_follower(vehicle, report, now)

        self.inbox.put('navigator', vehicle, take, None)

    def _on_resume(self, message: Bool) -> None:
        paused = not message.data

        def take(_: Any) -> None:
            self.planner.pause(paused)
            self._due['plan'] = -np.inf  # nobody drives on until the next cycle is due

        self.inbox.put('request', 'resume', take, None)

    # -- the worker ------------------------------------------------------------------------------

    def _work(self) -> None:
        while not self.inbox.closed:
            item = self.inbox.get(timeout=POLL_PERIOD)
            try:
                if item is not None:
                    with self.statistics.timed(item.kind):
                        item.take(item.payload)
                with self._publishing:
                    if self._active:
                        self._publish_keyframes(item)
                        self._publish_newer_poses(item is None)
                        self._run_periodic_work()
                        self._publish_diagnostics()
            except ExploreSlamError as error:
                source = item.source if item is not None else 'agent'
                if item is not None and item.kind not in LIMITS:  # of the operator, who waits
                    self._node.get_logger().warning(f'{source}: {error}')
                else:
                    self._node.get_logger().warning(
                        f'{source}: {error}', throttle_duration_sec=2.0
                    )
            except Exception as error:
                if not self.inbox.closed:
                    self._node.get_logger().error(f'{type(error).__name__}: {error}')
                    raise

    def _publish_keyframes(self, item: Item | None) -> None:
        now = now_seconds(self._node)
        self._publish_obstacles()
        received = item.received if item is not None and item.kind == FRAME.name else None
        for event in self.agent.take_events():
            self._publish_pose(event.vehicle)
            if self.agent.is_in_map(event.vehicle):
                self.outputs.particles(
                    event.vehicle, event.stamp, self.agent.belief.particle_poses(event.vehicle)
                )
            self.statistics.add_keyframe(event, now, received)

    def _publish_obstacles(self) -> None:
        """Publish new views of obstacles of vehicles whose images the agent has."""
        for vehicle, inputs in self._inputs.items():
            for view in self.agent.take_views(vehicle):
                if inputs.config.vision == 'agent':
                    self.outputs.obstacles(vehicle, view, inputs.mounts.base)

    def _publish_newer_poses(self, idle: bool) -> None:
        """Publish each pose that is pose_period of odometry newer, or any newer one when idle.

        Time is measured by odometry stamps: a simulator that waits for poses holds the clock.
        """
        period = 0.0 if idle else self.config.pose_period
        for vehicle, track in self.agent.tracks.items():
            elapsed = track.odometry.last - self._posed[vehicle]
            if elapsed > period or elapsed < 0.0:  # negative: the clock jumped back
                self._publish_pose(vehicle)

    def _publish_pose(self, vehicle: str) -> None:
        track = self.agent.tracks[vehicle]
        stamp = track.odometry.last
        if not np.isfinite(stamp) or not self.agent.is_in_map(vehicle):
            return
        self._posed[vehicle] = stamp
        pose, covariance = self.agent.estimate(vehicle)
        self.outputs.pose(vehicle, stamp, pose, covariance)
        mounts = self._inputs[vehicle].mounts
        base_pose = track.source.base_pose(track.odometry)
        if track.source.needs_scans:
            reading = OdometryReading(stamp, base_pose)
            frames = (mounts.odom, mounts.base)
            self.outputs.scan_odometry(vehicle, reading, frames, not mounts.has_odometry)
        self.outputs.transform(vehicle, stamp, pose, base_pose, mounts.odom)

    def _is_due(self, what: str, period: float, now: float) -> bool:
        if self._due[what] - period <= now < self._due[what]:
            return False
        self._due[what] = now + period
        return True

    def _run_periodic_work(self) -> None:
        now = now_seconds(self._node)
        if now == 0.0:  # simulated time has not begun
            return
        self.agent.advance(now)
        if self.planner.must_withdraw:
            self._due['plan'] = -np.inf
        if self._is_due('plan', 1.0 / self.config.planner_frequency, now):
            self._plan(now)
        if self._is_due('map', self.config.map_period, now):
            self.outputs.grid(now, self.agent.grid)
            self._due['map update'] = now + self.config.map_update_period
        elif self.outputs.maps.wants_updates and self._is_due(
            'map update', self.config.map_update_period, now
        ):
            self.outputs.grid_update(now, self.agent.grid)
        if self._is_due('landmarks', self.config.landmarks_period, now):
            self.publish_results(now)

    def _plan(self, now: float) -> None:
        with self.statistics.timed('plan'):
            result = self.planner.plan(now)
        self.plans.send(now, result.plans)
        self.outputs.frontiers(now, result.frontiers)
        if self.outputs.status(result.status.value):
            self.outputs.grid(now, self.agent.grid)
            self.publish_results(now)

    def publish_results(self, now: float) -> None:
        """Publish landmarks and trajectories."""
        self.outputs.landmarks(now, self.agent.landmarks())
        for vehicle in filter(self.agent.is_in_map, self.agent.vehicles):
            self.outputs.trajectory(vehicle, now, *self.agent.trajectory(vehicle))

    # -- health ----------------------------------------------------------------------------------

    def _explain_silence(self) -> None:
        if self._silence_timer is not None:
            self._silence_timer.cancel()
        for inputs in self._inputs.values():
            for text in inputs.silence():
                self._node.get_logger().warning(text)

    def _release_held(self) -> None:
        for inputs in self._inputs.values():
            inputs.release_held()

    def _explain_clocks(self) -> None:
        """Log which topics have stamps of another clock, again when that changes."""
        problems: dict[str, StampProblem] = {}
        for inputs in self._inputs.values():
            problems.update(inputs.clock_problems())
        for text in self._named_problems.news(problems):
            self._node.get_logger().warning(text)

    def _explain_shared_frames(self) -> None:
        """Log once which frames several vehicles share."""
        own = {name for name in self._inputs if self._has_own_transforms(name)}
        mounts = [inputs.mounts for inputs in self._inputs.values()]
        for text in shared_frames(mounts, own):
            if text not in self._shared_frames:
                self._shared_frames.add(text)
                self._node.get_logger().warning(text)

    def _has_own_transforms(self, vehicle: str) -> bool:
        """Return whether nodes publish transforms in the namespace of the vehicle."""
        topics = (GlobalTopic.TF, GlobalTopic.TF_STATIC)
        return any(self._node.count_publishers(f'{vehicle}{topic.value}') for topic in topics)

    def _vehicle_figures(self) -> dict[str, dict[str, float | str]]:
        """Return counts, source and calibration of odometry, and the sweeps found, per vehicle."""
        counts, sweeps = self.agent.summary(), self.agent.found_sweeps()
        sources = self.agent.odometry_sources()
        return {
            name: {
                **counts[name],
                **self._battery_figures(name),
                **{f'odometry_{key}': value for key, value in calibration._asdict().items()},
                **{f'odometry_{key}': value for key, value in sources[name].items()},
                **{f'{SWEEP_KEY}{k}': words for k, words in named_sweeps(sweeps[name]).items()},
            }
            for name, calibration in self.agent.odometry_calibrations().items()
        }

    def _battery_figures(self, vehicle: str) -> dict[str, float | str]:
        """Return level, voltage (V) and share of a battery that is watched and has been read."""
        monitor = self.planner.batteries[vehicle]
        if monitor.reading is None:
            return {}
        voltage, share, _ = monitor.reading
        return {'battery': monitor.level.value, 'battery_V': voltage, 'battery_share': share}

    def _publish_sweeps(self) -> None:
        """Tell the nodes of the vehicles what the scans have shown of the sweeps, once each."""
        for vehicle, found in self.agent.found_sweeps().items():
            if found != self._sweeps[vehicle]:
                self._sweeps[vehicle] = found
                self.outputs.sweeps(vehicle, found)

    def _publish_diagnostics(self) -> None:
        if time.monotonic() < self._reported + REPORT_PERIOD:
            return
        self._reported = time.monotonic()
        self._explain_clocks()
        self._explain_shared_frames()
        self._publish_sweeps()
        behind = explain_delay(self.inbox)
        if behind:
            self._node.get_logger().warning(behind, throttle_duration_sec=_BEHIND_PERIOD)
        parts = self.statistics.parts(
            self.agent.statuses(),
            self._vehicle_figures(),
            self._inputs.values(),
            self.inbox,
            self.planner.result,
            {name: monitor.warning for name, monitor in self.planner.batteries.items()},
        )
        self._diagnostics.publish(diagnostics_message(self._node, parts, 'explore_slam'))
