"""Sections of the settings of exploration; ExplorationConfig gathers them."""

from dataclasses import dataclass

from explore_slam.settings import Section, setting

LARGEST_PLANNING_RADIUS = 5.0  # m


@dataclass(frozen=True)
class PathConfig(Section):
    """Where vehicles may drive, and what that costs."""

    planning_radius: float = setting(
        0.3,
        'Paths keep this distance between obstacles and the centre of a vehicle of radius 0.25 m; '
        'for others it differs as much as their vehicle_radius',
        unit='m',
        low=0.0,
        high=LARGEST_PLANNING_RADIUS,
        tier='basic',
    )
    minimum_planning_radius: float = setting(
        0.27,
        'Distance kept instead by a vehicle that is shut in at the planning radius; never less '
        'than its vehicle_radius and side_clearance',
        unit='m',
        low=0.0,
        high=LARGEST_PLANNING_RADIUS,
    )
    planning_margin: float = setting(
        0.05,
        'Distance beyond the planning radius that targets keep where there is room, for the '
        'errors of pose, tracking and cells',
        unit='m',
        low=0.0,
        high=1.0,
    )
    occ_max: float = setting(
        0.6,
        'Maximum probability of occupation of a cell that vehicles may enter (occmax of the '
        'paper, section V-A)',
        low=0.05,
        high=0.99,
    )
    cost_floor: float = setting(
        0.4,
        'Minimum probability charged for a cell, so that distance counts (not by strategy paper)',
        low=0.001,
        high=0.9,
    )
    clearance_distance: float = setting(
        0.4,
        'Cells within this distance beyond the planning radius of an obstacle cost extra',
        unit='m',
        low=0.0,
        high=5.0,
    )
    clearance_weight: float = setting(
        2.0,
        'Extra cost of a cell at the planning radius from an obstacle, as a multiple',
        low=0.0,
        high=50.0,
    )
    route_resolution: float = setting(
        0.3,
        'Side of the blocks of cells on which costs between targets are computed (not by '
        'strategy paper)',
        unit='m',
        low=0.01,
        high=2.0,
    )
    escape_distance: float = setting(
        1.0,
        'Distance within which a vehicle in a blocked cell starts from the nearest free cell',
        unit='m',
        low=0.0,
        high=10.0,
    )
    arrival_distance: float = setting(
        0.3,
        'Distance from its target at which a vehicle has arrived',
        unit='m',
        low=0.05,
        high=5.0,
    )


@dataclass(frozen=True)
class FrontierConfig(Section):
    """Which frontiers are worth visiting."""

    min_frontier_size: float = setting(
        0.4, 'Shorter frontiers are ignored', unit='m', low=0.0, high=20.0, tier='basic'
    )
    max_frontier_size: float = setting(
        3.0, 'Longer frontiers are split', unit='m', low=0.5, high=100.0
    )
    viewpoint_distance: float = setting(
        1.0,
        'Maximum distance between a frontier and the viewpoint from which it is seen',
        unit='m',
        low=0.0,
        high=10.0,
    )
    min_frontier_gain: float = setting(
        0.2,
        'Frontiers with less unknown area behind them are ignored',
        unit='m²',
        low=0.0,
        high=100.0,
    )
    min_gain_per_travel: float = setting(
        0.08,
        'Frontiers are left alone while they are expected to show less than this per metre of '
        'the way there; ways beyond 10 m count as 10 m',
        unit='m² per m',
        low=0.0,
        high=10.0,
    )
    min_unviewed_area: float = setting(
        2.0,
        'At the end, areas that a laser has seen but no depth camera has looked at are visited if '
        'they are at least this large: table tops and shelves may be there. 0: none is',
        unit='m²',
        low=0.0,
        high=1e6,
    )
    sensor_range: float = setting(
        8.0,
        'Range that the laser is expected to cover (max range of the paper, equation 9)',
        unit='m',
        low=0.5,
        high=100.0,
        tier='basic',
    )


