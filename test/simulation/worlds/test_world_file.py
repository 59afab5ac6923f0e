"""World files: content, and errors that name file, key, value and what was expected."""

import math

import numpy as np
import pytest

from explore_slam.errors import SimulationError
from explore_slam.geometry import Pose2
from explore_slam.simulation import load_world, world_path
from explore_slam.simulation.worlds.obstacles import Obstacles

GOOD = """
name: test
size: [6.0, 4.0]
walls:
  inner:
    - {from: [3.0, 0.0], to: [3.0, 4.0], doors: [[1.0, 1.2]], style: brick}
furniture:
  - {kind: crate, at: [1.0, 1.0], size: [0.6, 0.4, 0.5], yaw: 0.5}
  - {kind: column, at: [5.0, 3.0], size: [0.25, 2.0]}
starts:
  robot1: [1.0, 3.0, 7.0]
textures: {seed: 3, resolution: 0.01}
"""


@pytest.fixture
def load(tmp_path):
    def read(text):
        path = tmp_path / 'world.yaml'
        path.write_text(text, encoding='utf-8')
        return load_world(path)

    return read


def test_a_world_has_walls_doors_furniture_and_starts(load):
    world = load(GOOD)
    assert (world.name, world.texture_seed, world.texture_resolution) == ('test', 3, 0.01)
    assert world.bounds == pytest.approx((-0.1, -0.1, 6.1, 4.1))
    assert world.starts == {'robot1': Pose2(1.0, 3.0, pytest.approx(7.0 - math.tau))}
    room = Obstacles(world).clearance
    assert room(3.0, 1.6) == pytest.approx(0.6)  # the middle of the door
    assert room(3.0, 0.5) == pytest.approx(-0.05)  # within the wall
    assert room(2.0, 3.0) == pytest.approx(0.95)  # from the wall's surface
    assert room(5.0, 3.0 - 0.35) == pytest.approx(0.1)  # from the column
    # out of the turned crate's long side
    side = (1.0 - math.sin(0.5) * 0.3, 1.0 + math.cos(0.5) * 0.3)
    assert room(*side) == pytest.approx(0.1)
    assert room(-0.05, 2.0) < 0.0


def test_tables_shelves_and_steps_are_no_solids_but_stop_vehicles_that_are_high_enough(load):
    world = load("""
size: [6.0, 4.0]
furniture:
  - {kind: table, at: [1.5, 2.0], size: [1.4, 0.8, 0.7]}
  - {kind: wall_shelf, at: [5.0, 0.2], size: [1.0, 0.4, 0.6]}
  - {kind: step, at: [4.5, 3.0], size: [1.0, 0.6, 0.2]}
starts: {robot1: [3.0, 1.0, 0.0]}
""")
    solid, low, high = (Obstacles(world, height).clearance for height in (0.0, 0.5, 0.8))
    assert solid(1.5, 2.0) == pytest.approx(math.hypot(0.6, 0.3))  # from the legs
    assert low(1.5, 2.0) == solid(1.5, 2.0)  # fits below the top
    assert high(1.5, 2.0) == pytest.approx(-0.4)
    assert high(5.0, 0.5) == pytest.approx(0.1)  # from the shelf; the wall is 0.5 m away
    assert solid(5.0, 0.5) == low(5.0, 0.5) == pytest.approx(0.5)
    assert low(4.5, 3.0) == pytest.approx(-0.3)  # a pit stops every vehicle
    cells, _ = world.occupied(0.05, 0.8)
    laser, _ = world.occupied(0.05)
    assert (cells & ~laser).sum() * 0.05**2 == pytest.approx(1.4 * 0.8 + 0.4 + 0.6, rel=0.03)


@pytest.mark.parametrize(
    ('entry', 'message'),
    [
        ('{kind: step, at: [1, 1], yaw: 0.3}', r'furniture\[0\].yaw is 0.3, expected 0'),
        ('{kind: table, at: [1, 1], style: wood}', r'furniture\[0\].style is .*no style'),
        ('{kind: table, at: [1, 1], size: [1, 1]}', r'expected \[length, width, height\]'),
    ],
)
def test_what_such_furniture_cannot_have_is_named(load, entry, message):
    with pytest.raises(SimulationError, match=message):
        load(f'size: [6.0, 4.0]\nfurniture: [{entry}]\n')


def test_occupied_cells_match_the_clearance(load):
    world = load(GOOD)
    solid, (x0, y0) = world.occupied(0.05)
    room = Obstacles(world).clearance
    assert solid.shape == (84, 124)
    for row, column in np.argwhere(np.ones_like(solid))[::37]:
        gap = room(x0 + (column + 0.5) * 0.05, y0 + (row + 0.5) * 0.05)
        if abs(gap) > 1e-9:
            assert solid[row, column] == (gap < 0.0)


