"""Parameters of the driver node: frames, and the settings of its devices."""

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from explore_slam.messages.frames import FrameNames
from explore_slam.messages.vehicle_settings import VehicleConfig
from explore_slam.nodes import shared_parameters
from explore_slam.nodes.shared_parameters import LifecycleConfig, TeleoperationConfig
from explore_slam.settings import Section, section, setting, values_of, with_values
from explore_slam.vehicle import DriverConfig


@dataclass(frozen=True)
class DriverNodeConfig(Section):
    """All parameters of the driver node."""

    odom_frame: str = shared_parameters.odom_frame()
    robot_base_frame: str = shared_parameters.robot_base_frame()
    laser_frame: str = setting(
        'laser', "Frame of the laser, prefixed with the vehicle's name and a slash"
    )
    camera_frame: str = setting(
        'camera_optical_frame',
        "Optical frame of the camera, prefixed with the vehicle's name and a slash",
    )
    publish_tf: bool = setting(True, 'Publish transforms (if tf2_msgs is installed)')
    watch_scan_topic: bool = setting(
        False,
        'Stop for obstacles on the topic scan of another laser driver, if enable_laser is false',
    )
    keep_odometry: bool = setting(
        True,
        'Continue the odometry frame over a restart of this node, while the robot has power: in '
        'odometry_file, or in a file per vehicle and port below ~/.ros (ROS_HOME)',
    )
    teleoperation: TeleoperationConfig = section(TeleoperationConfig)
    driver: DriverConfig = section(DriverConfig)
    lifecycle: LifecycleConfig = section(LifecycleConfig)

    def with_vehicle(self, vehicle: VehicleConfig) -> Self:
        """Return the parameters with what the vehicle's settings say of its sensors.

        They are laser_mount and camera_mount in place of laser_x, camera_x and so on, and
        use_laser: a vehicle without laser has none that this driver could read.
        """
        values: dict[str, float | bool] = {}
        if not vehicle.use_laser:
            values['enable_laser'] = False
        for prefix, numbers, names in (
            ('laser', vehicle.laser_mount, ('x', 'y', 'yaw')),
            ('camera', vehicle.camera_mount, ('x', 'y', 'z', 'roll', 'pitch', 'yaw')),
        ):
            if len(numbers) == len(names):
                values.update(zip((f'{prefix}_{name}' for name in names), numbers, strict=True))
        return with_values(self, values)

    def with_odometry_file(self, vehicle: str) -> Self:
        """Return the parameters with a file for the odometry frame, if it is to be kept."""
        values = values_of(self)
        if not self.keep_odometry:
            return with_values(self, {'odometry_file': ''})
        if values['odometry_file'] or not self.driver.base.enable_base:
            return self
        home = Path(os.environ.get('ROS_HOME', '~/.ros')).expanduser()
        port = re.sub(r'[^A-Za-z0-9]+', '_', str(values['base_port'])).strip('_')
        file = home / 'explore_slam' / f'odometry_{vehicle}_{port}.json'
        return with_values(self, {'odometry_file': str(file)})

    def frames(self, vehicle: str) -> FrameNames:
        """Return the frames of the vehicle; names that begin with its name keep it once."""
        own = f'{vehicle}/'
        return FrameNames(
            vehicle,
            odom_suffix=self.odom_frame.removeprefix(own),
            base_suffix=self.robot_base_frame.removeprefix(own),
            laser_suffix=self.laser_frame,
            camera_suffix=self.camera_frame,
        )
