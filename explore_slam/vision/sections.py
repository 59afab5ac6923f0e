"""Sections of the settings of vision; VisionConfig gathers them."""

from dataclasses import dataclass

from explore_slam.settings import Section, setting


@dataclass(frozen=True)
class FeatureConfig(Section):
    """Which features of a frame become landmark observations."""

    feature_budget: int = setting(
        200,
        'Maximum number of features taken from one frame',
        unit='features',
        low=1,
        high=5000,
        tier='basic',
    )
    feature_grid_rows: int = setting(
        4, 'Rows of image cells that share the feature budget evenly', low=1, high=100
    )
    feature_grid_columns: int = setting(
        6, 'Columns of image cells that share the feature budget evenly', low=1, high=100
    )
    sift_contrast_threshold: float = setting(
        0.05,
        'Minimum contrast of a SIFT feature; lower finds more and weaker ones',
        low=0.0,
        high=1.0,
    )
    sift_edge_threshold: float = setting(
        10.0,
        'Maximum ratio of principal curvatures of a SIFT feature; higher keeps more edges',
        low=1.0,
        high=1000.0,
    )
    minimum_feature_size: float = setting(
        3.0,
        'Minimum diameter of a feature; small ones are seldom found again',
        unit='pixels',
        low=0.0,
        high=100.0,
    )
    feature_orientation: str = setting(
        'upright',
        'Orientations of a SIFT feature: a single one per place, all of them, or upright for a '
        'camera that never rolls',
        choices=('single', 'all', 'upright'),
    )
    root_sift: bool = setting(
        False, 'Compare descriptors as RootSIFT (Hellinger kernel) instead of by L2'
    )


@dataclass(frozen=True)
class DepthConfig(Section):
    """Which depth measurements are valid, and how accurate they are."""

    min_depth: float = setting(
        0.8, 'Minimum valid depth', unit='m', low=0.0, high=100.0, tier='basic'
    )
    max_depth: float = setting(
        3.5, 'Maximum valid depth', unit='m', low=0.0, high=100.0, tier='basic'
    )
    pixel_noise: float = setting(
        0.5,  # of a Kinect that hardly turns, by benchmarks/noise_camera.py on fr1_rpy
        'Standard deviation of the position of a feature in the image',
        unit='pixels',
        low=0.01,
        high=100.0,
    )
    depth_noise: float = setting(
        0.003,
        'Standard deviation of depth at 1 m; grows with the square of depth',
        unit='1/m',
        low=1e-6,
        high=1.0,
    )
    camera_readout_time: float = setting(
        0.026,  # Ringaby and Forssén, ICCV 2011: the colour camera of a Kinect v1
        'Time from the exposure of the first row of an image to that of the last, of a rolling '
        'shutter (default: Kinect v1); features are moved to where they were at the stamp. '
        '0: all rows at once',
        unit='s',
        low=0.0,
        high=1.0,
    )
    depth_edge_ratio: float = setting(
        0.05,
        'Range of depths around a feature, relative to its depth, from which it is on an edge',
        low=1e-3,
        high=10.0,
    )
    depth_edges: str = setting(
        'drop',
        'Features on a depth edge: drop them, or widen their depth noise to the range of depths',
        choices=('drop', 'widen'),
    )


@dataclass(frozen=True)
class ObstacleConfig(Section):
    """Which readings of a depth image are obstacles that a laser does not see."""

    depth_obstacles: bool = setting(
        True,
        'Map what depth images show of table tops, shelves, things on the floor and steps down',
    )
    obstacle_lowest: float = setting(
        0.06,
        'Height above the floor from which readings count as obstacles; about three times the '
        'noise of height at obstacle_range',
        unit='m',
        low=0.01,
        high=1.0,
    )
    obstacle_highest: float = setting(
        0.9,
        'Height up to which they do: that of the highest vehicle, mast and camera included, with '
        'a margin',
        unit='m',
        low=0.1,
        high=1.5,
    )
    step_depth: float = setting(
        0.06,
        'Depth below the floor from which a reading shows a step down',
        unit='m',
        low=0.01,
        high=1.0,
    )
    obstacle_range: float = setting(
        3.0,
        'Range of depth images within which obstacles are mapped; well below that of the camera',
        unit='m',
        low=0.5,
        high=10.0,
    )
    camera_scan_lowest: float = setting(
        0.1,
        'Of a vehicle without a laser: height above the floor from which readings of its camera '
        'make up the scans that take the place of those of a laser',
        unit='m',
        low=0.01,
        high=1.0,
    )
    camera_scan_highest: float = setting(
        0.5,
        'Height up to which they do; below table tops, whose edges look different from everywhere',
        unit='m',
        low=0.05,
        high=2.0,
    )


@dataclass(frozen=True)
class KeyframeConfig(Section):
    """Which frames become keyframes."""

    minimum_travel_distance: float = setting(
        0.2,
        'Travel since the last keyframe from which a frame becomes a keyframe',
        unit='m',
        low=0.0,
        high=100.0,
        tier='basic',
    )
    minimum_travel_heading: float = setting(
        0.17,
        'Change of heading since the last keyframe from which a frame becomes a keyframe',
        unit='rad',
        low=0.0,
        high=6.3,
        tier='basic',
    )
    maximum_keyframe_gap: float = setting(
        5.0,
        'Time since the last keyframe after which a frame becomes a keyframe in any case',
        unit='s',
        low=0.0,
        high=3600.0,
    )
