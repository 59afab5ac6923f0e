"""Maps as people have them: every way to write one room is read as that room, or refused."""

import logging
import math
import subprocess
import sys

import cv2
import numpy as np
import pytest
import yaml
from PIL import Image

from explore_slam.errors import MappingError, SimulationError
from explore_slam.mapping import load_map
from explore_slam.mapping.map_files import _note
from explore_slam.simulation import load_grid_world, load_world
from explore_slam.simulation.worlds.grid_world import FREE

SAVED_BY_NAV2 = {'mode': 'trinary', 'free_thresh': 0.25}


def building():
    """Return (40, 60) grey values: a room of 3 x 4 m at 0.1 m, unknown around it."""
    pixels = np.full((40, 60), 205, np.uint8)
    pixels[4:36, 8:52] = 0
    pixels[5:35, 9:51] = 254
    pixels[5:20, 30] = 0  # a wall inside, which also shows the image upside down or mirrored
    pixels[28:31, 40:44] = 205
    return pixels


def classes(grid):
    """Return 0 free, 1 occupied, -1 unknown (H, W), the top row first."""
    probability, known = grid.probability(), grid.known()
    return np.where(known, probability > 0.5, -1)[::-1]


EXPECTED = np.choose(np.searchsorted([0, 205, 254], building()), [1, -1, 0])


def pgm(pixels, white=255, comment=b''):
    kind = '>u2' if white > 255 else np.uint8
    header = b'P5\n%s%d %d\n%d\n' % (comment, pixels.shape[1], pixels.shape[0], white)
    return header + pixels.astype(kind).tobytes()


def text_pgm(pixels, white=255):
    rows = [' '.join(map(str, row)) + ' # a row' for row in pixels.tolist()]
    return '\n'.join(['P2 # text', f'{pixels.shape[1]} {pixels.shape[0]} {white}', *rows]).encode()


def encoded(suffix, pixels):
    done, content = cv2.imencode(suffix, pixels)
    assert done
    return content.tobytes()


def by_pillow(tmp_path, mode, **options):
    """Return a PNG in a mode of Pillow: P has a palette, LA grey and alpha, I;16 two bytes."""
    image = Image.fromarray(building())
    if mode == 'P':
        image = image.quantize(8)
    elif mode == 'I;16':
        image = Image.fromarray(building().astype(np.uint16) * 257)
    else:
        image = image.convert(mode)
    image.save(tmp_path / 'pillow.png', **options)
    return (tmp_path / 'pillow.png').read_bytes()


def with_alpha(alpha):
    """Return (40, 60, 4) with that alpha in the unknown cells, which are white then."""
    pixels = building()
    colors = np.where(pixels == 205, 255, pixels)
    clear = np.where(pixels == 205, alpha, 255)
    return np.dstack([colors, colors, colors, clear]).astype(np.uint8)


def padded_bmp():
    """Return a BMP of 32 bit whose fourth bytes are zero, as many programs write it."""
    content = bytearray(
        encoded('.bmp', np.dstack([*[building()] * 3, np.zeros((40, 60), np.uint8)]))
    )
    assert int.from_bytes(content[28:30], 'little') == 32
    return bytes(content)


IMAGES = {
    'P5': lambda _: pgm(building()),
    'P5 with comments': lambda _: pgm(building(), comment=b'# by hand\n# 0.1 m\n'),
    'P5 with line ends of Windows': lambda _: b'P5\r\n60 40\r\n255\r\n' + building().tobytes(),
    'P5 with a line end after the pixels': lambda _: pgm(building()) + b'\n',
    'P5 of 16 bit': lambda _: pgm(building().astype(np.uint16) * 257, 65535),
    'P5 of 16 bit, shifted': lambda _: pgm(building().astype(np.uint16) << 8, 65535),
    'P5 of 12 bit': lambda _: pgm(np.rint(building() / 255 * 4095), 4095),
    'P2 with comments': lambda _: text_pgm(building()),
    'P2 of 16 bit': lambda _: text_pgm(building().astype(np.uint16) * 257, 65535),
    'PNG': lambda _: encoded('.png', building()),
    'PNG with colours': lambda _: encoded('.png', np.dstack([building()] * 3)),
    'PNG with alpha, opaque': lambda path: by_pillow(path, 'RGBA'),
    'PNG with grey and alpha': lambda path: by_pillow(path, 'LA'),
    'PNG, unknown transparent': lambda _: encoded('.png', with_alpha(0)),
    'PNG, unknown nearly transparent': lambda _: encoded('.png', with_alpha(40)),
    'PNG of 16 bit': lambda path: by_pillow(path, 'I;16'),
    'PNG with a palette': lambda path: by_pillow(path, 'P'),
    'PNG with pixels per metre': lambda path: by_pillow(path, 'L', dpi=(300, 300)),
    'BMP': lambda _: encoded('.bmp', building()),
    'BMP of 24 bit': lambda _: encoded('.bmp', np.dstack([building()] * 3)),
    'BMP of 32 bit': lambda _: padded_bmp(),
}


