"""The endurance study: samples over time, and the patrol that follows exploration."""

import json
import math

import numpy as np
import pytest

from explore_slam.cli import benchmark
from explore_slam.cli.main import build_parser
from explore_slam.data import FollowerReport, FollowerState
from explore_slam.errors import ConfigError, EvaluationError
from explore_slam.settings import with_values
from explore_slam.simulation import world_path
from explore_slam.studies.closed_loop import ClosedLoop, ClosedLoopConfig
from explore_slam.studies.endurance_study import EnduranceStudy, Sample, save_samples
from explore_slam.studies.patrol import LEG_TIMEOUT, Patrol

SMALL = world_path('small')


def test_the_command_samples_a_run_and_writes_its_series(tmp_path, capsys):
    words = [
        'benchmark', 'endurance', '--world', 'small', '--duration', '8', '--period', '4',
        '--output', str(tmp_path / 'out'), '--set', 'particles=40',
    ]  # fmt: skip
    assert benchmark.run(build_parser('benchmark').parse_args(words)) == 0
    assert len(capsys.readouterr().out.splitlines()) == 3
    found = json.loads((tmp_path / 'out' / 'endurance.json').read_text())
    assert found['t'] == pytest.approx([4.0, 8.0], abs=0.05)
    assert 0 < found['landmarks'][0] <= found['landmarks'][1]
    assert 0 < found['anchors'][0] < found['anchors'][1]
    assert 0 < found['keyframes'][0] < found['keyframes'][1]
    assert all(50.0 < value < 20_000.0 for value in found['memory_mb'])
    assert all(0.0 < value < 10_000.0 for value in found['update_ms'])
    assert found['collisions'] == {'robot1': 0, 'robot2': 0}
    assert (tmp_path / 'out' / 'endurance.png').stat().st_size > 10_000


def test_a_patrol_reaches_its_waypoints_and_draws_new_ones():
    config = with_values(ClosedLoopConfig(), {'particles': 30, 'simulated_camera_rate': 0.0})
    loop = ClosedLoop(SMALL, config, vehicles=1, seed=1)
    loop.planner = patrol = Patrol(loop.agent, np.array([[0.8, 1.0], [2.4, 3.0]]), seed=0)
    while patrol.reached < 2 and loop.simulator.time < 120.0:
        loop.step()
    loop.simulator.close()
    assert patrol.reached == 2
    assert loop.simulator.collisions == {'robot1': 0}


def test_a_blocked_vehicle_and_one_that_takes_too_long_get_other_waypoints():
    config = with_values(ClosedLoopConfig(), {'particles': 30, 'simulated_camera_rate': 0.0})
    loop = ClosedLoop(SMALL, config, vehicles=1, seed=1)
    while loop.simulator.time < 1.5:
        loop.step()
    waypoints = np.random.default_rng(2).uniform([0.5, 0.5], [2.5, 3.5], (200, 2))
    patrol = Patrol(loop.agent, waypoints, seed=0)

    def goal(now: float) -> tuple[float, float]:
        return patrol.plan(now).plans['robot1'].goal[:2]

    first = goal(2.0)
    assert goal(4.0) == first
    patrol.report_follower('robot1', FollowerReport(FollowerState.BLOCKED), 5.0)
    second = goal(6.0)
    assert second != first
    assert goal(8.0) == second
    assert goal(8.0 + LEG_TIMEOUT) != second
    loop.simulator.close()


def test_update_times_that_are_not_known_are_null(tmp_path):
    samples = [
        Sample(60.0, 300.0, 10, math.nan, 4, 6),
        Sample(120.0, 310.0, 20, 5.0, 9, 12),
    ]
    found = json.loads(save_samples(samples, {'seed': 0}, tmp_path).read_text())
    assert found['update_ms'] == [None, 5.0]
    assert found['landmarks'] == [10, 20]


def test_wrong_studies_are_refused():
    with pytest.raises(EvaluationError, match=r'period is 0\.0 s'):
        EnduranceStudy(SMALL, period=0.0)
    with pytest.raises(ConfigError, match='particels'):
        EnduranceStudy(SMALL, settings={'particels': 1})
    loop = ClosedLoop(SMALL, with_values(ClosedLoopConfig(), {'particles': 30}), vehicles=1)
    with pytest.raises(EvaluationError, match='no waypoints'):
        Patrol(loop.agent, np.empty((0, 2)), seed=0)
    loop.simulator.close()
