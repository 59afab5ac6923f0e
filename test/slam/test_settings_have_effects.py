"""Every setting of the filter changes what comes out; a new one without a test fails here."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pytest

from explore_slam.data import InterRobotObservation, LandmarkObservations
from explore_slam.errors import SlamError
from explore_slam.geometry import Pose2
from explore_slam.settings import settings_of, with_values
from explore_slam.slam import FastSlam, FastSlamConfig, RelativePose, TeamBelief

STARTS = {'a': Pose2(1.0, 1.0, 0.0), 'b': Pose2(5.0, 4.0, 1.0)}
USUAL: dict[str, Any] = {'particles': 100}
STILL = Pose2(0.0, 0.0, 0.0)


@pytest.fixture
def world_of(make_world):
    """Return a function that makes a small world with two vehicles at their start poses."""

    def make(**options):
        world = make_world(**options)
        world.start(**STARTS)
        return world

    return make


# -- experiments: from a world and settings to something that can be compared ---------------------


def belief_of(team, summaries=()):
    """Everything that a belief says of poses and landmarks, and what its updates did."""
    landmarks = team.landmarks()
    poses = [team.particle_poses(vehicle).tobytes() for vehicle in team.vehicles]
    done = [(s.associated, s.inserted, len(s.matches), s.relocated) for s in summaries]
    return poses, team.best_path().tobytes(), landmarks.means.tobytes(), len(landmarks), done


def blurred(seen, random, deviation):
    """Observations whose descriptors differ from view to view."""
    rows = seen.descriptors + deviation * random.standard_normal(seen.descriptors.shape)
    rows = (rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float32)
    return LandmarkObservations(seen.stamp, seen.positions, seen.covariances, rows)


def drive(
    world_of,
    config,
    steps=18,
    blur=0.0,
    outliers=0,
    slanted=False,
    kinds=0,
    meet=False,
    lift_at=-1,
    **options,
):
    """Drive two vehicles in circles by wheel odometry.

    blur: of the descriptors. outliers: observations of each update that are 1 m off.
    slanted: errors of height and distance are correlated. kinds: number of different descriptors,
    0: one per landmark. meet: one vehicle observes the other. lift_at: step at which a vehicle is
    carried elsewhere.
    """
    world = world_of(**options)
    if kinds:
        world.descriptors = world.descriptors[np.arange(len(world.points)) % kinds]
    team, summaries = TeamBelief(STARTS, config, seed=1), []
    random = np.random.default_rng(5)
    for step in range(steps):
        if step == lift_at:
            world.true['a'] = Pose2(3.0, 3.5, 2.0)
        for name, turn in (('a', 0.3), ('b', -0.3)):
            increment = Pose2(0.4, 0.0, turn)
            world.drive(name, increment)
            team.predict(name, increment)
            seen = world.see(name, float(step))
            if blur:
                seen = blurred(seen, random, blur)
            seen.positions[:outliers, 0] += 1.0
            if slanted:
                seen.covariances[:, 0, 2] = seen.covariances[:, 2, 0] = 0.8 * world.deviation**2
            if len(seen):
                summaries.append(team.update(name, seen))
            team.add_keyframe(name, float(step))
        if meet:
            between = world.true['a'].between(world.true['b'])
            position = np.array(between[:2]) + 0.02 * random.standard_normal(2)
            record = InterRobotObservation(float(step), 'b', position, 4e-4 * np.eye(2))
            team.update_inter_robot('a', [record])
    return belief_of(team, summaries)


def close_a_loop(_world_of, config):
    """Close a loop that contradicts the odometry of the lap."""
    slam = FastSlam({'a': STARTS['a']}, config, seed=1)
    numbers = [slam.add_keyframe('a', 0.0)]
    slam.pin(numbers[0])
    for step in range(1, 13):
        slam.predict('a', Pose2(0.4, 0.0, np.pi / 6))
        numbers.append(slam.add_keyframe('a', float(step)))
    slam.pin(numbers[-1])
    for _ in range(2):  # robust from the second optimization on
        closure = RelativePose(numbers[0], numbers[-1], Pose2(2.0, 0.5, 0.2), 1e4 * np.eye(3))
        slam.close_loops([closure])
        slam.redraw([0])
    return slam.best_path().tobytes()


def graph_of(world_of, config, steps=70):
    """Keyframes that are left in the joint graph after three laps, and the path."""
    world = world_of()
    slam = FastSlam({'a': STARTS['a']}, config, seed=1)
    for step in range(steps):
        world.drive('a', Pose2(0.4, 0.0, 0.3))
        slam.predict('a', Pose2(0.4, 0.0, 0.3))
        slam.update('a', world.see('a', float(step)))
    slam.redraw([0])
    return slam.joint.graph.live_keyframes().tolist(), slam.particle_poses('a').tobytes()


def sift_is_accepted(world_of, config):
    slam = FastSlam(STARTS, config)
    slam.predict('a', STILL)
    try:
        slam.update('a', world_of().see('a', 0.0))
    except SlamError as error:
        return str(error)
    return 'accepted'


def parts_on_other_threads(world_of, config):
    """How many parts of the updates run on other threads; the result is the same."""
    submitted = []
    real = ThreadPoolExecutor.submit

    def submit(self, *arguments, **values):
        submitted.append(arguments[0])
        return real(self, *arguments, **values)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ThreadPoolExecutor, 'submit', submit)
        drive(world_of, with_values(config, {'particles': 256}), steps=2)
    return len(submitted)


def ghosts_left(_world_of, config):
    """How many of the landmarks exist after updates in which one is not observed again."""
    wall = np.array([[5.0, y, z] for y in np.linspace(-1.0, 1.0, 9) for z in (0.2, 0.45, 0.7)])
    places = np.vstack([[4.0, 0.0, 0.45], [1.5, 0.1, 0.1], wall])
    slam, left = FastSlam({'a': STILL}, config), []
    slam.predict('a', STILL, np.zeros((3, 3)))
    for stamp in range(40):
        first = 0 if stamp < 8 else 1  # the ghost is observed for a while
        kept = places[first:]
        slam.update(
            'a',
            LandmarkObservations(
                float(stamp),
                kept,
                np.tile(1e-4 * np.eye(3), (len(kept), 1, 1)),
                np.eye(128, dtype=np.float32)[first : first + len(kept)],
            ),
        )
        left.append(len(slam.landmarks()))
    return left


def crowded(world_of, config):
    """Drive among so many landmarks, with descriptors so similar, that the index is searched."""
    return drive(world_of, config, steps=3, blur=0.03, landmarks=1200)


class Effect(NamedTuple):
    """A value that changes what comes out of an experiment; base: what else differs from USUAL."""

    value: Any
    experiment: Callable[..., Any]
    base: dict[str, Any] | None = None

    def usual(self) -> FastSlamConfig:
        return with_values(FastSlamConfig(), USUAL | (self.base or {}))


OUTLIERS = partial(drive, outliers=3)
LIFTED = partial(drive, steps=40, lift_at=12)
SHAKEN = {'frame_position_deviation': 0.02, 'frame_heading_deviation': 0.02}
REGIONS = {'region_size': 4.0}

# -- one line per setting -------------------------------------------------------------------------

EFFECTS: dict[str, Effect] = {
    'particles': Effect(50, drive),
    'engine': Effect('paper', drive),
    'maps': Effect('dedicated', drive),
    'insertion_policy': Effect('unmapped_region', drive, REGIONS),
    'region_size': Effect(4.0, drive, {'insertion_policy': 'unmapped_region'}),
    'resampling_threshold': Effect(0.95, drive),
    'outlier_threshold': Effect(2.0, OUTLIERS),
    'independent_observations': Effect(2.0, drive),
    'linearizable_heading': Effect(0.01, drive),
    'filter_threads': Effect(1, parts_on_other_threads),
    'inter_robot_observations': Effect(False, partial(drive, meet=True)),
    'joint_graph': Effect(False, drive),
    'redraw_fraction': Effect(0.9, drive, {'redraw_ancestors': 0}),
    'redraw_ancestors': Effect(0, drive, {'redraw_fraction': 0.0}),
    'redraw_effective': Effect(1.0, drive),
    'async_redraw_threshold': Effect(0, drive),
    'forward_variance_per_metre': Effect(0.02, drive),
    'lateral_variance_per_metre': Effect(0.005, drive),
    'position_variance_per_radian': Effect(0.002, drive),
    'heading_variance_per_metre': Effect(0.02, drive),
    'heading_variance_per_radian': Effect(0.05, drive),
    'odometry_calibration': Effect(False, drive),
    'turn_scale_deviation': Effect(0.5, drive),
    'distance_scale_deviation': Effect(0.5, drive),
    'heading_drift_deviation': Effect(0.5, drive),
    'correlated_observations': Effect(False, drive),
    'correlation_distance': Effect(3.0, drive),
    'correlation_turn': Effect(5.0, drive),
    'correlation_time': Effect(1.0, drive),
    'frame_position_deviation': Effect(0.1, drive, SHAKEN),
    'frame_heading_deviation': Effect(0.1, drive, SHAKEN),
    'graph_independent_observations': Effect(2.0, drive),
    'graph_outlier_threshold': Effect(1.0, OUTLIERS),
    'closure_scale': Effect(100.0, close_a_loop),
    'graph_minimum_observations': Effect(4, drive),
    'graph_observations_per_keyframe': Effect(3, drive),
    'graph_landmark_heights': Effect(False, partial(drive, slanted=True)),
    'graph_iterations': Effect(1, OUTLIERS),
    'graph_tolerance': Effect(10.0, OUTLIERS),
    'graph_bounded': Effect(False, graph_of),
    'graph_recent_keyframes': Effect(20, graph_of),
    'graph_recent_observations': Effect(10000, graph_of),
    'graph_visit_gap': Effect(2, graph_of),
    'graph_visits': Effect(1, graph_of),
    'graph_visit_observations': Effect(6, graph_of),
    'graph_needed_fraction': Effect(0.9, graph_of),
    'descriptor_kind': Effect('orb', sift_is_accepted),
    'maximum_descriptor_distance': Effect(0.1, partial(drive, blur=0.03)),
    'minimum_association_probability': Effect(0.1, drive, {'engine': 'paper'}),
    'association_gate': Effect(1.0, OUTLIERS),
    'candidates_per_observation': Effect(1, partial(drive, kinds=6, blur=0.02)),
    'descriptor_index': Effect('brute_force', crowded, {'forest_checks': 16}),
    'forest_checks': Effect(16, crowded),
    'maximum_observations': Effect(1, sift_is_accepted),
    'existence_miss': Effect(1.0, ghosts_left),
    'existence_limit': Effect(2.0, ghosts_left),
    'landmark_cell': Effect(4.0, crowded),
    'landmarks_per_cell': Effect(1, crowded),
    'relocalization': Effect(False, LIFTED),
    'relocalization_matches': Effect(100, LIFTED),
    'relocalization_window': Effect(3, LIFTED),
}

NAMES = [info.name for info, _ in settings_of(FastSlamConfig())]


@pytest.fixture(scope='module')
def outcomes():
    """Outcomes with usual settings, which many effects are compared with."""
    return {}


@pytest.mark.parametrize('name', NAMES)
def test_every_setting_changes_what_comes_out(name, world_of, outcomes):
    effect = EFFECTS[name]
    usual = effect.usual()
    key = effect.experiment, usual
    if key not in outcomes:
        outcomes[key] = effect.experiment(world_of, usual)
    changed = effect.experiment(world_of, with_values(usual, {name: effect.value}))
    assert changed != outcomes[key]


@pytest.mark.parametrize(
    'experiment', [drive, close_a_loop, graph_of, parts_on_other_threads, ghosts_left, crowded]
)
def test_the_same_settings_give_the_same(experiment, world_of):
    usual = with_values(FastSlamConfig(), USUAL)
    assert experiment(world_of, usual) == experiment(world_of, usual)


def test_no_effect_is_listed_for_a_setting_that_does_not_exist():
    assert sorted(EFFECTS) == sorted(NAMES)
