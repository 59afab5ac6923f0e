"""Settings of the occupancy grid and of scan matching."""

from dataclasses import dataclass

from explore_slam.settings import Section, setting


@dataclass(frozen=True)
class GridConfig(Section):
    """Sensor model and limits of the occupancy grid."""

    resolution: float = setting(
        0.05, 'Side of a grid cell', unit='m', low=0.01, high=1.0, tier='basic'
    )
    max_laser_range: float = setting(
        10.0,
        'Beams change the grid up to this range',
        unit='m',
        low=0.5,
        high=200.0,
        tier='basic',
    )
    no_return_range: float = setting(
        10.0,
        'Beams without return (+inf) free cells up to this range; reduce it where there is glass, '
        '0 ignores such beams',
        unit='m',
        low=0.0,
        high=200.0,
        tier='basic',
    )
    hit_probability: float = setting(
        0.7, 'Probability that a cell is occupied, given one beam that ends in it',
        low=0.51, high=0.99,
    )  # fmt: skip
    miss_probability: float = setting(
        0.4, 'Probability that a cell is occupied, given one beam that passes through it',
        low=0.01, high=0.49,
    )  # fmt: skip
    clamp_low: float = setting(
        0.03, 'Lower limit of the probability of a cell, so that it can still change',
        low=0.001, high=0.4,
    )  # fmt: skip
    clamp_high: float = setting(
        0.97, 'Upper limit of the probability of a cell, so that it can still change',
        low=0.6, high=0.999,
    )  # fmt: skip
    map_free_threshold: float = setting(
        0.45, 'Cells up to this probability are free in map files', low=0.05, high=0.5
    )
    map_occupied_threshold: float = setting(
        0.65, 'Cells from this probability on are occupied in map files', low=0.5, high=0.95
    )
    maximum_map_side: float = setting(
        500.0,
        'Largest side of the grid; scans beyond it are refused',
        unit='m',
        low=5.0,
        high=5000.0,
        tier='basic',
    )
    snapshot_memory: float = setting(
        256.0,
        'Memory for snapshots of the grid, from which redrawing starts',
        unit='MB',
        low=0.0,
        high=16384.0,
    )


@dataclass(frozen=True)
class ScanMatchingConfig(Section):
    """How a vehicle's odometry is refined by matching its scans with earlier ones."""

    scan_matching: bool = setting(
        True, 'Refine odometry by matching each scan with recent ones', tier='basic'
    )
    matching_range: float = setting(
        10.0, 'Returns farther than this are not matched', unit='m', low=0.5, high=200.0
    )
    matching_window: int = setting(
        120, 'Number of recent scans that a new one is matched with', unit='scans',
        low=1, high=1000,
    )  # fmt: skip
    matching_window_distance: float = setting(
        0.25, 'Minimum travel between scans of the matching window', unit='m', low=0.01, high=10.0
    )
    matching_window_heading: float = setting(
        0.25, 'Minimum change of heading between scans of the matching window', unit='rad',
        low=0.01, high=6.3,
    )  # fmt: skip
    max_correspondence_distance: float = setting(
        0.3, 'Largest distance between corresponding points, in the first iteration', unit='m',
        low=0.05, high=5.0,
    )  # fmt: skip
    point_to_line_deviation: float = setting(
        0.02, 'Standard deviation of a return from the wall it belongs to', unit='m',
        low=0.001, high=0.5,
    )  # fmt: skip
    matching_overlap: float = setting(
        0.4, 'Fraction of the returns of a scan that need a correspondence', low=0.0, high=1.0
    )
    matching_gate: float = setting(
        5.0, 'Mahalanobis distance up to which a match may differ from wheel odometry',
        unit='sigma', low=1.0, high=100.0,
    )  # fmt: skip
    matching_drift: float = setting(
        0.003, 'Fraction of the variance of wheel odometry that remains after a match',
        low=0.0, high=1.0,
    )  # fmt: skip
    scan_wait_timeout: float = setting(
        0.3,
        'Longest time for which measurements wait for the next scan, which refines the motion '
        'up to their stamp',
        unit='s',
        low=0.0,
        high=10.0,
    )
