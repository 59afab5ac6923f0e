"""What +inf means: beyond the range of the scanner, or nothing measured."""

import math

import numpy as np
import pytest

from explore_slam.data import LaserScan
from explore_slam.geometry import Pose2
from explore_slam.mapping import GridConfig, LaserMap
from explore_slam.mapping.no_return import NoReturnJudge

BEAMS = 720
ANGLES = np.linspace(-math.pi, math.pi, BEAMS, endpoint=False)


def to_walls(x, y, walls):
    """Distances (BEAMS,) from a point to walls (x1, y1, x2, y2); inf where there is none."""
    found = np.full(BEAMS, np.inf)
    c, s = np.cos(ANGLES), np.sin(ANGLES)
    for x1, y1, x2, y2 in walls:
        ex, ey = x2 - x1, y2 - y1
        cross = c * ey - s * ex
        with np.errstate(divide='ignore', invalid='ignore'):
            along = ((x1 - x) * ey - (y1 - y) * ex) / cross
            part = ((x1 - x) * s - (y1 - y) * c) / cross
        hit = (along > 0.0) & (part >= 0.0) & (part <= 1.0)
        found = np.where(hit, np.minimum(found, along), found)
    return found


def box(x, y, width, height):
    corners = [(x, y), (x + width, y), (x + width, y + height), (x, y + height)]
    return [(*a, *b) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]


def scan(ranges, range_max):
    values = np.where(ranges > range_max, np.inf, ranges).astype(np.float32)
    return LaserScan(0.0, -math.pi, math.tau / BEAMS, values, 0.1, range_max)


FIELD = [
    side
    for x, y in np.random.default_rng(5).uniform(-40.0, 40.0, (120, 2))
    for side in box(float(x), float(y), 0.6, 0.6)
]
# the range of the scanner is the reason for all of their beams without return
TRUE_SCENES = {
    'corridor of 2 m': (box(-30.0, -1.0, 60.0, 2.0), 8.0),
    'hall': (box(-20.0, -14.0, 40.0, 28.0), 16.0),
    'rooms with doors': (
        box(-12.0, -12.0, 24.0, 24.0)
        + [(-4.0, -12.0, -4.0, -1.0), (-4.0, 1.0, -4.0, 12.0), (4.0, -12.0, 4.0, 3.0)],
        8.0,
    ),
    'trees': (FIELD, 12.0),
    'along a wall in the open': ([(-100.0, -1.5, 100.0, -1.5)], 12.0),
    'in the door of a house': (
        box(-8.0, -1.5, 8.0, 6.0)[:1]
        + [(0.0, -1.5, 0.0, -0.5), (0.0, 0.5, 0.0, 4.5)]
        + [(-8.0, -1.5, -8.0, 4.5), (-8.0, 4.5, 0.0, 4.5)],
        10.0,
    ),
    'nothing at all': ([(500.0, 0.0, 500.0, 1.0)], 12.0),
}


@pytest.mark.parametrize('name', TRUE_SCENES)
def test_beams_beyond_the_range_are_free(name):
    walls, range_max = TRUE_SCENES[name]
    judge = NoReturnJudge()
    for step in range(12):
        judge.add(scan(to_walls(0.3 * step - 1.8, 0.1 * step - 0.6, walls), range_max))
        assert judge.is_free
    assert judge.share > 0.05


@pytest.mark.parametrize('lost', [0.1, 0.25, 0.5])
@pytest.mark.parametrize('range_max', [12.0, 25.0, 80.0])
def test_beams_that_are_lost_at_short_range_are_not_free(lost, range_max):
    rng = np.random.default_rng(3)
    judge = NoReturnJudge()
    for _ in range(3):
        ranges = to_walls(*rng.uniform(-1.0, 1.0, 2), box(-3.0, -2.0, 6.0, 4.0))
        ranges[rng.random(BEAMS) < lost] = np.inf
        judge.add(scan(ranges, range_max))
        assert not judge.is_free
    assert judge.share == pytest.approx(lost, abs=0.03)


def test_a_share_at_the_limit_is_judged_once():
    """A twentieth is lost at random, as much as is judged: the decision is not taken back."""
    rng = np.random.default_rng(11)
    judge, decisions, shares = NoReturnJudge(), [], []
    for _ in range(200):
        ranges = to_walls(*rng.uniform(-1.0, 1.0, 2), box(-3.0, -2.0, 6.0, 4.0))
        ranges[rng.random(BEAMS) < 0.05] = np.inf
        judge.add(scan(ranges, 12.0))
        decisions.append(judge.is_free)
        shares.append(judge.share)
    assert min(shares[5:]) < 0.05 < max(shares[5:])
    assert np.count_nonzero(np.diff(np.int8(decisions))) <= 1
    assert not decisions[-1]


