"""Worlds raised from maps of map_server: the walls stand where the picture has them."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from explore_slam.data import LaserScan
from explore_slam.errors import SimulationError
from explore_slam.geometry import Pose2
from explore_slam.settings import with_values
from explore_slam.simulation import SimulationConfig, Simulator, load_world
from explore_slam.simulation.worlds.map_world import merge_cells, wall_faces

LASER_ONLY = with_values(
    SimulationConfig(), {'simulated_camera_rate': 0.0, 'simulated_scan_noise': 0.0}
)


def write_map(folder, pixels, **entries):
    content = {
        'image': 'map.pgm',
        'resolution': 0.1,
        'origin': [-1.0, 2.0, 0.0],
        'negate': 0,
        'occupied_thresh': 0.65,
        'free_thresh': 0.196,
        **entries,
    }
    image = np.asarray(pixels, np.uint8)
    header = f'P5\n{image.shape[1]} {image.shape[0]}\n255\n'.encode()
    (folder / 'map.pgm').write_bytes(header + image.tobytes())
    path = folder / 'map.yaml'
    path.write_text('\n'.join(f'{key}: {value}' for key, value in entries_of(content)))
    return path


def entries_of(content):
    return [(key, value) for key, value in content.items() if value is not None]


def room():
    """Return 4 x 3 m: a room with a wall inside, free up to the border on the right."""
    pixels = np.full((30, 40), 254)
    pixels[0], pixels[-1], pixels[:, 0] = 0, 0, 0
    pixels[:15, 20] = 0
    pixels[20:24, 30:34] = 205  # unknown
    return pixels


@given(arrays(np.bool_, st.tuples(st.integers(1, 12), st.integers(1, 12))))
@settings(max_examples=60, deadline=None)
def test_merged_cells_cover_just_the_mask(mask):
    covered = np.zeros(mask.shape, np.int64)
    for row, column, end_row, end_column in merge_cells(mask):
        covered[row:end_row, column:end_column] += 1
    assert np.array_equal(covered, mask.astype(np.int64))


@given(arrays(np.bool_, st.tuples(st.integers(2, 10), st.integers(2, 10))))
@settings(max_examples=60, deadline=None)
def test_every_border_of_a_wall_has_a_face_that_looks_at_the_free_side(walls):
    faces = wall_faces(walls, ~walls, (0.0, 0.0), 1.0)
    borders = np.count_nonzero(walls[1:] != walls[:-1])
    borders += np.count_nonzero(walls[:, 1:] != walls[:, :-1])
    assert sum(face.length for face in faces) == pytest.approx(borders)
    for face in faces:
        x, y = 0.5 * (face.x0 + face.x1), 0.5 * (face.y0 + face.y1)
        along = np.array([face.x1 - face.x0, face.y1 - face.y0]) / face.length
        right = np.array([along[1], -along[0]])
        first = np.array([face.x0, face.y0]) + 0.5 * along
        seen, behind = first + 0.5 * right, first - 0.5 * right
        assert not walls[int(seen[1]), int(seen[0])], (x, y)
        assert walls[int(behind[1]), int(behind[0])], (x, y)


def test_walls_stand_where_the_map_has_them(tmp_path):
    world = load_world(write_map(tmp_path, room()))
    # lower row of the picture is the lowest y; the right side is closed by a wall outside
    assert world.bounds == pytest.approx((-1.0, 2.0, 3.1, 5.0))
    with Simulator(world, {'a': Pose2(0.0, 3.05, 0.0)}, LASER_ONLY) as simulator:
        events = simulator.step()
        (scan,) = [e.record for e in events if isinstance(e.record, LaserScan)]
    right, ahead, left = scan.ranges[0], scan.ranges[180], scan.ranges[-1]
    assert (right, left) == pytest.approx((0.95, 1.85), abs=1e-4)
    assert ahead == pytest.approx(2.9, abs=1e-4)  # laser 0.1 m ahead of the origin, border at 3
    hit = scan.ranges[180 + 96]  # at 48 degrees: the wall within the room
    assert hit == pytest.approx(0.9 / math.cos(math.radians(48.0)), abs=1e-4)


def test_unknown_areas_are_solid_and_starts_are_suggested(tmp_path):
    world = load_world(write_map(tmp_path, room()))
    solid, (x0, y0) = world.occupied(0.1)
    column, row = int((2.05 - x0) / 0.1), int((2.75 - y0) / 0.1)
    assert solid[row, column]
    assert len(world.starts) >= 2
    with Simulator(world, config=LASER_ONLY) as simulator:
        assert simulator.vehicles[0] == 'robot1'


@pytest.mark.parametrize(
    ('entries', 'words'),
    [
        ({'resolution': None}, 'resolution'),
        ({'resolution': 'x'}, 'resolution'),
        ({'image': 'other.pgm'}, 'other.pgm'),
        ({'origin': '[0, 0, 90]'}, 'yaw'),
    ],
)
def test_a_broken_map_is_named(tmp_path, entries, words):
    with pytest.raises(SimulationError, match=words):
        load_world(write_map(tmp_path, room(), **entries))


def test_a_map_without_free_cells_and_a_truncated_picture(tmp_path):
    with pytest.raises(SimulationError, match='no free cell'):
        load_world(write_map(tmp_path, np.zeros((5, 5))))
    path = write_map(tmp_path, room())
    picture = tmp_path / 'map.pgm'
    picture.write_bytes(picture.read_bytes()[:200])
    with pytest.raises(SimulationError, match='truncated'):
        load_world(path)


@pytest.mark.data
def test_willow_garage_loads_and_its_laser_sees_walls(recordings, tmp_path):
    picture = recordings('maps') / 'willow-full-0.05.pgm'
    path = tmp_path / 'willow.yaml'
    path.write_text(
        f'image: {picture}\nresolution: 0.05\norigin: [0.0, 0.0, 0.0]\nnegate: 0\n'
        'occupied_thresh: 0.65\nfree_thresh: 0.196\n'
    )
    world = load_world(path)
    assert len(world.starts) == 8
    with Simulator(world, config=LASER_ONLY) as simulator:
        scans = [e.record for e in simulator.step() if isinstance(e.record, LaserScan)]
    assert len(scans) == 8
    assert all(np.isfinite(scan.ranges).mean() > 0.5 for scan in scans)
