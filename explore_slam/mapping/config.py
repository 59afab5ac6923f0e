"""Settings of the occupancy grid."""

from dataclasses import dataclass

from explore_slam.settings import Section, setting


@dataclass(frozen=True)
class GridConfig(Section):
    """How scans become a grid, and where the limits of the grid are."""

    resolution: float = setting(0.05, 'side of a grid cell', unit='m', low=0.01, high=1.0)
    max_laser_range: float = setting(
        10.0, 'a beam changes the grid up to this range at most', unit='m', low=0.5, high=200.0
    )
    no_return_range: float = setting(
        10.0,
        'a beam without return (+inf) frees cells up to this range; small where there is glass, '
        '0 to ignore such beams',
        unit='m',
        low=0.0,
        high=200.0,
    )
    hit_probability: float = setting(
        0.7, 'probability of a cell to be occupied after one hit', low=0.51, high=0.99
    )
    miss_probability: float = setting(
        0.4,
        'probability of a cell to be occupied after one beam went through',
        low=0.01,
        high=0.49,
    )
    clamp_low: float = setting(
        0.03, 'no cell becomes less probable than this', low=0.001, high=0.4
    )
    clamp_high: float = setting(
        0.97, 'no cell becomes more probable than this', low=0.6, high=0.999
    )
    map_free_threshold: float = setting(
        0.45, 'at most this probability is free in map files', low=0.05, high=0.5
    )
    map_occupied_threshold: float = setting(
        0.65, 'at least this probability is occupied in map files', low=0.5, high=0.95
    )
    maximum_map_side: float = setting(
        500.0, 'a grid that would grow beyond this side is refused', unit='m', low=5.0, high=5000.0
    )
    snapshot_memory: float = setting(
        256.0,
        'memory for snapshots of the grid from which a redraw starts',
        unit='MB',
        low=0.0,
        high=16384.0,
    )


@dataclass(frozen=True)
class ScanMatchingConfig(Section):
    """How a vehicle's motion is refined by laying its scans onto each other."""

    scan_matching: bool = setting(
        True, 'Refine odometry by matching each scan with those of the way just driven'
    )
    matching_range: float = setting(
        10.0, 'returns farther than this are left out', unit='m', low=0.5, high=200.0
    )
    matching_window: int = setting(
        120, 'scans that a new one is matched with', unit='scans', low=1, high=1000
    )
    window_distance: float = setting(
        0.25, 'a scan enters the window after this way', unit='m', low=0.01, high=10.0
    )
    window_heading: float = setting(
        0.25, 'a scan enters the window after this turn', unit='rad', low=0.01, high=6.3
    )
    matching_reach: float = setting(
        0.3, 'farthest that a return may lie from its wall at first', unit='m', low=0.05, high=5.0
    )
    matching_deviation: float = setting(
        0.02, 'standard deviation of a return from its wall', unit='m', low=0.001, high=0.5
    )
    matching_overlap: float = setting(
        0.4, 'least part of a scan that must lie on known walls', low=0.0, high=1.0
    )
    matching_gate: float = setting(
        5.0, 'most that a match may differ from the wheels', unit='sigma', low=1.0, high=100.0
    )
    matching_drift: float = setting(
        0.003, "part of the wheels' variance that stays after a match", low=0.0, high=1.0
    )
    matching_patience: float = setting(
        0.3,
        'frames wait for the next scan this long, so that the motion up to them is known',
        unit='s',
        low=0.0,
        high=10.0,
    )
