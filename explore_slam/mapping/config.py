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
