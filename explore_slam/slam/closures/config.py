"""Settings of loop closing by laser."""

from dataclasses import dataclass

from explore_slam.settings import Section, setting


@dataclass(frozen=True)
class ClosureConfig(Section):
    """Loop closing by laser.

    Values were chosen on the logs Intel, ACES and Belgioioso; `benchmarks/laser_graph_slam.py`
    shows what a change does.
    """

    laser_closures: bool = setting(True, 'Close loops by laser, within and between vehicles')
    closure_every: int = setting(
        2, 'Loops are searched at every n-th anchor of a vehicle', low=1, high=100
    )
    closure_minimum_distance: float = setting(
        10.0,
        'Minimum distance driven since anchors of the same vehicle',
        unit='m',
        low=1.0,
        high=1000.0,
    )
    closure_delay: float = setting(
        5.0,
        'Minimum time difference to anchors of another vehicle nearby, which may be in the scans',
        unit='s',
        low=0.0,
        high=3600.0,
    )
    closure_widest_window: float = setting(
        25.0, 'Maximum half width of the search window', unit='m', low=0.5, high=100.0
    )
    closure_score: float = setting(
        0.45, 'Minimum mean likelihood of the returns of a closure', low=0.0, high=1.0
    )
    closure_overlap: float = setting(
        0.75, 'Minimum fraction of the returns that must lie on known surfaces', low=0.0, high=1.0
    )
    closure_rms: float = setting(
        0.05,
        'Maximum root mean square distance of the returns from the surfaces',
        unit='m',
        low=0.001,
        high=1.0,
    )
    closure_other_mode: float = setting(
        0.92,
        'Reject a closure as ambiguous if another pose scores at least this fraction of its score',
        low=0.0,
        high=1.0,
    )
    closure_agreements: int = setting(
        3, 'Candidates that must agree where the search window was wide', low=1, high=20
    )
