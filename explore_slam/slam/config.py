"""Settings of the belief."""

from dataclasses import dataclass

from explore_slam.settings import Section, section, setting
from explore_slam.slam.particles.motion import OdometryNoise


@dataclass(frozen=True)
class AssociationConfig(Section):
    """How observations find their landmarks."""

    maximum_descriptor_distance: float = setting(
        0.4,
        'Largest squared descriptor distance of a match (E0 of the paper)',
        low=0.0,
        high=4.0,
    )
    minimum_association_probability: float = setting(
        0.9,
        'Least quality exp(-d²/2) of a match in engine paper (P0 of the paper)',
        low=0.0,
        high=1.0,
    )
    association_gate: float = setting(
        8.0,
        'Engine fastslam2: largest Mahalanobis distance between a match and its prediction',
        unit='sigma',
        low=1.0,
        high=20.0,
    )
    candidates_per_observation: int = setting(
        4, 'Landmarks compared by position for one observation', low=1, high=32
    )
    descriptor_index: str = setting(
        'forest',
        'How descriptors are looked up: randomized kd-forest, exact kd-tree, or all of them',
        choices=('forest', 'kd_tree', 'brute_force'),
    )
    forest_trees: int = setting(4, 'Trees of the randomized kd-forest', low=1, high=16)
    forest_checks: int = setting(
        256,
        'Descriptors compared per query of the forest; landmarks near an observation are all '
        'compared if they are no more than this',
        low=16,
        high=100_000,
    )
    maximum_observations: int = setting(
        1000, 'Most observations taken in one update', low=1, high=10_000
    )


@dataclass(frozen=True)
class ExistenceConfig(Section):
    """When a landmark that is not seen again is forgotten."""

    existence_hit: float = setting(
        1.0, 'Evidence gained by a landmark when it is matched', low=0.0, high=10.0
    )
    existence_miss: float = setting(
        0.2,
        'Evidence lost by a landmark that is in view, not hidden, and not matched',
        low=0.0,
        high=10.0,
    )
    existence_limit: float = setting(
        5.0, 'Most evidence a landmark can gather; it is removed below zero', low=1.0, high=100.0
    )


@dataclass(frozen=True)
class RelocalizationConfig(Section):
    """How a vehicle that all particles misplace is found again."""

    relocalization: bool = setting(
        True, 'Relocate a vehicle whose matches disagree with its pose in all particles'
    )
    relocalization_matches: int = setting(
        5, 'Least matches that must agree on the new pose', low=3, high=100
    )
    relocalization_window: int = setting(
        12, 'Updates of a vehicle that are searched together for its new pose', low=1, high=200
    )


@dataclass(frozen=True)
class FastSlamConfig(Section):
    """Settings of the belief: particles, engine, maps, association, existence and recovery."""

    particles: int = setting(500, 'Particles of the filter', low=1, high=20_000)
    engine: str = setting(
        'fastslam2',
        'FastSLAM 2.0, or the method of the paper to the letter',
        choices=('fastslam2', 'paper'),
    )
    maps: str = setting(
        'common',
        'One landmark map for all vehicles, or one filter and map for each',
        choices=('common', 'dedicated'),
    )
    insertion_policy: str = setting(
        'always',
        'Where a vehicle adds landmarks: always, or only where no other vehicle has mapped',
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
        'Resample when the effective particles drop below this part of all (engine fastslam2)',
        low=0.0,
        high=1.0,
    )
    shrinkage_threshold: float = setting(
        0.05,
        'Engine fastslam2: where an update would leave less than this part of the particles '
        'effective, the landmarks in view are smoothed over the particles',
        low=0.0,
        high=0.5,
    )
    outlier_threshold: float = setting(
        4.0,
        'Engine fastslam2: residuals beyond this lose influence',
        unit='sigma',
        low=1.0,
        high=20.0,
    )
    independent_observations: float = setting(
        20.0,
        'Engine fastslam2: the observations of one update weigh like at most this many '
        'independent ones, because features of one frame err together',
        low=1.0,
        high=1e6,
    )
    linearizable_heading: float = setting(
        0.1,
        'Heading uncertainty above which headings are sampled before the rest is linearized',
        unit='rad',
        low=0.01,
        high=1.0,
    )
    filter_threads: int = setting(
        2, 'Threads that share the particles; the result does not depend on it', low=1, high=64
    )
    inter_robot_observations: bool = setting(
        True, 'Use what vehicles see of each other (maps common only)'
    )
    odometry_noise: OdometryNoise = section(OdometryNoise)
    association: AssociationConfig = section(AssociationConfig)
    existence: ExistenceConfig = section(ExistenceConfig)
    relocalization: RelocalizationConfig = section(RelocalizationConfig)
