"""Settings of scan matching."""

from dataclasses import dataclass

from explore_slam.settings import Section, setting


@dataclass(frozen=True)
class ScanMatchingConfig(Section):
    """How a vehicle's odometry is refined by matching its scans."""

    scan_matching: bool = setting(
        True, 'Refine odometry by matching each scan with the last scans of the same vehicle'
    )
    matching_range: float = setting(
        40.0, 'Returns beyond this range are not matched', unit='m', low=0.5, high=200.0
    )
    matching_window: int = setting(
        30, 'Number of kept scans that a new scan is matched with', unit='scans', low=1, high=200
    )
    matching_window_distance: float = setting(
        0.2, 'Minimum travel between the scans that are kept', unit='m', low=0.01, high=10.0
    )
    matching_window_heading: float = setting(
        0.2,
        'Minimum change of heading between the scans that are kept',
        unit='rad',
        low=0.01,
        high=6.3,
    )
    matching_overlap: float = setting(
        0.35, 'Minimum fraction of the returns that must lie on known surfaces', low=0.05, high=1.0
    )
    scan_wait_timeout: float = setting(
        0.3,
        'Maximum time that a frame waits for the next scan, which refines the motion up to it',
        unit='s',
        low=0.0,
        high=10.0,
    )
