"""Corridors of equal rooms through the real agent: no false closure and no false join."""

import json
import math

import numpy as np
import pytest

from explore_slam.cli.main import main
from explore_slam.errors import ConfigError, EvaluationError, SimulationError
from explore_slam.geometry import Pose2
from explore_slam.simulation.worlds.twin_corridors import ROOMS, along, twin_corridors
from explore_slam.studies import twin_study
from explore_slam.studies.twin_study import TwinStudy, markdown_table, run_world


def test_rooms_are_equal_and_lobbies_are_not():
    world = twin_corridors(1)
    assert world.period == 4.0
    assert world.length == ROOMS * world.period
    angles = np.linspace(-1.5, 1.5, 61)
    middle = Pose2(5 * world.period + 0.3, 0.1, -1.2)
    near = world.ranges(middle, angles)
    assert near.min() > 0.5
    assert np.isfinite(near).all()
    shifted = middle._replace(x=middle.x + world.period)
    same = np.isclose(world.ranges(shifted, angles), near, atol=1e-9)
    assert same.mean() > 0.9  # but for what is seen of the ends
    # the second corridor is a mirror image of the first one
    mirrored = Pose2(middle.x, 8.0 - middle.y, -middle.theta)
    same = np.isclose(world.ranges(mirrored, -angles), near, atol=1e-9)
    assert same.mean() > 0.9
    west, east = Pose2(-1.5, 4.0, math.pi), Pose2(world.length + 1.5, 4.0, 0.0)
    assert np.abs(world.ranges(west, angles) - world.ranges(east, angles)).max() > 0.3
    assert [twin_corridors(seed).period for seed in range(4)] == [3.0, 4.0, 6.0, 3.0]
    with pytest.raises(SimulationError, match='seed is -1'):
        twin_corridors(-1)


def test_every_pose_on_the_ways_is_free():
    for seed in range(3):
        world = twin_corridors(seed)
        corners = world.ring()
        for pose in along([*corners, corners[0]], 0.5, 0.3):
            assert world.ranges(pose, np.linspace(-math.pi, math.pi, 90)).min() > 0.35


def test_a_wrong_study_is_refused():
    for values, message in [
        ({'worlds': ()}, 'no worlds'),
        ({'vehicles': 3}, 'vehicles is 3'),
        ({'starts': 'some'}, "starts is 'some'"),
        ({'starts': 'unknown'}, 'need 2 vehicles'),
    ]:
        with pytest.raises(EvaluationError, match=message):
            TwinStudy(**values)
    with pytest.raises(ConfigError, match='particle'):
        TwinStudy(settings={'particle': 3})


def test_a_vehicle_of_unknown_start_in_the_middle_of_equal_rooms(monkeypatch, tmp_path, capsys):
    """A smaller world: it must not join in the corridor, and does so at a lobby."""
    monkeypatch.setattr('explore_slam.simulation.worlds.twin_corridors.ROOMS', 6)
    run = run_world(TwinStudy(vehicles=2, starts='unknown', settings={'particles': 50}), 1)
    assert run.false_closures == run.false_joins == 0
    assert run.closures > 20
    assert run.ends_closed == run.ends_revisited == 2
    # it starts half a corridor from the next lobby
    assert run.joined_after_m > 12.0
    assert run.error_m < 0.3
    monkeypatch.setattr(twin_study, 'run_world', lambda _, seed: run._replace(world=seed))
    command = ['benchmark', 'twins', '--worlds', '1', '--vehicles', '2', '--starts', 'unknown']
    assert main([*command, '--output', str(tmp_path)]) == 0
    table = capsys.readouterr().out.splitlines()
    assert table[-2].startswith('| 1 | 4 |')
    assert table[-1].startswith(f'| all |  |  | {run.closures} | 0 | 2 of 2 | 1 of 1 | 0 |')
    content = json.loads((tmp_path / 'twins.json').read_text())
    assert content['runs'][0]['false_joins'] == 0


def test_a_run_without_a_join_is_shown_as_such():
    run = twin_study.TwinRun(0, 3.0, 0.5, 7, 1, 2, 1, math.nan, 0, 0.1, 9.0)
    table = markdown_table([run])
    assert '| 1 of 2 | - | 0 |' in table
    assert '| 0 of 1 | 0 |' in table
