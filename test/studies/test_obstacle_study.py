"""Obstacles that the laser does not see: what of them is in the map, and what should not be."""

import json

import numpy as np
import pytest

from explore_slam.errors import EvaluationError
from explore_slam.mapping import OccupancyGrid
from explore_slam.simulation import load_world, world_path
from explore_slam.studies.obstacle_study import ObstacleStudy, Truth, run_study

TABLES = world_path('office_tables')
HEIGHT = 0.8  # m, of the vehicles


def test_a_wrong_study_is_refused():
    for values, message in (({'depth': 'some'}, "depth is 'some'"), ({'seeds': ()}, 'no seeds')):
        with pytest.raises(EvaluationError, match=message):
            ObstacleStudy(TABLES, **values)


def test_shares_count_boards_steps_and_the_free_area_beside_nothing():
    """A map in which all is occupied left of x = 5 m, where two and a half of four tables are."""
    truth = Truth(load_world(TABLES), HEIGHT)
    half = np.zeros((150, 200))
    half[:, :100] = 1.0
    for probability, tops, pits, free in (
        (np.zeros((150, 200)), 0.0, 0.0, 0.0),
        (np.ones((150, 200)), 1.0, 1.0, 1.0),
        (half, None, 0.0, None),
    ):
        grid = OccupancyGrid.from_probability(probability, np.ones((150, 200)))
        shares = [truth.share(grid, points) for points in (truth.tops, truth.pits, truth.free)]
        if tops is not None:
            assert shares == [tops, pits, free]
        else:
            assert 0.5 < shares[0] < 0.75
            assert shares[1] == 0.0
            assert 0.35 < shares[2] < 0.6
    low = Truth(load_world(TABLES), 0.5)  # a vehicle that passes below all boards
    assert len(low.tops) == 0
    assert len(low.free) > len(truth.free)


def test_a_run_writes_figures_and_a_map(tmp_path):
    """The first seconds: robot1 sees the table in front of it."""
    study = ObstacleStudy(TABLES, 1, duration=4.0, seeds=(0,), settings={'particles': 30})
    (run,) = run_study(study, tmp_path)
    assert (run.contacts, run.hazards) == (0, 0)
    assert 0.02 < run.tops < 0.5
    assert run.lost < 0.01
    assert run.frame_ms > 0.0
    written = json.loads((tmp_path / 'obstacles.json').read_text())
    assert written['runs'][0]['tops'] == pytest.approx(run.tops)
    assert '| 0 |' in (tmp_path / 'table.md').read_text()
    assert (tmp_path / 'seed_0.png').stat().st_size > 10_000
