"""Names of coordinate frames (REP-105): one tree per vehicle below the common map frame."""

from dataclasses import dataclass


@dataclass(frozen=True)
class FrameNames:
    """Frames of one vehicle: their names are prefixed with the vehicle's name and a slash.

    The map frame is common to all vehicles and has no prefix.
    """

    vehicle: str
    map: str = 'map'
    odom_suffix: str = 'odom'
    base_suffix: str = 'base_link'
    laser_suffix: str = 'laser'
    camera_suffix: str = 'camera_optical_frame'
    imu_suffix: str = 'imu_link'

    @property
    def odom(self) -> str:
        """Frame of the odometry, e.g. 'robot1/odom'."""
        return f'{self.vehicle}/{self.odom_suffix}'

    @property
    def base(self) -> str:
        """Frame of the vehicle, e.g. 'robot1/base_link'."""
        return f'{self.vehicle}/{self.base_suffix}'

    @property
    def laser(self) -> str:
        """Frame of the laser, e.g. 'robot1/laser'."""
        return f'{self.vehicle}/{self.laser_suffix}'

    @property
    def imu(self) -> str:
        """Frame of the IMU, e.g. 'robot1/imu_link'."""
        return f'{self.vehicle}/{self.imu_suffix}'

    def laser_frame(self, sensor: str) -> str:
        """Return the frame of one of several lasers, e.g. 'robot1/front_scan'; '': of the one."""
        return f'{self.vehicle}/{sensor.replace("/", "_")}' if sensor else self.laser

    def camera_frame(self, sensor: str) -> str:
        """Return the optical frame of one of several cameras; '': of the only one."""
        name = sensor.replace('/', '_')
        return f'{self.vehicle}/{name}_optical_frame' if sensor else self.camera

    @property
    def camera(self) -> str:
        """Optical frame of the camera, e.g. 'robot1/camera_optical_frame'."""
        return f'{self.vehicle}/{self.camera_suffix}'