@dataclass(frozen=True)
class AssignmentConfig(Section):
    """Parameters of the strategies that assign targets to vehicles."""

    travel_weight: float = setting(
        1.0, 'Weight beta of the cost against the utility (strategy paper)', low=0.001, high=100.0
    )
    hysteresis: float = setting(
        2.0,
        'Minimum saving in travel cost required to switch targets (strategies paper and nearest)',
        unit='m',
        low=0.0,
        high=100.0,
    )
    tour_hysteresis: float = setting(
        10.0,
        'Minimum cost reduction required to replace the current tours (hysteresis; strategy '
        'default)',
        unit='m',
        low=0.0,
        high=1000.0,
    )
    work_per_area: float = setting(
        0.3,
        'Travel expected to explore an unknown area (strategy default)',
        unit='m per m²',
        low=0.0,
        high=100.0,
    )
    waiting_weight: float = setting(
        0.5,
        'Weight of the mean travel until targets are reached against that of all tours '
        '(strategy default)',
        low=0.0,
        high=1000.0,
    )
    longest_weight: float = setting(
        3.0,
        'Weight of the longest tour against the sum of all (strategy default)',
        low=0.0,
        high=1000.0,
    )
    gain_per_detour: float = setting(
        0.3,
        'Unknown area per detour that makes a target worth visiting now (strategy default)',
        unit='m² per m',
        low=0.0,
        high=100.0,
    )
    merge_distance: float = setting(
        1.5,
        'Frontiers within this distance are one stop of a tour (strategy default)',
        unit='m',
        low=0.0,
        high=20.0,
    )
    overlap_weight: float = setting(
        20.0,
        'Penalty, as travel, for two targets with fully overlapping view (strategy default)',
        unit='m',
        low=0.0,
        high=1000.0,
    )
    exploration_seed: int = setting(0, 'Seed of the strategy random', low=0, high=2**31 - 1)


@dataclass(frozen=True)
class LoopConfig(Section):
    """When a vehicle whose map is in doubt goes back to a known place before it explores on.

    Reach and deviation were chosen with `explore_slam benchmark exploration --slam` on the looped
    building of benchmarks/exploration_maps.py, see doc/scenarios.md.
    """

    loop_seeking: bool = setting(
        False, 'Go back to known places to close loops, where that saves more than it costs'
    )
    loop_deviation: float = setting(
        0.3,
        'Known places are left alone while the standard deviation of their position relative to '
        'the vehicle is less: laser closures then need no agreement, and come by themselves',
        unit='m',
        low=0.0,
        high=100.0,
    )
    map_tolerance: float = setting(
        0.2,
        'Error of the map that makes it useless: doors of 1 m are closed to a planning radius of '
        '0.3 m',
        unit='m',
        low=0.01,
        high=100.0,
    )
    loop_reach: float = setting(
        10.0, 'Longest way back to a known place', unit='m', low=0.0, high=1000.0
    )


@dataclass(frozen=True)
class BlacklistConfig(Section):
    """When a target has failed, and how long it is left alone."""

    blacklist_radius: float = setting(
        0.5,
        'Targets within this distance of a failed one are blacklisted too',
        unit='m',
        low=0.0,
        high=10.0,
    )
    blacklist_expiry: float = setting(
        600.0,
        'Time until a failed target is tried again; doubles with every further failure',
        unit='s',
        low=0.0,
        high=86400.0,
    )
    maximum_attempts: int = setting(
        3,
        'Failures after which a target is given up until the map around it changes',
        low=1,
        high=100,
    )
    progress_timeout: float = setting(
        30.0,
        'A target has failed when its vehicle comes no nearer for this time',
        unit='s',
        low=1.0,
        high=3600.0,
    )


@dataclass(frozen=True)
class TrafficConfig(Section):
    """Right of way between vehicles."""

    vehicle_separation: float = setting(
        0.9,
        'Distance kept between the centres of two vehicles of radius 0.25 m; it grows and shrinks '
        'with their vehicle_radius',
        unit='m',
        low=0.0,
        high=10.0,
        tier='basic',
    )
    traffic_margin: float = setting(
        4.0,
        'Time between the passages of two vehicles through one place',
        unit='s',
        low=0.0,
        high=120.0,
    )
    traffic_horizon: float = setting(
        40.0, 'Time ahead for which conflicts are predicted', unit='s', low=1.0, high=600.0
    )
