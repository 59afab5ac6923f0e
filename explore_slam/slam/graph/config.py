"""Settings of the joint graph."""

from dataclasses import dataclass

from explore_slam.settings import Section, setting


@dataclass(frozen=True)
class GraphConfig(Section):
    """Settings of the joint graph: robust kernels, selection of landmarks, solver and bounds.

    Unless stated otherwise, values were chosen on crossing loops with the noise of table I of the
    paper (`benchmarks/graph_speed.py study`) and in closed-loop runs in the simulated office
    (`explore_slam benchmark consistency`).
    """

    graph_independent_observations: float = setting(
        # Across the ray, 53 features are worth 23 (benchmarks/noise_camera.py --office 60), and 20
        # to 40 that keyframes of Willow Garage have in common 13 to 16. In closed loops in the
        # office, one run of ten left its bounds with 20 (seed 4).
        15.0,
        'Landmark observations of one keyframe count as at most this many independent '
        'observations, because errors of neighbouring features are correlated',
        low=1.0,
        high=1e6,
    )
    graph_outlier_threshold: float = setting(
        4.0,
        'Landmark and inter-robot residuals beyond this are downweighted (Huber)',
        unit='sigma',
        low=1.0,
        high=20.0,
    )
    closure_scale: float = setting(
        2.385,
        'Scale of the Cauchy kernel on relative poses that loop closing measured; the default has '
        '95 % efficiency for normal errors (Holland and Welsch 1977)',
        unit='sigma',
        low=0.1,
        high=100.0,
    )
    graph_minimum_observations: int = setting(
        2,
        'Landmarks with fewer stored observations are not included in the graph as variables',
        low=2,
        high=100,
    )
    graph_observations_per_keyframe: int = setting(
        15,
        'Landmarks are variables of the graph if they are among this many most observed ones of a '
        'keyframe, or of those that it shares with the keyframe before it',
        low=1,
        high=1000,
    )
    graph_landmark_heights: bool = setting(
        True,
        'Use the correlation of height and range errors of landmarks. More accurate where the '
        'noise is known exactly, overconfident where ranges are biased',
    )
    graph_iterations: int = setting(
        20, 'Maximum number of Gauss-Newton iterations of one optimization', low=1, high=1000
    )
    graph_tolerance: float = setting(
        1e-4,
        'An optimization ends when the next step would lower the sum of squared Mahalanobis '
        'distances by less than this',
        low=0.0,
        high=10.0,
    )
    graph_bounded: bool = setting(
        True, 'Drop keyframes that add little, so that the graph grows with the area and not time'
    )
    graph_recent_keyframes: int = setting(
        8, 'Newest keyframes of each vehicle that are never dropped', low=1, high=1000
    )
    graph_recent_observations: int = setting(
        40,
        'A keyframe with observations is not dropped before newer ones of the vehicle have this '
        'many: where few landmarks are seen, the current pose depends on it',
        low=0,
        high=10000,
    )
    graph_visit_gap: int = setting(
        10,
        'A visit of a landmark ends when the vehicle has not observed it for this many keyframes',
        low=1,
        high=1000,
    )
    graph_visits: int = setting(
        3, 'Visits of a landmark by each vehicle of which observations are kept', low=1, high=100
    )
    graph_visit_observations: int = setting(
        3, 'Observations of a landmark that are kept of each visit', low=1, high=100
    )
    graph_needed_fraction: float = setting(
        0.125,
        'A keyframe stays if it has more than this fraction of landmarks of which observations or '
        'visits are missing',
        low=0.0,
        high=1.0,
    )
