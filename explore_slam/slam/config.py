"""Settings of the filter."""

from dataclasses import dataclass

import numpy as np

from explore_slam.errors import ConfigError
from explore_slam.geometry import Array
from explore_slam.settings import Section, section, setting
from explore_slam.slam.descriptors.kinds import KINDS, kind_named
from explore_slam.slam.graph.config import GraphConfig
from explore_slam.slam.particles.motion import OdometryNoise


@dataclass(frozen=True)
class AssociationConfig(Section):
    """Data association: which landmark an observation is."""

    descriptor_kind: str = setting('sift', f'Kind of the landmark descriptors: {", ".join(KINDS)}')
    maximum_descriptor_distance: float = setting(
        0.4,
        'Largest squared descriptor distance of a match (E0 of the paper), of unit vectors; for '
        'binary descriptors 4 h / B at a Hamming distance of h of B bits',
        low=0.0,
        high=4.0,
    )
    minimum_association_probability: float = setting(
        0.9,
        'Engine paper: minimum association probability exp(-d²/2) of a match (P0 of the paper)',
        low=0.0,
        high=1.0,
    )
    association_gate: float = setting(
        4.5,
        'Engine fastslam2: largest Mahalanobis distance of a match; similar objects have the same '
        'features, and a wide gate associates look-alikes',
        unit='sigma',
        low=1.0,
        high=20.0,
    )
    candidates_per_observation: int = setting(
        4, 'Candidate landmarks of one observation that are compared by position', low=1, high=32
    )
    descriptor_index: str = setting(
        'forest',
        'Search for similar descriptors: randomized kd-forest, exact kd-tree, or brute force',
        choices=('forest', 'kd_tree', 'brute_force'),
    )
    forest_checks: int = setting(
        256,
        'Descriptors compared per query of the kd-forest; also the largest number of landmarks '
        'near an observation that are all compared',
        low=16,
        high=100_000,
    )
    maximum_observations: int = setting(
        1000, 'Maximum number of observations in one update', low=1, high=10_000
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        kind_named(self.descriptor_kind)


@dataclass(frozen=True)
class ExistenceConfig(Section):
    """When a landmark that is not observed again is removed. A match counts as evidence of 1."""

    existence_miss: float = setting(
        0.2,
        'Evidence lost by a landmark that is in view, not occluded, and not matched; a match '
        'counts 1',
        low=0.0,
        high=10.0,
    )
    existence_limit: float = setting(
        5.0,
        'Upper limit of existence evidence; a landmark is removed when its evidence is negative',
        low=1.0,
        high=100.0,
    )
    landmark_cell: float = setting(
        0.5,
        'Edge length of the cubes in which the number of landmarks is limited',
        unit='m',
        low=0.05,
        high=100.0,
    )
    landmarks_per_cell: int = setting(
        24,
        'Engine fastslam2: a cube gets no new landmarks beyond this number; those that were never '
        'matched make room first',
        low=1,
        high=100_000,
    )


@dataclass(frozen=True)
class RelocalizationConfig(Section):
    """Relocalization of a lost vehicle."""

    relocalization: bool = setting(
        True,
        'Search for the pose of a vehicle whose matches contradict it in nearly all particles',
    )
    relocalization_matches: int = setting(
        5, 'Minimum number of matches that must agree on the new pose', low=3, high=100
    )
    relocalization_window: int = setting(
        12, 'Updates of a vehicle whose matches are used together', low=1, high=200
    )


@dataclass(frozen=True)
class CorrelationConfig(Section):
    """Correlation of the errors of repeated observations of one landmark.

    They depend on the sensor: `benchmarks/noise_mrclam.py` finds those of the robots of MR.CLAM.
    """

    correlated_observations: bool = setting(
        True,
        'Count repeated observations of a landmark from about the same place as correlated',
    )
    correlation_distance: float = setting(
        0.3,
        'Correlation length of observation errors over distance driven',
        unit='m',
        low=1e-3,
        high=100.0,
    )
    correlation_turn: float = setting(
        0.5,
        'Correlation length of observation errors over angle turned',
        unit='rad',
        low=1e-3,
        high=100.0,
    )
    correlation_time: float = setting(
        10.0, 'Correlation time of observation errors', unit='s', low=1e-3, high=1e6
    )

    def lengths(self) -> Array:
        """Return the correlation lengths (m, rad, s)."""
        return np.array([self.correlation_distance, self.correlation_turn, self.correlation_time])


@dataclass(frozen=True)
class FrameErrorConfig(Section):
    """Error common to all observations of one frame, as if made from a pose nearby.

    Depth scale, rolling shutter and registration of a camera displace a frame as a whole.
    """

    frame_position_deviation: float = setting(
        0.0,
        'Standard deviation of the position error (x and y) common to one frame',
        unit='m',
        low=0.0,
        high=1.0,
    )
    frame_heading_deviation: float = setting(
        0.0,
        'Standard deviation of the heading error common to one frame',
        unit='rad',
        low=0.0,
        high=1.0,
    )

    def covariance(self) -> Array | None:
        """Return the covariance (3, 3) in the vehicle frame; None if there is no such error."""
        deviations = np.array(
            [
                self.frame_position_deviation,
                self.frame_position_deviation,
                self.frame_heading_deviation,
            ]
        )
        return np.diag(deviations**2) if deviations.all() else None

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.frame_position_deviation > 0.0) != (self.frame_heading_deviation > 0.0):
            raise ConfigError(
                f'frame_position_deviation is {self.frame_position_deviation} m and '
                f'frame_heading_deviation {self.frame_heading_deviation} rad, expected both to be '
                'zero or both above'
            )


