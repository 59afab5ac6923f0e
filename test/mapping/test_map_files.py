"""map_server files: written, read back, and refused where they are damaged."""

import numpy as np
import pytest
import yaml
from grids import same_grid

from explore_slam.errors import MappingError
from explore_slam.mapping import GridConfig, OccupancyGrid, load_map, read_image, save_map


@pytest.fixture
def grid():
    generator = np.random.default_rng(5)
    probability = generator.choice([0.05, 0.95, 0.5], (30, 47))
    known = generator.random((30, 47)) < 0.7
    return OccupancyGrid.from_probability(
        probability, known, (-1.5, 2.25), GridConfig(resolution=0.25)
    )


def classes(grid):
    probability, known = grid.probability(), grid.known()
    return np.where(known & (probability > 0.65), 1, np.where(known & (probability < 0.45), 0, -1))


def test_a_map_round_trips(grid, tmp_path):
    path = save_map(grid, tmp_path / 'deep' / 'down' / 'map')
    assert path.name == 'map.yaml'
    again = load_map(path)
    assert again.origin == grid.origin
    assert again.resolution == grid.resolution
    assert np.array_equal(classes(again), classes(grid))
    assert sorted(p.name for p in path.parent.iterdir()) == ['map.pgm', 'map.yaml']


def test_the_image_has_its_first_row_on_top_as_map_server_wants(grid, tmp_path):
    path = save_map(grid, tmp_path / 'map.yaml')
    entries = yaml.safe_load(path.read_text())
    assert entries['image'] == 'map.pgm'
    assert entries['origin'] == [-1.5, 2.25, 0.0]
    image = read_image(tmp_path / 'map.pgm').levels
    expected = np.choose(classes(grid)[::-1] + 1, [205, 254, 0])
    assert np.array_equal(image, expected)


def test_saving_again_replaces_both_files(grid, tmp_path):
    save_map(grid, tmp_path / 'map')
    other = OccupancyGrid.from_probability(np.full((3, 4), 0.9), np.ones((3, 4), bool))
    assert load_map(save_map(other, tmp_path / 'map')).shape == (3, 4)


def write_map(folder, pixels, **changes):
    entries = {
        'image': 'm.pgm', 'resolution': 0.1, 'origin': [0.0, 0.0, 0.0], 'negate': 0,
        'occupied_thresh': 0.65, 'free_thresh': 0.196,
    }  # fmt: skip
    entries.update(changes)
    (folder / 'm.pgm').write_bytes(pixels)
    (folder / 'm.yaml').write_text(yaml.safe_dump({k: v for k, v in entries.items() if v != ...}))
    return folder / 'm.yaml'


def test_modes_negation_comments_and_text_images(tmp_path):
    pixels = bytes([0, 205, 254, 255, 128, 100])
    binary = b'P5\n# made by hand\n3 2\n255\n' + pixels
    trinary = load_map(write_map(tmp_path, binary))
    assert np.array_equal(trinary.known(), [[True, False, False], [True, False, True]])
    negated = load_map(write_map(tmp_path, binary, negate=1))
    assert negated.probability()[1, 0] < 0.5 < negated.probability()[1, 2]
    scaled = load_map(write_map(tmp_path, binary, mode='scale'))
    between = (127 / 255 - 0.196) / (0.65 - 0.196)  # in proportion between the thresholds
    assert scaled.probability()[0, 1] == pytest.approx(between, abs=1e-3)
    raw = load_map(write_map(tmp_path, binary, mode='raw'))
    assert np.array_equal(raw.known(), [[False, False, True], [True, False, False]])
    text = b'P2 3 2 255\n0 205 254\n255 128 100\n'
    assert same_grid(load_map(write_map(tmp_path, text)), trinary)


GOOD = b'P5 2 2 255\n' + bytes([0, 254, 205, 0])


@pytest.mark.parametrize(
    ('image', 'changes', 'message'),
    [
        (GOOD[:-1], {}, 'truncated'),
        (b'P6 2 2 255\n' + bytes(12), {}, 'P2, P5'),
        (b'P5 2', {}, 'header'),
        (b'P5 0 2 255\n', {}, '0 x 2'),
        (b'P5 2 2 65536\n' + bytes(8), {}, '65536'),
        (b'P2 2 2 255\n0 1 x 3', {}, 'not a grey value'),
        (b'', {}, 'P2, P5'),
        (b'P2 9000 9000 255\n', {}, 'save it as binary'),
        (GOOD, {'resolution': 'fine'}, 'resolution'),
        (GOOD, {'resolution': 0.0}, 'resolution'),
        (GOOD, {'resolution': ...}, 'resolution'),
        (GOOD, {'origin': [0.0, 0.0]}, 'origin'),
        (GOOD, {'origin': [0.0, 0.0, 7.0]}, 'yaw'),
        (GOOD, {'image': ...}, 'image'),
        (GOOD, {'image': 'other.pgm'}, 'cannot be read'),
        (GOOD, {'mode': 'color'}, 'mode'),
        (GOOD, {'free_thresh': 0.9}, 'free_thresh'),
    ],
)
def test_damaged_maps_are_refused_by_name(tmp_path, image, changes, message):
    with pytest.raises(MappingError, match=message):
        load_map(write_map(tmp_path, image, **changes))


def test_other_bad_files(tmp_path, grid):
    with pytest.raises(MappingError, match=r'none\.yaml: no such file'):
        load_map(tmp_path / 'none.yaml')
    (tmp_path / 'list.yaml').write_text('[1, 2]')
    with pytest.raises(MappingError, match='mapping'):
        load_map(tmp_path / 'list.yaml')
    with pytest.raises(MappingError, match='empty'):
        save_map(OccupancyGrid(), tmp_path / 'map')
    (tmp_path / 'file').write_text('')
    with pytest.raises(MappingError, match='cannot be written'):
        save_map(grid, tmp_path / 'file' / 'map')


def test_thresholds_decide_what_is_free_in_the_file(tmp_path):
    probability = np.full((2, 2), 0.4)
    known = np.ones((2, 2), bool)
    plain = OccupancyGrid.from_probability(probability, known)
    strict = OccupancyGrid.from_probability(
        probability, known, config=GridConfig(map_free_threshold=0.3)
    )
    lax = OccupancyGrid.from_probability(
        np.full((2, 2), 0.6), known, config=GridConfig(map_occupied_threshold=0.55)
    )
    pixels = [read_image(save_map(g, tmp_path / 'm').with_suffix('.pgm')).levels[0, 0] for g in
              (plain, strict, lax)]  # fmt: skip
    assert pixels == [254, 205, 0]
