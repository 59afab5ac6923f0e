"""Exploration studies with the whole agent: laser and wheel odometry instead of known poses."""

import csv

import pytest
from grid_worlds import drawn_world

from explore_slam.errors import ConfigError, EvaluationError
from explore_slam.geometry import Pose2
from explore_slam.settings import with_values
from explore_slam.simulation.config import SimulatedOdometryConfig
from explore_slam.simulation.grid.grid_simulator import GridSimulator
from explore_slam.simulation.grid.scenario import Event, Scenario
from explore_slam.studies.exploration_run import SlamSettings, StudyConfig, explore
from explore_slam.studies.exploration_study import make_study, run_study
from explore_slam.studies.exploration_tables import run_values, save_study
from explore_slam.studies.parallel import Workers

LOOP = [
    '####################',
    *['#..................#'] * 4,
    *['#....##########....#'] * 5,
    *['#..................#'] * 4,
    '####################',
]
STARTS = {'robot1': Pose2(1.5, 1.5, 0.0), 'robot2': Pose2(1.5, 3.0, 0.0)}
EXACT = {
    'simulated_distance_variance': 0.0,
    'simulated_drift_variance': 0.0,
    'simulated_turn_variance': 0.0,
}
AGENT = {'particles': 100}


def run(size=1, *, agent=None, scenario=None, limit=300.0, **odometry):
    starts = dict(list(STARTS.items())[:size])
    slam = SlamSettings(AGENT | (agent or {}), with_values(SimulatedOdometryConfig(), odometry))
    config = StudyConfig(time_limit=limit, scan_period=0.2)
    world = drawn_world(LOOP)
    return explore(world, starts, 'default', 1, config, scenario=scenario, slam=slam)


def test_a_loop_is_explored_and_mapped_by_what_the_vehicle_measures():
    done = run()
    assert done.status == 'exploration_complete'
    assert done.curve.team[-1] > 0.99
    assert done.mapped > 0.95
    assert 0.0 < done.map_rms < 0.05
    assert done.wall_collisions == 0


def test_noise_of_the_odometry_reaches_the_map_unless_scans_are_matched():
    worse = {'simulated_drift_variance': 5e-3}
    alone = {'scan_matching': False, 'laser_closures': False}
    drifting = run(agent=alone, limit=40.0, **worse)
    matched, exact = run(limit=40.0, **worse), run(limit=40.0, **EXACT)
    assert exact.map_rms < 0.03
    assert drifting.map_rms > 0.1
    assert matched.map_rms < 0.5 * drifting.map_rms


def test_a_team_with_a_vehicle_that_is_silent_for_a_while():
    silence = Scenario([Event('silent', 5.0, 12.0, vehicle='robot1', factor=0.0)])
    done = run(2, scenario=silence)
    assert done.status == 'exploration_complete'
    assert done.curve.team[-1] > 0.99
    assert done.vehicle_collisions == 0
    assert 0.0 < done.map_rms < 0.05


def test_a_vehicle_that_cannot_move_is_reported_as_blocked():
    stuck = Scenario([Event('stuck', 0.0, vehicle='robot1', factor=0.0)])
    done = run(2, scenario=stuck)
    assert done.stalls > 0
    assert done.status == 'exploration_complete'
    assert done.paths[0] == 0.0


def test_vehicles_follow_their_plans_by_the_poses_they_know():
    simulator = GridSimulator(drawn_world(LOOP), {'robot1': STARTS['robot1']})
    known = Pose2(1.2, 1.6, 3.1)
    simulator.set_known_pose('robot1', known)
    assert simulator.known_pose('robot1') == pytest.approx(known)
    assert simulator.true_pose('robot1') == STARTS['robot1']
    for _ in range(5):
        simulator.step()
    assert simulator.known_pose('robot1') == pytest.approx(known)  # no noise: it does not fade


def test_looking_for_loops_changes_nothing_where_localization_is_accurate():
    plain, seeking = run(), run(agent={'loop_seeking': True})
    assert plain.curve == seeking.curve
    assert plain.paths == seeking.paths


@pytest.fixture(scope='module')
def study(tmp_path_factory):
    world = tmp_path_factory.mktemp('study') / 'room.yaml'
    world.write_text(
        'size: [7.0, 5.0]\nwalls:\n  inner:\n    - {from: [3.0, 0.0], to: [3.0, 3.0]}\n'
    )
    return make_study(world, [1], ['default'], [0, 1], ['particles=50'], slam=True)


def test_processes_change_nothing(study, tmp_path):
    here, there = (list(run_study(study, workers)) for workers in (Workers(1), Workers(2)))
    assert list(map(run_values, here)) == list(map(run_values, there))
    assert [run.curve for run in here] == [run.curve for run in there]
    save_study(here, tmp_path)
    with (tmp_path / 'runs.csv').open(newline='') as stream:
        rows = list(csv.DictReader(stream))
    assert [float(row['map_rms']) for row in rows] == [run.map_rms for run in here]
    assert all(0.0 < run.map_rms < 0.1 for run in here)


def test_the_column_is_empty_where_poses_are_known(study, tmp_path):
    known = make_study(study.map_path, [1], ['default'], [0])
    save_study(list(run_study(known)), tmp_path)
    with (tmp_path / 'runs.csv').open(newline='') as stream:
        (row,) = csv.DictReader(stream)
    assert row['map_rms'] == ''


def test_settings_of_agent_and_odometry_need_slam(tmp_path):
    changes = ['simulated_drift_variance=0.01', 'particles=40', 'resolution=0.08', 'beams=91']
    study = make_study(tmp_path, [1], ['default'], [0], changes, slam=True)
    assert study.slam.agent == {'particles': 40, 'resolution': 0.08}
    assert study.slam.odometry.simulated_drift_variance == 0.01
    assert study.vehicle_settings == {'beams': 91}
    for change in changes[:3]:
        with pytest.raises(EvaluationError, match='no effect without --slam'):
            make_study(tmp_path, [1], ['default'], [0], [change])
    with pytest.raises(EvaluationError, match='no effect with --slam'):
        make_study(tmp_path, [1], ['default'], [0], ['position_error=0.1'], slam=True)
    with pytest.raises(ConfigError, match='particles is 0'):
        make_study(tmp_path, [1], ['default'], [0], ['particles=0'], slam=True)
