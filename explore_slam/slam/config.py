"""Settings of the filter."""

from dataclasses import dataclass

from explore_slam.settings import Section, section, setting
from explore_slam.slam.descriptors.kinds import KINDS, kind_named
from explore_slam.slam.particles.motion import OdometryNoise


@dataclass(frozen=True)
class AssociationConfig(Section):
    """Data association: which landmark an observation is."""

    descriptor_kind: str = setting(
        'sift', f'Kind of the landmark descriptors: {", ".join(KINDS)}', tier='basic'
    )
    maximum_descriptor_distance: float = setting(
        0.4,
        'Largest squared descriptor distance of a match (E0 of the paper), of unit vectors; for '
        'binary descriptors 4 h / B at a Hamming distance of h of B bits',
        low=0.0,
        high=4.0,
    )
    minimum_association_probability: float = setting(
        0.9,
        'Engine paper: least association probability exp(-d²/2) of a match (P0 of the paper)',
        low=0.0,
        high=1.0,
    )
    association_gate: float = setting(
        8.0,
        'Engine fastslam2: largest Mahalanobis distance of a match',
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
        1000, 'Largest number of observations in one update', low=1, high=10_000
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
        5.0, 'Largest evidence of a landmark; it is removed below zero', low=1.0, high=100.0
    )


@dataclass(frozen=True)
class RelocalizationConfig(Section):
    """Relocalization of a lost vehicle."""

    relocalization: bool = setting(
        True,
        'Search for the pose of a vehicle whose matches contradict it in nearly all particles',
        tier='basic',
    )
    relocalization_matches: int = setting(
        5, 'Least number of matches that must agree on the new pose', low=3, high=100
    )
    relocalization_window: int = setting(
        12, 'Updates of a vehicle whose matches are used together', low=1, high=200
    )


@dataclass(frozen=True)
class FastSlamConfig(Section):
    """Settings of the filter."""

    particles: int = setting(500, 'Number of particles', low=1, high=20_000, tier='basic')
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
        'Engine fastslam2: resample below this effective sample size, as part of all particles',
        low=0.0,
        high=1.0,
    )
    shrinkage_threshold: float = setting(
        0.05,
        'Engine fastslam2: if an update left a smaller part of the particles effective, the '
        'observed landmarks are shrunk towards their mean over the particles first',
        low=0.0,
        high=0.5,
    )
    outlier_threshold: float = setting(
        4.0,
        'Engine fastslam2: residual beyond which an observation loses weight',
        unit='sigma',
        low=1.0,
        high=20.0,
    )
    independent_observations: float = setting(
        20.0,
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
    odometry_noise: OdometryNoise = section(OdometryNoise)
    association: AssociationConfig = section(AssociationConfig)
    existence: ExistenceConfig = section(ExistenceConfig)
    relocalization: RelocalizationConfig = section(RelocalizationConfig)