LFS_POINTER = b'version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 900\n'


def write_map(folder, content, **changes):
    """Write a map as map_saver of nav2 does; ... leaves an entry out. Return the YAML's path."""
    entries = {
        'image': 'm.img', 'mode': 'trinary', 'resolution': 0.1, 'origin': [-1.0, 2.0, 0.0],
        'negate': 0, 'occupied_thresh': 0.65, 'free_thresh': 0.25, **changes,
    }  # fmt: skip
    (folder / 'm.img').write_bytes(content)
    path = folder / 'm.yaml'
    path.write_text(yaml.safe_dump({k: v for k, v in entries.items() if v is not ...}))
    return path


@pytest.mark.parametrize('name', IMAGES)
def test_every_image_of_the_room_is_read_as_the_room(tmp_path, name):
    path = write_map(tmp_path, IMAGES[name](tmp_path))
    np.testing.assert_array_equal(classes(load_map(path)), EXPECTED)
    # the simulators' worlds read the same file: nobody starts outside the room
    world = load_world(path)
    assert world.starts
    for pose in world.starts.values():
        assert -0.1 < pose.x < 4.1
        assert 2.5 < pose.y < 5.5
    assert (load_grid_world(path).cells == FREE).sum() == (building() == 254).sum()


@pytest.mark.parametrize(
    ('changes', 'content'),
    [
        ({'mode': ...}, building()),
        ({'mode': ..., 'free_thresh': 0.3}, building()),
        ({'free_thresh': 0.196}, building()),
        ({'negate': 1}, 255 - building()),
        ({'negate': True}, 255 - building()),
        ({}, np.where(building() == 254, 255, building())),  # an editor's white
        ({'resolution': '1e-1'}, building()),  # without a point: text for YAML of Python
        ({'free_thresh': ..., 'occupied_thresh': ...}, building()),
    ],
)
def test_unknown_stays_unknown(tmp_path, changes, content):
    grid = load_map(write_map(tmp_path, pgm(content), **changes))
    np.testing.assert_array_equal(classes(grid), EXPECTED)
    assert grid.resolution == 0.1


def test_a_few_other_greys_do_not_make_unknown_free(tmp_path):
    pixels = building()
    pixels[4:36, 8] = np.linspace(0, 254, 32)  # a wall drawn with soft edges
    assert (classes(load_map(write_map(tmp_path, pgm(pixels))))[:, :8] == -1).all()


def test_in_a_continuum_of_greys_the_thresholds_decide(tmp_path):
    pixels = np.tile(np.arange(256, dtype=np.uint8), (4, 1))
    found = classes(load_map(write_map(tmp_path, pgm(pixels))))
    assert found[0, 205] == 0
    assert (found[0, 192:] == 0).all()
    assert (found[0, :89] == 1).all()


def test_modes_are_those_of_map_server(tmp_path):
    pixels = np.array([[0, 100, 101, 127, 205, 255]], np.uint8)
    grid = load_map(write_map(tmp_path, pgm(pixels), mode='scale'))
    # between the thresholds in proportion, certain beyond them (0.97 and 0.03 are a grid's limits)
    middle = ((255 - 127) / 255 - 0.25) / 0.4
    light = (1 - 101 / 255 - 0.25) / 0.4
    expected = [0.97, (1 - 100 / 255 - 0.25) / 0.4, light, middle, 0.03, 0.03]
    np.testing.assert_allclose(grid.probability()[0], expected, atol=1e-3)
    assert grid.known().all()
    clear = encoded('.png', with_alpha(0))
    np.testing.assert_array_equal(
        load_map(write_map(tmp_path, clear, mode='scale')).known()[::-1], building() != 205
    )
    raw = load_map(write_map(tmp_path, pgm(pixels), mode='raw'))
    np.testing.assert_array_equal(raw.known()[0], [True, True, False, False, False, False])
    np.testing.assert_allclose(raw.probability()[0, :2], [0.03, 0.97], atol=1e-3)