@pytest.mark.parametrize(
    ('change', 'words'),
    [
        (('size: [6.0, 4.0]', 'size: [6.0]'), ['size', '[6.0]', '[width, depth]']),
        (('size: [6.0, 4.0]', 'size: [6.0, x]'), ['size[1]', "'x'", 'number']),
        (('size: [6.0, 4.0]', 'size: [6.0, .nan]'), ['size[1]', 'nan', 'number']),
        (('size: [6.0, 4.0]', 'size: [0.5, 4.0]'), ['size[0]', '0.5', 'from 1 to 500']),
        (('size: [6.0, 4.0]\n', ''), ["lacks 'size'"]),
        (('furniture:', 'furnitur:'), ["no key 'furnitur'", "did you mean 'furniture'"]),
        (('inner:', 'innner:'), ['walls', "'innner'", "'inner'"]),
        (('to: [3.0, 4.0]', 'to: [3.0, 5.0]'), ['walls.inner[0].to', '[3.0, 5.0]', '6 x 4 m']),
        (('to: [3.0, 4.0]', 'to: [3.0, 0.0]'), ['walls.inner[0].to', 'at least 0.05 m from']),
        (('from: [3.0, 0.0], ', ''), ['walls.inner[0]', "lacks 'from'"]),
        (('[[1.0, 1.2]]', '[[3.5, 1.2]]'), ['doors[0]', '[3.5, 1.2]', 'between 0 and 4 m']),
        (('[[1.0, 1.2]]', '[[1.0, 1.2], [2.0, 1]]'), ['doors[1]', 'between 2.2 and 4 m']),
        (('[[1.0, 1.2]]', '[[1.0, 0.4]]'), ['doors[0]', '[1.0, 0.4]', 'at least 0.6 m']),
        (('[[1.0, 1.2]]', '[1.0, 1.2]'), ['doors[0]', '1.0', '[distance, width]']),
        (('style: brick', 'style: stone'), ['style', "'stone'", "'brick'"]),
        (('kind: crate', 'kind: box'), ['furniture[0].kind', "'box'", "'crate'"]),
        (('at: [1.0, 1.0]', 'at: [-1.0, 1.0]'), ['furniture[0].at', '[-1.0, 1.0]', 'within']),
        (('[0.6, 0.4, 0.5]', '[0.6, 0.4]'), ['furniture[0].size', 'length, depth, height']),
        (('[0.25, 2.0]', '[0.25, -2.0]'), ['furniture[1].size[1]', '-2.0', 'number']),
        (('yaw: 0.5', 'yaw: north'), ['furniture[0].yaw', "'north'", 'rad']),
        (('[1.0, 3.0, 7.0]', '[1.0, 3.0]'), ['starts.robot1', '[x, y, theta]']),
        (('[1.0, 3.0, 7.0]', '[9.0, 3.0, 0.0]'), ['starts.robot1', '6 x 4 m']),
        (('  robot1: [1.0, 3.0, 7.0]', '  - 1'), ['starts', 'a mapping']),
        (('seed: 3', 'seed: -3'), ['textures.seed', '-3', 'an integer >= 0']),
        (('resolution: 0.01', 'resolution: 5'), ['textures.resolution', '5', '0.001 to 0.1']),
        (('furniture:', 'furniture: 7\nstarts: {}\nx:'), ["no key 'x'"]),
    ],
)
def test_a_mistake_is_named(load, change, words):
    text = GOOD.replace(*change)
    assert text != GOOD
    with pytest.raises(SimulationError) as caught:
        load(text)
    for word in ['world.yaml', *words]:
        assert word in str(caught.value)


@pytest.mark.parametrize(
    ('text', 'word'),
    [
        ('size: [', 'is not YAML'),
        ('- a\n- b\n', 'holds list'),
        ('', 'holds NoneType'),
        ('furniture: 7\nsize: [3, 3]', 'expected a list'),
    ],
)
def test_what_is_no_world_is_refused_with_the_reason(load, text, word):
    with pytest.raises(SimulationError, match=word):
        load(text)


def test_files_that_are_not_there(tmp_path):
    with pytest.raises(SimulationError, match=r'nowhere\.yaml: no such file'):
        load_world(tmp_path / 'nowhere.yaml')
    with pytest.raises(SimulationError, match='cannot be read'):
        load_world(tmp_path)
    with pytest.raises(SimulationError, match=r'map\.pgm: no such file'):
        load_world(tmp_path / 'map.pgm')
    with pytest.raises(SimulationError, match=r"no world 'castle'.*'office'"):
        world_path('castle')


@pytest.mark.parametrize('name', ['office', 'small', 'loop'])
def test_worlds_of_the_package_have_free_starts(name):
    world = load_world(world_path(name))
    room = Obstacles(world).clearance
    assert len(world.starts) >= 3
    for start in world.starts.values():
        assert room(start.x, start.y) > 0.4


def test_the_office_has_the_size_of_the_papers_and_every_room_can_be_entered():
    from scipy import ndimage

    world = load_world(world_path('office'))
    assert np.round(np.diff(np.reshape(world.bounds, (2, 2)), axis=0) - 0.2, 6).tolist() == [
        [17.0, 10.5]
    ]
    solid, origin = world.occupied(0.05)
    roomy = ndimage.distance_transform_edt(~solid) * 0.05 > 0.45  # doors of at least 1 m
    labels, _ = ndimage.label(roomy)
    sizes = np.bincount(labels[roomy])
    assert sizes.max() > 0.97 * roomy.sum()
    corridor = labels[int((5.25 - origin[1]) / 0.05), int((8.0 - origin[0]) / 0.05)]
    rooms = [(2, 2), (6.4, 3), (10.5, 2.5), (14.8, 2), (2.7, 8), (7, 8), (14, 7.5)]
    for x, y in rooms:
        assert labels[int((y - origin[1]) / 0.05), int((x - origin[0]) / 0.05)] == corridor
