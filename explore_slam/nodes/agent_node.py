"""Node `agent`: the life cycle and the parameters of the central agent on topics."""

import logging
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter

from explore_slam.agent import AgentConfig, warm_up
from explore_slam.messages.vehicle_settings import VehicleConfig
from explore_slam.nodes.agent_parameters import AgentNodeConfig
from explore_slam.nodes.agent_session import AgentSession
from explore_slam.nodes.driver_parameters import DriverNodeConfig
from explore_slam.nodes.managed_node import ManagedNode
from explore_slam.nodes.node_support import (
    RosLogHandler,
    changed_settings,
    declare_settings,
    declare_vehicle_settings,
    interruptible,
    run_node,
    warn_of_unknown_parameters,
)
from explore_slam.settings import values_of
from explore_slam.vehicle import PathFollowerConfig

# parameters that other nodes rely on, or that the node is built from: fixed after the start
FIXED = {'vehicles', *values_of(VehicleConfig())}
# parameters that the agent is built from when it is configured
AT_CONFIGURATION = {'start_poses', 'seed', 'frame_queue', 'map_frame', 'run_directory'}
_DEFAULTS = AgentConfig()
# parameters of what is built anew at a reset
AT_RESET = {
    *values_of(_DEFAULTS.slam), *values_of(_DEFAULTS.mapping), *values_of(_DEFAULTS.closures),
    'odometry_duration', 'odometry_jump_speed',
}  # fmt: skip
_NOTES = {
    **dict.fromkeys(AT_RESET, 'takes effect at the next reset'),
    **dict.fromkeys(FIXED, 'set at start only'),
    **dict.fromkeys(AT_CONFIGURATION, 'set before the node is configured only'),
}


class AgentNode(ManagedNode):
    """The central agent as a managed node. Inactive, it keeps its state and stops the vehicles."""

    def __init__(self, **options: Any) -> None:
        super().__init__('agent', **options)
        self._log_handler = RosLogHandler(self)
        logging.getLogger('explore_slam').addHandler(self._log_handler)
        logging.getLogger('explore_slam').setLevel(logging.INFO)
        self.config = declare_settings(self, AgentNodeConfig(), _NOTES)
        self.vehicle_configs = declare_vehicle_settings(
            self, self.config.team, self.config.vehicles
        )
        others = {*values_of(DriverNodeConfig()), *values_of(PathFollowerConfig())}
        own = {f'{vehicle}.{name}' for vehicle in self.config.vehicles for name in others}
        warn_of_unknown_parameters(self, others | own)
        for name, vehicle in self.vehicle_configs.items():
            if not vehicle.has_sensor:
                self.get_logger().warning(
                    f'{name} has no sensor: use_laser is false and vision is none; it maps '
                    f'nothing and drifts with its odometry; set {name}.use_laser or {name}.vision'
                )
        self.session: AgentSession | None = None
        self.add_on_set_parameters_callback(self._on_parameters)
        self.start(self.config.lifecycle.autostart)

    def configure(self) -> None:
        """Build filter, map and planner; offer topics and services."""
        with interruptible():
            warm_up(self.get_logger().info)
        self.session = AgentSession(self, self.config, self.vehicle_configs)

    def activate(self) -> None:
        """Listen to the vehicles and to the operator, plan and publish."""
        assert self.session is not None
        self.session.activate()

    def deactivate(self) -> None:
        """Stop the vehicles; the state is kept."""
        assert self.session is not None
        self.session.deactivate()

    def clean_up(self) -> None:
        """Forget filter, map and planner."""
        assert self.session is not None
        self.session.close()
        self.session = None

    def stop(self) -> None:
        """Stop the vehicles and end the worker, in whatever state the node is."""
        super().stop()
        logging.getLogger('explore_slam').removeHandler(self._log_handler)

    def _on_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        """Check and apply; planning and publishing change at once, filter and grid at a reset."""
        fixed = [item.name for item in parameters if item.name in FIXED or '.' in item.name]
        built = [item.name for item in parameters if item.name in AT_CONFIGURATION]
        if fixed:
            reason = f'{", ".join(fixed)}: set at start only'
            return SetParametersResult(successful=False, reason=reason)
        if built and self.session is not None:
            reason = f'{", ".join(built)}: set at start, or while the node is unconfigured'
            return SetParametersResult(successful=False, reason=reason)
        self.config, result = changed_settings(self.config, parameters)
        if result.successful and self.session is not None:
            self.session.configure(self.config)
            late = sorted(item.name for item in parameters if item.name in AT_RESET)
            if late:  # rclpy drops the reason of a success: the log has it
                self.get_logger().info(f'{", ".join(late)}: takes effect at the next reset')
        return result


def main(arguments: list[str] | None = None) -> int:
    """Run the node; the entry point of the executable."""
    return run_node(AgentNode, arguments)
