"""Pose of the camera on the vehicle: transforms points and covariances into the vehicle frame."""

import math
from typing import NamedTuple

import numpy as np

from explore_slam.errors import VisionError
from explore_slam.geometry import (
    Array,
    Pose3,
    quaternion_from_rotation,
    roll_pitch_yaw,
    rotation_matrix,
)
from explore_slam.mounts import CameraMountConfig

# optical frame (x right, y down, z forward) -> body frame (x forward, y left, z up), REP-103
OPTICAL_TO_BODY: Array = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


class CameraMount(NamedTuple):
    """Pose of the camera body frame (x forward) in the vehicle frame: m and rad, fixed axes."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    roll: float = 0.0
    pitch: float = 0.0
    yaw: float = 0.0

    @classmethod
    def from_config(cls, config: CameraMountConfig) -> 'CameraMount':
        """Return the mount of the settings."""
        return cls(
            config.camera_x,
            config.camera_y,
            config.camera_z,
            config.camera_roll,
            config.camera_pitch,
            config.camera_yaw,
        )

    @classmethod
    def from_optical(cls, pose: Pose3) -> 'CameraMount':
        """Return the mount of a camera whose optical frame has this pose in the vehicle frame."""
        return cls(*pose.position, *roll_pitch_yaw(pose.rotation @ OPTICAL_TO_BODY.T))

    @property
    def optical_pose(self) -> Pose3:
        """Pose of the optical frame in the vehicle frame."""
        return Pose3((self.x, self.y, self.z), quaternion_from_rotation(self.rotation))

    @property
    def rotation(self) -> Array:
        """Rotation (3, 3) from the optical frame to the vehicle frame."""
        return rotation_matrix(self.roll, self.pitch, self.yaw) @ OPTICAL_TO_BODY

    @property
    def translation(self) -> Array:
        """Position (3,) m of the camera in the vehicle frame."""
        return np.array([self.x, self.y, self.z])

    def to_vehicle(self, points: Array) -> Array:
        """Transform points (N, 3) m from the optical frame into the vehicle frame."""
        moved: Array = points @ self.rotation.T + self.translation
        return moved

    def rotate_covariances(self, covariances: Array) -> Array:
        """Rotate covariances (N, 3, 3) from the optical frame into the vehicle frame."""
        turn = self.rotation
        turned: Array = turn @ covariances @ turn.T
        return turned

    def check(self) -> None:
        """Raise VisionError if a coordinate is not finite."""
        if not all(map(math.isfinite, self)):
            raise VisionError(f'camera mount is {tuple(self)}, expected finite m and rad')
