"""Parameters of the agent node beside those of the agent: vehicles, frames, rates, folders."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from explore_slam.agent import AgentConfig
from explore_slam.errors import ConfigError
from explore_slam.geometry import Pose2
from explore_slam.messages.vehicle_settings import (
    VehicleConfig,
    settings_of_vehicles,
    split_vehicle_values,
)
from explore_slam.nodes import shared_parameters
from explore_slam.nodes.shared_parameters import LifecycleConfig
from explore_slam.settings import (
    Section,
    read_parameters,
    section,
    setting,
    with_values,
)


@dataclass(frozen=True)
class AgentNodeConfig(Section):
    """All parameters of the agent node."""

    vehicles: tuple[str, ...] = shared_parameters.vehicles()
    start_poses: tuple[float, ...] = setting(
        (0.0, 0.0, 0.0, 0.0, 1.0, 0.0),
        'Start poses of the vehicles in the map: x (m), y (m), heading (rad) of each, or three '
        'times nan where it is unknown: the vehicle joins the map when its scans or landmarks are '
        'found there',
        tier='basic',
    )
    seed: int = setting(0, 'Seed of all random numbers', low=0)
    selected_vehicle: str = setting(
        '',
        'Vehicle that gets what RViz sends to /initialpose and /goal_pose; empty: the only one of '
        'the team',
        tier='basic',
    )
    explore: bool = setting(True, 'Start exploring at once', tier='basic')
    planner_frequency: float = setting(
        0.5, 'Planning cycles per second', unit='Hz', low=0.01, high=20.0
    )
    map_period: float = setting(2.0, 'Time between published maps', unit='s', low=0.1, high=3600.0)
    map_update_period: float = setting(
        0.5,
        'Time between messages on map_updates, where map_msgs is installed and has subscribers',
        unit='s',
        low=0.05,
        high=3600.0,
    )
    landmarks_period: float = setting(
        5.0, 'Time between published landmarks and trajectories', unit='s', low=0.1, high=3600.0
    )
    pose_period: float = setting(
        0.2,
        'Time between published poses while no keyframe arrives',
        unit='s',
        low=0.02,
        high=10.0,
    )
    frame_queue: int = setting(
        4,
        'RGB-D frames per vehicle that may wait for the agent; the oldest is dropped',
        low=1,
        high=1000,
    )
    published_particles: int = setting(
        100, 'Maximum number of particles published per vehicle; 0 publishes none',
        low=0, high=20000,
    )  # fmt: skip
    map_frame: str = shared_parameters.map_frame()
    transform_tolerance: float = setting(
        0.5,
        'Time by which the transform map -> odom is dated into the future',
        unit='s',
        low=0.0,
        high=10.0,
    )
    run_directory: str = setting(
        '.', 'Folder into which save_map and save_state write', tier='basic'
    )
    team: VehicleConfig = section(VehicleConfig)
    agent: AgentConfig = section(AgentConfig)
    lifecycle: LifecycleConfig = section(LifecycleConfig)

    def __post_init__(self) -> None:
        super().__post_init__()
        shared_parameters.check_names(self.vehicles)
        if not self.map_frame.strip('/'):
            raise ConfigError(f'map_frame is {self.map_frame!r}, expected the name of a frame')
        if self.selected_vehicle and self.selected_vehicle not in self.vehicles:
            raise ConfigError(
                f'selected_vehicle is {self.selected_vehicle!r}, expected one of '
                f'{list(self.vehicles)}'
            )

    @property
    def selected(self) -> str | None:
        """The vehicle that the operator has selected, or the only one; None if ambiguous."""
        if not self.selected_vehicle and len(self.vehicles) == 1:
            return self.vehicles[0]
        return self.selected_vehicle or None

    def poses(self) -> dict[str, Pose2 | None]:
        """Return vehicle -> start pose, None: unknown; ConfigError for wrong numbers."""
        return shared_parameters.start_poses(self.vehicles, self.start_poses)


def load_agent_settings(path: Path) -> tuple[AgentConfig, dict[str, Any]]:
    """Return the agent's settings in a parameter file, and those of its vehicles by name.

    ConfigError for unknown names.
    """
    own, others = split_vehicle_values(read_parameters(path))
    try:
        config = with_values(AgentNodeConfig(), others)
        settings_of_vehicles(own, config.vehicles)
    except ConfigError as error:
        raise ConfigError(f'{path}: {error}') from error
    return config.agent, own
