"""Clouds placed at poses, as a likelihood grid for correlation and surfaces for alignment."""

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from explore_slam.errors import RegistrationError
from explore_slam.geometry import Array, Pose2
from explore_slam.registration.alignment import Alignment, Prior, align
from explore_slam.registration.cloud import PointCloud
from explore_slam.registration.correlation import (
    Peak,
    SearchWindow,
    find_other_mode,
    find_peak,
    score_profile,
)
from explore_slam.registration.likelihood_grid import LikelihoodGrid
from explore_slam.registration.surface_map import SurfaceMap


class LocalMap:
    """The map that clouds in one frame make; grid and surfaces are made when first needed."""

    def __init__(self, placed: Sequence[PointCloud]) -> None:
        if not placed:
            raise RegistrationError('a local map needs one cloud or more')
        self._placed = placed

    @classmethod
    def of(cls, clouds: Sequence[PointCloud], poses: Sequence[Pose2]) -> 'LocalMap':
        """Make the map of clouds (in the frames of their vehicles) at the poses."""
        if len(clouds) != len(poses):
            raise RegistrationError(
                f'a local map needs one pose per cloud, got {len(clouds)} clouds '
                f'and {len(poses)} poses'
            )
        for pose in poses:
            if not pose.is_finite():
                raise RegistrationError(f'pose {tuple(pose)} of a cloud is not finite')
        return cls([cloud.moved(pose) for cloud, pose in zip(clouds, poses, strict=True)])

    @cached_property
    def grid(self) -> LikelihoodGrid:
        """Likelihood grid of all points, those without a normal included."""
        return LikelihoodGrid(np.concatenate([cloud.sparse_points for cloud in self._placed]))

    @cached_property
    def surfaces(self) -> SurfaceMap:
        """Surface elements of all points that have a normal."""
        parts = [cloud.surfaces for cloud in self._placed]
        return SurfaceMap.of(
            np.concatenate([points for points, _ in parts]),
            np.concatenate([normals for _, normals in parts]),
        )

    def find_peak(self, points: Array, window: SearchWindow, least_score: float) -> Peak | None:
        """Return the best pose of points (n, 2) in the window; see correlation.find_peak."""
        return find_peak(self.grid, points, window, least_score)

    def find_other_mode(
        self,
        points: Array,
        window: SearchWindow,
        best: Pose2,
        apart: tuple[float, float],
        least_score: float,
    ) -> Peak | None:
        """Return the best other pose in the window, if it is above the minimum score."""
        return find_other_mode(self.grid, points, window, best, apart, least_score)

    def score_profile(
        self, points: Array, pose: Pose2, direction: tuple[float, float], offsets: Array
    ) -> Array:
        """Return the scores (k,) of points (n, 2) at a pose shifted by offsets (k,) m."""
        return score_profile(self.grid, points, pose, direction, offsets)

    def align(
        self, cloud: PointCloud, start: Pose2, reach: float, prior: Prior | None = None
    ) -> Alignment | None:
        """Return the pose at which the cloud lies on the surfaces; see alignment.align."""
        return align(self.surfaces, *cloud.surfaces, cloud.surface_weights, start, reach, prior)