@pytest.mark.parametrize('quarter', [1, 2, 3, -1])
def test_a_map_with_a_quarter_turn_is_the_image_turned(tmp_path, quarter):
    path = write_map(tmp_path, pgm(building()), origin=[1.0, 2.0, quarter * math.pi / 2])
    grid = load_map(path)
    np.testing.assert_array_equal(classes(grid), np.rot90(EXPECTED, quarter))
    low = {1: (1 - 4, 2), 2: (1 - 6, 2 - 4), 3: (1, 2 - 6), -1: (1, 2 - 6)}[quarter]
    assert grid.origin == pytest.approx(low)


def test_a_turned_map_has_its_walls_where_they_were(tmp_path):
    yaw, corner = 0.4, np.array([-3.0, 5.0])
    grid = load_map(write_map(tmp_path, pgm(building()), origin=[*corner.tolist(), yaw]))
    plain = load_map(write_map(tmp_path, pgm(building()), origin=[0.0, 0.0, 0.0]))
    rows, columns = np.nonzero(plain.known())
    points = plain.to_point(np.stack([rows, columns], axis=1))
    turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
    cells = grid.to_cell(points @ turn.T + corner)
    same = grid.evidence()[cells[:, 0], cells[:, 1]] == plain.evidence()[rows, columns]
    assert same.mean() > 0.9  # the others lie within a cell of a border
    assert load_grid_world(tmp_path / 'm.yaml').cells.any()
    free = 0.01 * (classes(grid) == 0).sum()
    assert free == pytest.approx(0.01 * (EXPECTED == 0).sum(), rel=0.02)


@pytest.mark.parametrize(
    'image', ['/home/other/maps/m.img', 'C:\\maps\\m.img', 'maps/M.IMG', '../gone/m.img']
)
def test_the_image_of_another_machine_is_looked_for_beside_the_yaml(tmp_path, image, caplog):
    _note.cache_clear()
    path = write_map(tmp_path, pgm(building()), image=image)
    with caplog.at_level(logging.WARNING):
        np.testing.assert_array_equal(classes(load_map(path)), EXPECTED)
        load_map(path)
    noted = [record.message for record in caplog.records if image in record.message]
    assert len(noted) == 1  # once, though the map is read twice
    assert 'beside the YAML file is used' in noted[0]


@pytest.mark.parametrize('suffix', ['.yaml', '.yml', '.YAML', '.Yml'])
def test_an_image_with_a_yaml_beside_it(tmp_path, suffix):
    write_map(tmp_path, b'', image='hall.png').rename(tmp_path / f'hall{suffix}')
    image = tmp_path / 'hall.png'
    image.write_bytes(encoded('.png', building()))
    grid = load_map(image)
    assert (grid.resolution, grid.origin) == (0.1, pytest.approx((-1.0, 2.0)))
    np.testing.assert_array_equal(classes(grid), EXPECTED)
    assert load_world(image).starts
    assert load_grid_world(image, 0.7).resolution == 0.1
    np.testing.assert_array_equal(classes(load_map(tmp_path / f'hall{suffix}')), EXPECTED)


def test_an_image_alone_has_no_resolution(tmp_path):
    image = tmp_path / 'hall.png'
    image.write_bytes(encoded('.png', building()))
    with pytest.raises(SimulationError, match='expected a YAML file of this name beside it'):
        load_world(image)
    assert load_grid_world(image, 0.2).resolution == 0.2


GOOD = pgm(building())
PNG = encoded('.png', building())
BMP = encoded('.bmp', building())


