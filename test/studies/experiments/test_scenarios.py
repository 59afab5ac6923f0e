"""Scenarios of experiment 1: paths, noise of table I, observations."""

import itertools
import math

import numpy as np
import pytest

from explore_slam.errors import EvaluationError
from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.studies.experiments.scenarios import (
    PATHS,
    Noise,
    draw_scenario,
    from_polar,
    observe,
    path_poses,
    unique_descriptors,
)


@pytest.mark.parametrize(('name', 'steps'), [('crossing', 28), ('separate', 16)])
def test_paths_have_the_steps_of_the_paper(name, steps):
    for corners in PATHS[name].values():
        poses = path_poses(corners)
        assert len(poses) == steps + 1
        ways = [math.hypot(a.between(b).x, a.between(b).y) for a, b in itertools.pairwise(poses)]
        np.testing.assert_allclose(ways, 0.5)


def test_same_seed_same_scenario():
    one, two, other = (draw_scenario('crossing', seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(one.landmarks, two.landmarks)
    for a, b in zip(one.steps, two.steps, strict=True):
        assert a.true_pose == b.true_pose
        np.testing.assert_array_equal(a.observations.positions, b.observations.positions)
    assert not np.array_equal(one.landmarks, other.landmarks)


def test_unknown_scenario_is_refused():
    with pytest.raises(EvaluationError, match='sideways'):
        draw_scenario('sideways', 0)


def test_separate_paths_share_no_landmark():
    for seed in range(5):
        scenario = draw_scenario('separate', seed)
        seen = {
            name: {int(n) for s in scenario.steps if s.vehicle == name for n in s.identities}
            for name in scenario.start_poses
        }
        assert not seen['robot1'] & seen['robot2']


def test_crossing_paths_share_landmarks():
    scenario = draw_scenario('crossing', 0)
    seen = [
        {int(n) for s in scenario.steps if s.vehicle == name for n in s.identities}
        for name in scenario.start_poses
    ]
    assert len(seen[0] & seen[1]) >= 5


def test_motion_noise_is_that_of_table_one():
    covariance = Noise(sigma=0.5).motion_covariance(Pose2(0.5, 0.0, 0.0))
    assert math.sqrt(covariance[0, 0]) == pytest.approx(0.0125)
    assert math.sqrt(covariance[2, 2]) == pytest.approx(1.5 * math.pi / 180.0)
    assert covariance[1, 1] < 1e-3 * covariance[0, 0]
    sideways = Noise(sigma=0.5).motion_covariance(Pose2(0.0, 0.5, 0.0))
    assert sideways[1, 1] == pytest.approx(covariance[0, 0])


def test_drawn_noise_has_the_published_covariance():
    apart = []
    for seed in range(200):
        scenario = draw_scenario('separate', seed)
        pose = dict(scenario.start_poses)
        for step in scenario.steps[:8]:
            moved = pose[step.vehicle].between(step.true_pose)
            if abs(step.increment.theta) < 1e-9:
                apart.append(np.subtract(moved, step.increment))
            pose[step.vehicle] = step.true_pose
    expected = Noise().motion_covariance(Pose2(0.5, 0.0, 0.0))
    assert np.std([a[0] for a in apart]) == pytest.approx(math.sqrt(expected[0, 0]), rel=0.1)
    assert np.std([a[2] for a in apart]) == pytest.approx(math.sqrt(expected[2, 2]), rel=0.1)


def test_only_what_lies_ahead_and_near_is_observed():
    places = np.array([[3.0, 0.0, 0.5], [-1.0, 0.0, 0.5], [3.6, 0.0, 0.0], [0.1, 3.0, 0.2]])
    rng = np.random.default_rng(0)
    seen, rows = observe(IDENTITY, places, unique_descriptors(4, rng), 1.0, 3.5, Noise(), rng)
    assert rows.tolist() == [0, 3]
    assert len(seen) == 2


def test_covariance_of_observations_is_that_of_sampled_noise():
    noise = Noise(sigma=0.5)
    rng = np.random.default_rng(2)
    tau = 3.0 * (1.0 + 0.1 * 0.5 * rng.standard_normal(100_000))
    azimuth = 0.7 + noise.angle * 0.5 * rng.standard_normal(100_000)
    elevation = 0.3 + noise.angle * 0.5 * rng.standard_normal(100_000)
    positions, _ = from_polar(tau, azimuth, elevation, noise)
    _, expected = from_polar(np.array([3.0]), np.array([0.7]), np.array([0.3]), noise)
    np.testing.assert_allclose(np.cov(positions.T), expected[0], rtol=0.03, atol=3e-6)


def test_laps_stay_on_the_path_and_know_their_noise():
    laps = 6
    scenario = draw_scenario('crossing', 1, laps=laps)
    corners = PATHS['crossing']['robot1']
    true, planned = scenario.true_path('robot1'), path_poses(corners)
    assert len(true) == laps * 28 + 1
    for lap in range(laps):
        there = true[28 * lap : 28 * (lap + 1) + 1, :2]
        off = np.linalg.norm(there - [pose[:2] for pose in planned], axis=1)
        assert off.max() < 0.15  # of one step
    step = next(s for s in scenario.steps if len(s.observations) > 3)
    local = step.true_pose.inverse()
    c, s = math.cos(local.theta), math.sin(local.theta)
    x, y, z = scenario.landmarks[step.identities].T
    x, y = local.x + c * x - s * y, local.y + s * x + c * y
    tau = np.sqrt(x**2 + y**2 + z**2)
    _, expected = from_polar(tau, np.arctan2(y, x), np.arcsin(z / tau), Noise())
    np.testing.assert_allclose(step.observations.covariances, expected, rtol=1e-9)


@pytest.mark.parametrize(('name', 'laps'), [('separate', 2), ('crossing', 0)])
def test_laps_that_cannot_be_driven_are_refused(name, laps):
    with pytest.raises(EvaluationError, match=f'laps are {laps}'):
        draw_scenario(name, 0, laps=laps)
