"""Parameters of the agent node that are not the agent's own: vehicles, frames, rates, folders."""

from dataclasses import dataclass

from explore_slam.agent import AgentConfig
from explore_slam.errors import ConfigError
from explore_slam.geometry import Pose2
from explore_slam.settings import Section, section, setting


@dataclass(frozen=True)
class AgentNodeConfig(Section):
    """All parameters of the agent node."""

    vehicles: tuple[str, ...] = setting(
        ('robot1', 'robot2'), 'names of the vehicles, which are their namespaces'
    )
    start_poses: tuple[float, ...] = setting(
        (0.0, 0.0, 0.0, 0.0, 1.0, 0.0),
        'where the vehicles start in the map: x (m), y (m), heading (rad) of each',
    )
    seed: int = setting(0, 'seed of all random numbers', low=0)
    vision: str = setting(
        'agent',
        'where features are extracted: here from images, or on the vehicles (topic landmarks)',
        choices=('agent', 'vehicle'),
    )
    explore: bool = setting(True, 'plan targets for the vehicles from the start')
    planner_frequency: float = setting(
        0.5, 'planning cycles per second', unit='Hz', low=0.01, high=20.0
    )
    map_period: float = setting(2.0, 'time between published maps', unit='s', low=0.1, high=3600.0)
    landmarks_period: float = setting(
        5.0, 'time between published landmarks and trajectories', unit='s', low=0.1, high=3600.0
    )
    pose_period: float = setting(
        0.2, 'odometry time between poses while no keyframe comes', unit='s', low=0.02, high=10.0
    )
    frame_queue: int = setting(
        4, 'frames per vehicle that may wait for the agent; the oldest gives way', low=1, high=1000
    )
    published_particles: int = setting(
        100, 'most particles on the topic particles', low=0, high=20000
    )
    map_frame: str = setting('map', 'frame of map, plans and poses')
    odom_frame: str = setting('odom', "frame of odometry, behind the vehicle's name and a slash")
    robot_base_frame: str = setting(
        'base_link', "frame of a vehicle, behind the vehicle's name and a slash"
    )
    run_directory: str = setting('.', 'where save_map and save_state write')
    agent: AgentConfig = section(AgentConfig)

    def poses(self) -> dict[str, Pose2]:
        """Return vehicle -> start pose; ConfigError when the numbers do not fit the names."""
        names, values = self.vehicles, self.start_poses
        if not names or len(set(names)) != len(names):
            raise ConfigError(
                f'vehicles is {list(names)}, expected one name or more, all different'
            )
        if len(values) != 3 * len(names):
            raise ConfigError(
                f'start_poses has {len(values)} numbers, expected {3 * len(names)}: '
                f'x, y and heading of each of {list(names)}'
            )
        return {
            name: Pose2(*map(float, values[3 * i : 3 * i + 3])) for i, name in enumerate(names)
        }
