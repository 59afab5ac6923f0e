"""Settings of the occupancy grid."""

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
    no_return_meaning: str = setting(
        'auto',
        'Whether beams without return (+inf) passed through free space or measured nothing; auto: '
        'as the other ranges of the same laser suggest',
        choices=('auto', 'free', 'nothing'),
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
        0.45,
        'Cells up to this probability are free on the topic map and in map files',
        low=0.05,
        high=0.5,
    )
    map_occupied_threshold: float = setting(
        0.65,
        'Cells from this probability on are occupied on the topic map and in map files',
        low=0.5,
        high=0.95,
    )
    maximum_map_side: float = setting(
        500.0,
        'Maximum side of the grid; scans beyond it are refused',
        unit='m',
        low=5.0,
        high=5000.0,
    )
    snapshot_memory: float = setting(
        256.0,
        'Memory for snapshots of the grid, from which redrawing starts',
        unit='MB',
        low=0.0,
        high=16384.0,
    )
