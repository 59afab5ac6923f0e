"""Settings of the search for the next targets and of the paths to them."""

from dataclasses import dataclass

from explore_slam.settings import Section, section, setting


@dataclass(frozen=True)
class PathConfig(Section):
    """Where a vehicle may drive and what that costs."""

    vehicle_radius: float = setting(
        0.3, 'no path comes nearer to an obstacle than this', unit='m', low=0.0, high=5.0
    )
    tight_radius: float = setting(
        0.2,
        'a vehicle that sees no other way out passes obstacles at this distance, if it can',
        unit='m',
        low=0.0,
        high=5.0,
    )
    occ_max: float = setting(
        0.6, 'cells more probable than this are obstacles (section V-A)', low=0.05, high=0.99
    )
    cost_floor: float = setting(
        0.4,
        'least probability charged for a cell (not by strategy paper), so that distance counts',
        low=0.001,
        high=0.9,
    )
    clearance_distance: float = setting(
        0.4,
        'up to this beyond vehicle_radius being near to an obstacle costs extra',
        unit='m',
        low=0.0,
        high=5.0,
    )
    clearance_weight: float = setting(
        2.0,
        'extra cost of a cell that vehicle_radius just clears, in multiples',
        low=0.0,
        high=50.0,
    )
    route_resolution: float = setting(
        0.3,
        'side of the blocks on which costs between targets are computed (not by paper)',
        unit='m',
        low=0.01,
        high=2.0,
    )
    escape_distance: float = setting(
        1.0,
        'a vehicle in a blocked cell may start from the nearest free cell up to this far',
        unit='m',
        low=0.0,
        high=10.0,
    )
    goal_tolerance: float = setting(
        0.3, 'a vehicle this near to its target has reached it', unit='m', low=0.05, high=5.0
    )


@dataclass(frozen=True)
class FrontierConfig(Section):
    """What is worth going to."""

    min_frontier_size: float = setting(
        0.4, 'shorter frontiers are left alone', unit='m', low=0.0, high=20.0
    )
    max_frontier_size: float = setting(
        3.0, 'longer frontiers are split', unit='m', low=0.5, high=100.0
    )
    frontier_reach: float = setting(
        1.0,
        'a frontier is looked into from a place up to this far from it',
        unit='m',
        low=0.0,
        high=10.0,
    )
    min_frontier_gain: float = setting(
        0.2,
        'frontiers with less unknown area behind them are left alone',
        unit='m²',
        low=0.0,
        high=100.0,
    )
    sensor_range: float = setting(
        8.0,
        'range that the laser is expected to cover (max_range of equation 9)',
        unit='m',
        low=0.5,
        high=100.0,
    )


@dataclass(frozen=True)
class AssignmentConfig(Section):
    """Who goes where."""

    strategy: str = setting(
        'default', 'how targets are chosen', choices=('default', 'paper', 'nearest', 'random')
    )
    travel_weight: float = setting(
        1.0, 'weight beta of the cost against the utility (strategy paper)', low=0.001, high=100.0
    )
    hysteresis: float = setting(
        2.0, 'another target must be better by this much travel', unit='m', low=0.0, high=100.0
    )
    tour_hysteresis: float = setting(
        10.0, 'other tours must cost the team less by this much', unit='m', low=0.0, high=1000.0
    )
    work_per_area: float = setting(
        0.3,
        'travel that seeing an unknown area is expected to take',
        unit='m per m²',
        low=0.0,
        high=100.0,
    )
    last_bonus: float = setting(
        0.0, 'travel saved if a tour ends at an unknown area', unit='m per m²', low=0.0, high=100.0
    )
    waiting_weight: float = setting(
        0.5,
        'weight of the travel until targets are reached, on average, against that of all tours',
        low=0.0,
        high=1000.0,
    )
    urgency_floor: float = setting(
        2.0,
        'every target is as urgent as if it showed so much more',
        unit='m²',
        low=0.01,
        high=1000.0,
    )
    urgent_gain: float = setting(
        20.0, 'larger unknown areas are no more urgent than this', unit='m²', low=0.0, high=1000.0
    )
    largest_gain: float = setting(
        60.0, 'larger unknown areas count as so large', unit='m²', low=0.0, high=10000.0
    )
    longest_weight: float = setting(
        3.0, 'weight of the longest tour against the sum of all', low=0.0, high=1000.0
    )
    gain_per_detour: float = setting(
        0.3,
        'unknown area per length of detour that makes a target worth it now',
        unit='m² per m',
        low=0.0,
        high=100.0,
    )
    merge_distance: float = setting(
        1.5,
        'frontiers this near to each other are one stop of a tour',
        unit='m',
        low=0.0,
        high=20.0,
    )
    most_nodes: int = setting(60, 'so many stops are planned ahead at most', low=1, high=200)
    overlap_weight: float = setting(
        20.0,
        'travel that avoiding two vehicles at one place is worth',
        unit='m',
        low=0.0,
        high=1000.0,
    )
    exploration_seed: int = setting(0, 'seed of the strategy random', low=0, high=2**31 - 1)


@dataclass(frozen=True)
class BlacklistConfig(Section):
    """Targets that did not work out."""

    blacklist_radius: float = setting(
        0.5, 'targets this near to a failed one are left alone too', unit='m', low=0.0, high=10.0
    )
    blacklist_expiry: float = setting(
        600.0,
        'a failed target is tried again after this; doubled at every further failure',
        unit='s',
        low=0.0,
        high=86400.0,
    )
    maximum_attempts: int = setting(
        3,
        'a target that failed this often is given up until the map around it changes',
        low=1,
        high=100,
    )
    progress_timeout: float = setting(
        30.0,
        'a vehicle that comes no nearer to its target for so long has failed',
        unit='s',
        low=1.0,
        high=3600.0,
    )


@dataclass(frozen=True)
class TrafficConfig(Section):
    """Right of way between vehicles."""

    vehicle_separation: float = setting(
        0.9, 'two vehicles keep their centers this far apart', unit='m', low=0.0, high=10.0
    )
    nominal_speed: float = setting(
        0.4, 'speed that is expected of a vehicle on its path', unit='m/s', low=0.01, high=5.0
    )
    traffic_margin: float = setting(
        4.0,
        'two vehicles pass a place at least this long one after the other',
        unit='s',
        low=0.0,
        high=120.0,
    )
    traffic_horizon: float = setting(
        40.0, 'conflicts are looked for this far ahead', unit='s', low=1.0, high=600.0
    )


@dataclass(frozen=True)
class ExplorationConfig(Section):
    """All settings of the room."""

    paths: PathConfig = section(PathConfig)
    frontiers: FrontierConfig = section(FrontierConfig)
    assignment: AssignmentConfig = section(AssignmentConfig)
    blacklist: BlacklistConfig = section(BlacklistConfig)
    traffic: TrafficConfig = section(TrafficConfig)
    empty_searches: int = setting(
        3, 'so many searches without a target, one after the other, mean done', low=1, high=1000
    )
    return_to_init: bool = setting(False, 'drive home when there is nothing left to explore')