def test_few_beams_that_are_lost_later_count_as_free_again():
    judge = NoReturnJudge()
    rng = np.random.default_rng(2)
    decisions = []
    for lost in (0.1, *[0.0] * 4):
        ranges = to_walls(0.0, 0.0, box(-3.0, -2.0, 6.0, 4.0))
        ranges[rng.random(BEAMS) < lost] = np.inf
        judge.add(scan(ranges, 12.0))
        decisions.append(judge.is_free)
    assert decisions == [False, False, False, True, True]  # from a share of 3 % on


def test_without_no_returns_all_stays_as_it_is():
    judge = NoReturnJudge()
    for _ in range(5):
        judge.add(scan(to_walls(0.0, 0.0, box(-3.0, -2.0, 6.0, 4.0)), 12.0))
    assert judge.is_free
    assert judge.share == 0.0


def test_nan_and_too_close_are_no_beams():
    judge = NoReturnJudge()
    judge.add(scan(np.where(np.arange(BEAMS) % 2, np.nan, -np.inf), 12.0))
    assert judge.share == 0.0


def lossy_map(order, config=None):
    """The map of a room that is driven through twice; order: of the scans."""
    laser_map = LaserMap(config or GridConfig(resolution=0.1))
    path, rng = [], np.random.default_rng(7)
    scans = []
    for step in range(20):
        x = 0.1 * step - 1.0
        ranges = to_walls(x, 0.0, box(-3.0, -2.0, 6.0, 4.0))
        ranges[rng.random(BEAMS) < 0.25] = np.inf
        path.append((x, 0.0, 0.0))
        scans.append(scan(ranges, 12.0))
    for step in order:
        laser_map.add(step, 'a', scans[step])
        laser_map.redraw(np.array(path))
    return laser_map


def test_a_map_of_lossy_scans_ends_at_the_walls():
    laser_map = lossy_map(range(20))
    free = np.count_nonzero(laser_map.grid.to_trinary() == 0) * 0.1**2
    assert free == pytest.approx(24.0, rel=0.1)
    share, is_free = laser_map.no_returns['a']
    assert share == pytest.approx(0.25, abs=0.02)
    assert not is_free
    config = GridConfig(resolution=0.1, no_return_meaning='free')
    assert np.count_nonzero(lossy_map(range(20), config).grid.to_trinary() == 0) * 0.01 > 200.0


def test_scans_drawn_before_the_decision_are_drawn_again(caplog):
    """A laser begins to lose beams: the map is then as if that had been known before."""
    laser_map = LaserMap(GridConfig(resolution=0.1))
    walls = box(-3.0, -2.0, 6.0, 4.0)
    first = to_walls(0.0, 0.0, walls)
    first[::30] = np.inf  # 3 %: below what is judged
    lossy = to_walls(0.5, 0.0, walls)
    lossy[::3] = np.inf
    laser_map.add(0, 'a', scan(first, 12.0))
    laser_map.redraw(np.zeros((1, 3)))
    assert laser_map.grid.contains(laser_map.grid.to_cell([(8.0, 0.0)])).all()
    laser_map.add(1, 'a', scan(lossy, 12.0))
    path = np.array([(0.0, 0.0, 0.0), (0.5, 0.0, 0.0)])
    assert laser_map.redraw(path).kept == 0
    assert not laser_map.grid.contains(laser_map.grid.to_cell([(8.0, 0.0)])).any()
    assert sum('have no return' in record.message for record in caplog.records) == 1
    assert laser_map.redraw(path).kept == 2


def test_vehicles_are_judged_apart():
    laser_map = LaserMap(GridConfig(resolution=0.1))
    lossy = to_walls(0.0, 0.0, box(-3.0, -2.0, 6.0, 4.0))
    lossy[::3] = np.inf
    corridor = to_walls(0.0, 0.0, box(-30.0, -1.0, 60.0, 2.0))
    laser_map.add(0, 'a', scan(lossy, 12.0))
    laser_map.add(0, 'b', scan(corridor, 8.0), Pose2(0.0, 0.0, 0.0))
    laser_map.redraw(np.zeros((1, 3)))
    assert [free for _, free in laser_map.no_returns.values()] == [False, True]