@dataclass(frozen=True)
class CalibrationConfig(Section):
    """How systematic errors of wheel odometry are estimated while driving."""

    odometry_calibration: bool = setting(
        True,
        'Estimate scale errors and heading drift of the wheel odometry of every vehicle',
    )
    turn_scale_deviation: float = setting(
        0.1, 'Prior deviation of the scale error of turning', low=1e-6, high=1.0
    )
    distance_scale_deviation: float = setting(
        0.05, 'Prior deviation of the scale error of driving', low=1e-6, high=1.0
    )
    heading_drift_deviation: float = setting(
        0.05,
        'Prior deviation of the heading drift of wheels of unequal diameter',
        unit='rad/m',
        low=1e-6,
        high=1.0,
    )

    def deviations(self) -> Array:
        """Return the deviations (3,) of turn scale, distance scale and drift."""
        return np.array(
            [
                self.turn_scale_deviation,
                self.distance_scale_deviation,
                self.heading_drift_deviation,
            ]
        )


@dataclass(frozen=True)
class FastSlamConfig(Section):
    """Settings of the filter."""

    particles: int = setting(300, 'Number of particles', low=1, high=20_000, tier='basic')
    engine: str = setting(
        'fastslam2',
        'FastSLAM 2.0, or the algorithm of the paper to the letter',
        choices=('fastslam2', 'paper'),
        tier='basic',
    )
    maps: str = setting(
        'common',
        'One landmark map for all vehicles, or one filter and map per vehicle',
        choices=('common', 'dedicated'),
        tier='basic',
    )
    insertion_policy: str = setting(
        'always',
        'Where a vehicle inserts landmarks: always, or only where no other vehicle mapped first',
        choices=('always', 'unmapped_region'),
    )
    region_size: float = setting(
        1.0,
        'Side of the squares of insertion_policy unmapped_region',
        unit='m',
        low=0.1,
        high=20.0,
    )
    resampling_threshold: float = setting(
        0.5,
        'Engine fastslam2: resample below this effective sample size (fraction of the particles)',
        low=0.0,
        high=1.0,
    )
    outlier_threshold: float = setting(
        4.0,
        'Engine fastslam2: residual beyond which an observation loses weight',
        unit='sigma',
        low=1.0,
        high=20.0,
    )
    independent_observations: float = setting(
        15.0,  # as the graph counts them
        'Engine fastslam2: the observations of one update count as at most this many independent '
        'ones, because the features of one frame share errors',
        low=1.0,
        high=1e6,
    )
    linearizable_heading: float = setting(
        0.1,
        'Heading uncertainty of the motion beyond which headings are sampled before the update is '
        'linearized',
        unit='rad',
        low=0.01,
        high=1.0,
    )
    filter_threads: int = setting(
        2,
        'Threads among which the particles are divided; results do not depend on it',
        low=1,
        high=64,
        tier='basic',
    )
    inter_robot_observations: bool = setting(
        True,
        'Use relative positions that vehicles measure of each other (common maps only)',
        tier='basic',
    )
    joint_graph: bool = setting(
        True,
        'Draw the paths of all particles anew from the joint posterior when few ancestors are '
        'left (engine fastslam2)',
    )
    redraw_fraction: float = setting(
        0.2,
        'Redraw when the particles descend from less than this fraction of the latest samples',
        low=0.0,
        high=1.0,
    )
    redraw_ancestors: int = setting(
        50, 'Redraw when the particles descend from fewer samples than this', low=0, high=20_000
    )
    redraw_effective: float = setting(
        0.1,
        'Redraw when an update leaves less than this fraction of the particles effective',
        low=0.0,
        high=1.0,
    )
    async_redraw_threshold: int = setting(
        10_000,
        'Redraw in a background thread if the graph has more measurements than this; the samples '
        'are taken over at the next update. The default takes about 50 ms on one core '
        '(benchmarks/graph_speed.py); the simulated office has 5,000',
        low=0,
        high=10_000_000,
    )
    odometry_noise: OdometryNoise = section(OdometryNoise)
    calibration: CalibrationConfig = section(CalibrationConfig)
    correlation: CorrelationConfig = section(CorrelationConfig)
    frame_error: FrameErrorConfig = section(FrameErrorConfig)
    graph: GraphConfig = section(GraphConfig)
    association: AssociationConfig = section(AssociationConfig)
    existence: ExistenceConfig = section(ExistenceConfig)
    relocalization: RelocalizationConfig = section(RelocalizationConfig)
