"""Settings of the camera's way into the map: features, depth, noise, keyframes, mounting."""

from dataclasses import dataclass

from explore_slam.mounts import CameraMountConfig
from explore_slam.settings import Section, section, setting


@dataclass(frozen=True)
class FeatureConfig(Section):
    """Which SIFT features of a frame become landmark observations."""

    feature_budget: int = setting(
        200, 'most features taken from one frame', unit='features', low=1, high=5000
    )
    feature_grid_rows: int = setting(
        4, 'rows of image cells that share the feature budget evenly', low=1, high=100
    )
    feature_grid_columns: int = setting(
        6, 'columns of image cells that share the feature budget evenly', low=1, high=100
    )
    sift_contrast_threshold: float = setting(
        0.05,
        'least contrast of a SIFT feature; lower finds more and weaker ones',
        low=0.0,
        high=1.0,
    )
    sift_edge_threshold: float = setting(
        10.0, 'most elongated SIFT feature kept; higher keeps more of them', low=1.0, high=1000.0
    )
    minimum_feature_size: float = setting(
        3.0,
        'smallest SIFT feature; small ones are not found again',
        unit='pixels',
        low=0.0,
        high=100.0,
    )
    feature_orientation: str = setting(
        'upright',
        'orientations of a feature: one per place, all of them, or upright for a camera that '
        'never rolls',
        choices=('single', 'all', 'upright'),
    )
    root_sift: bool = setting(False, 'compare descriptors as RootSIFT (Hellinger) instead of L2')


@dataclass(frozen=True)
class DepthConfig(Section):
    """How far depth is believed, and how much."""

    min_depth: float = setting(0.8, 'nearest valid depth', unit='m', low=0.0, high=100.0)
    max_depth: float = setting(3.5, 'farthest valid depth', unit='m', low=0.0, high=100.0)
    pixel_noise: float = setting(
        0.8, 'standard deviation of a feature in the image', unit='pixels', low=0.01, high=100.0
    )
    depth_noise: float = setting(
        0.003,
        'standard deviation of depth at 1 m; grows with its square',
        unit='1/m',
        low=1e-6,
        high=1.0,
    )
    depth_edge_ratio: float = setting(
        0.05,
        'spread of depth around a feature, as part of its depth, from which on it is an edge',
        low=1e-3,
        high=10.0,
    )
    depth_edges: str = setting(
        'drop',
        'what becomes of features on an edge of depth: dropped, or kept with the spread as '
        'their noise',
        choices=('drop', 'widen'),
    )


@dataclass(frozen=True)
class KeyframeConfig(Section):
    """When a frame is worth a filter update."""

    minimum_travel_distance: float = setting(
        0.2,
        'distance driven from which on a frame becomes a keyframe',
        unit='m',
        low=0.0,
        high=100.0,
    )
    minimum_travel_heading: float = setting(
        0.17, 'turn from which on a frame becomes a keyframe', unit='rad', low=0.0, high=6.3
    )
    maximum_keyframe_gap: float = setting(
        5.0, 'time after which a frame becomes a keyframe anyway', unit='s', low=0.0, high=3600.0
    )


@dataclass(frozen=True)
class VisionConfig(Section):
    """All settings of the room."""

    features: FeatureConfig = section(FeatureConfig)
    depth: DepthConfig = section(DepthConfig)
    keyframes: KeyframeConfig = section(KeyframeConfig)
    mount: CameraMountConfig = section(CameraMountConfig)