@pytest.mark.parametrize(
    ('content', 'changes', 'words'),
    [
        (GOOD, {'origin': [math.nan, 0.0, 0.0]}, 'origin x is nan'),
        (GOOD, {'origin': [0.0, math.inf, 0.0]}, 'origin y is inf'),
        (GOOD, {'origin': [0.0, 0.0, '.nan']}, 'origin yaw'),
        (GOOD, {'origin': [1e300, 0.0, 0.0]}, '1e'),
        (GOOD, {'origin': [0.0, 0.0, 90]}, 'in degrees, write 1.57'),
        (GOOD, {'origin': 'here'}, 'origin'),
        (GOOD, {'origin': ...}, 'origin is None'),
        (GOOD, {'resolution': 0}, 'resolution is 0'),
        (GOOD, {'resolution': -0.05}, 'resolution is -0.05'),
        (GOOD, {'resolution': math.inf}, 'resolution is inf'),
        (GOOD, {'resolution': ...}, 'resolution is None'),
        (GOOD, {'resolution': True}, 'resolution is True'),
        (GOOD, {'mode': 'colour'}, 'mode'),
        (GOOD, {'mode': ['scale']}, 'mode'),
        (GOOD, {'negate': 'maybe'}, 'negate'),
        (GOOD, {'occupied_thresh': 65, 'free_thresh': 25}, 'occupied_thresh'),
        (GOOD, {'free_thresh': math.nan}, 'free_thresh'),
        (GOOD, {'image': 'other.pgm'}, r'no such file, and there is no other\.pgm'),
        (GOOD, {'image': ''}, 'image'),
        (GOOD, {'image': 7}, 'image'),
        (GOOD[:-1], {}, 'truncated'),
        (b'P5 9000000 9000000 255\n', {}, 'expected at most 100 million'),
        (b'P5 60 40 70000\n' + bytes(4800), {}, '70000'),
        (PNG[:-20], {}, 'truncated PNG'),
        (PNG[:60] + b'?' + PNG[61:], {}, 'damaged at byte'),
        (PNG[:16] + (10**6).to_bytes(4, 'big') * 2 + PNG[24:], {}, 'm.img'),
        (BMP[:-1], {}, 'truncated BMP'),
        (BMP[:20], {}, 'truncated BMP'),
        (b'\xff\xd8\xff\xe0JFIF', {}, 'expected a PGM'),
        (LFS_POINTER, {}, 'a Git LFS pointer in place of the data'),
        (b'', {}, 'expected a PGM'),
    ],
)
def test_what_is_wrong_is_named(tmp_path, content, changes, words):
    path = write_map(tmp_path, content, **changes)
    with pytest.raises(MappingError, match=words):
        load_map(path)
    with pytest.raises(SimulationError, match=words):
        load_world(path)


def test_a_map_yaml_that_git_lfs_has_not_fetched_is_named(tmp_path):
    path = tmp_path / 'm.yaml'
    path.write_bytes(LFS_POINTER)
    with pytest.raises(MappingError, match='a Git LFS pointer in place of the data'):
        load_map(path)


def test_who_starts_around_a_building_starts_in_it(tmp_path):
    """A floor plan is white around the building, too, and there is more room there."""
    pixels = np.where(building() == 205, 254, building())
    wide = np.full((120, 140), 254, np.uint8)
    wide[40:80, 40:100] = pixels
    path = write_map(tmp_path, pgm(wide), origin=[0.0, 0.0, 0.0])
    for seed in range(5):
        for pose in load_grid_world(path).start_poses(3, seed, 0.35):
            assert 4.9 < pose.x < 9.1
            assert 4.5 < pose.y < 7.5


LARGE = """
import sys
from pathlib import Path
from explore_slam.mapping import load_map
from explore_slam.simulation import load_world
from explore_slam.errors import SimulationError
grid = load_map(Path(sys.argv[1]))
assert grid.shape == (8000, 8000) and grid.known().sum() == 1_000_000
try:
    load_world(Path(sys.argv[1]))
except SimulationError as error:
    print(error)
# unlike ru_maxrss, not that of the process that has started this one
print(Path('/proc/self/status').read_text().split('VmHWM:')[1].split()[0])
"""


def test_a_huge_map_needs_little_memory(tmp_path):
    """8000 x 8000 pixels: 0.3 GB beside the 0.25 GB of Python and its libraries."""
    pixels = np.full((8000, 8000), 205, np.uint8)
    pixels[:500, :1000] = 254
    pixels[-500:, -1000:] = 0
    path = write_map(tmp_path, pgm(pixels), origin=[0.0, 0.0, 0.0], resolution=0.05)
    done = subprocess.run(
        [sys.executable, '-c', LARGE, path], capture_output=True, text=True, check=True
    )
    assert 'has 8000 x 8000 cells, expected at most 9 million' in done.stdout
    assert int(done.stdout.split()[-1]) < 0.6e6  # kB
