"""Point clouds of 3-D lidars as scans: layouts of other drivers, band of heights, times."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from explore_slam.errors import DataError
from explore_slam.geometry import Pose3, quaternion_from_rotation, rotation_matrix
from explore_slam.messages.cloud_scans import cloud_scan
from explore_slam.messages.clouds import cloud_field, cloud_points

FLAT = Pose3((0.2, 0.0, 0.5), (0.0, 0.0, 0.0, 1.0))
DATATYPES = {'i1': 1, 'u1': 2, 'i2': 3, 'u2': 4, 'i4': 5, 'u4': 6, 'f4': 7, 'f8': 8}


def cloud(columns, *, big=False, gap=0, shape=None, row_gap=0, stamp=(10, 0)):
    """A PointCloud2 as drivers write it: {name: (type, values)} in this order.

    gap: bytes before every field; row_gap: bytes after every row.
    """
    count = len(next(iter(columns.values()))[1])
    height, width = shape or (1, count)
    offsets, offset = {}, 0
    for name, (kind, _) in columns.items():
        offsets[name] = offset + gap
        offset += gap + np.dtype(kind).itemsize
    step = offset + gap
    data = np.zeros((height, width * step + row_gap), np.uint8)
    points = data[:, : width * step].reshape(height, width, step)
    for name, (kind, values) in columns.items():
        order = '>' if big else '<'
        typed = np.asarray(values).astype(order + kind)
        raw = np.frombuffer(typed.tobytes(), np.uint8).reshape(height, width, typed.itemsize)
        points[:, :, offsets[name] : offsets[name] + raw.shape[2]] = raw
    return SimpleNamespace(
        header=SimpleNamespace(
            stamp=SimpleNamespace(sec=stamp[0], nanosec=stamp[1]), frame_id='lidar'
        ),
        height=height, width=width, is_bigendian=big, is_dense=False,
        point_step=step, row_step=width * step + row_gap, data=data.tobytes(),
        fields=[
            SimpleNamespace(name=name, offset=offsets[name], datatype=DATATYPES[kind], count=1)
            for name, (kind, _) in columns.items()
        ],
    )  # fmt: skip


def room(angles, heights, distance=3.0):
    """Points on a cylinder around the lidar, heights in its frame."""
    a, z = (grid.ravel() for grid in np.meshgrid(angles, heights, indexing='ij'))
    return distance * np.cos(a), distance * np.sin(a), z


ANGLES = np.arange(-math.pi, math.pi, math.radians(0.5))
X, Y, Z = room(ANGLES, (-0.6, 0.0, 0.3, 0.9))


@pytest.mark.parametrize(
    ('kind', 'order', 'options'),
    [
        ('f4', 'xyz', {}),
        ('f8', 'zxy', {'big': True}),
        ('f4', 'yzx', {'gap': 3, 'shape': (4, len(X) // 4), 'row_gap': 20}),
        ('f8', 'xyz', {'gap': 4, 'big': True, 'shape': (len(X) // 4, 4)}),
    ],
)
def test_every_layout_holds_the_same_points_and_gives_the_same_scan(kind, order, options):
    values = {'x': X, 'y': Y, 'z': Z}
    columns = {'intensity': ('u2', np.arange(len(X)) % 99)}
    columns |= {name: (kind, values[name]) for name in order}
    columns['ring'] = ('u2', np.arange(len(X)) % 4)
    message = cloud(columns, **options)
    assert np.allclose(cloud_points(message), np.stack((X, Y, Z), axis=1), atol=1e-6)
    assert np.array_equal(cloud_field(message, 'ring'), np.arange(len(X)) % 4)
    assert cloud_field(message, 'time') is None
    scan = cloud_scan(message, FLAT, 0.1, 1.0)
    assert scan.stamp == 10.0
    assert scan.mount == (0.2, 0.0, 0.0)
    assert np.allclose(scan.ranges, 3.0, atol=1e-5)
    assert scan.angles == pytest.approx(ANGLES)
    assert (scan.time_increment, scan.timing.duration) == (0.0, None)


def test_only_points_in_the_band_count_and_the_nearest_of_a_bearing():
    points = np.array(
        [
            (2.0, 0.0, -0.45),  # on the floor: 0.05 m
            (5.0, 0.0, 0.0),  # obstacle behind it
            (4.0, 0.0, 0.4),  # and a nearer one above
            (0.0, 3.0, 0.6),  # under the ceiling, too high
            (0.0, -2.0, 0.0),
            (math.nan, 1.0, 0.0),
            (-1.0, math.inf, 0.0),
            (0.0, 0.0, 0.0),  # a ray without return, as some drivers write it
        ]
    )
    message = cloud({name: ('f4', points[:, k]) for k, name in enumerate('xyz')}, shape=(2, 4))
    scan = cloud_scan(message, FLAT, 0.1, 1.0)
    seen = np.isfinite(scan.ranges)
    assert scan.ranges[seen] == pytest.approx([2.0, 4.0])
    assert scan.angles[seen] == pytest.approx([-math.pi / 2, 0.0], abs=1e-9)
    assert np.isnan(scan.ranges[~seen]).all()  # not free: it may have looked over something


def test_a_lidar_that_is_tilted_and_turned_sees_the_floor_as_the_floor():
    rotation = rotation_matrix(0.0, 0.3, math.pi / 2)
    lidar = Pose3((0.1, 0.2, 0.6), quaternion_from_rotation(rotation))
    world = np.array([(0.1, 3.2, 0.5), (0.1, 2.2, 0.0), (0.1, -1.8, 0.4)])  # vehicle frame
    points = (world - lidar.position) @ rotation
    message = cloud({name: ('f8', points[:, k]) for k, name in enumerate('xyz')})
    scan = cloud_scan(message, lidar, 0.1, 1.0)
    seen = np.isfinite(scan.ranges)
    assert scan.mount == pytest.approx((0.1, 0.2, math.pi / 2))
    assert sorted(scan.ranges[seen]) == pytest.approx([2.0, 3.0])


@pytest.mark.parametrize('clockwise', [False, True])
@pytest.mark.parametrize(
    ('name', 'kind', 'of'),
    [
        ('time', 'f4', lambda t: t - 0.1),  # velodyne: seconds up to the stamp
        ('t', 'u4', lambda t: t * 1e9),  # Ouster: nanoseconds after it
        ('timestamp', 'f8', lambda t: 10.0 + t),  # Hesai, RoboSense: seconds of the clock
        ('timestamp', 'f8', lambda t: (10.0 + t) * 1e9),  # Livox: nanoseconds of the clock
    ],
)
def test_times_of_the_points_are_those_of_the_beams(clockwise, name, kind, of):
    turned = np.linspace(0.0, 2.0 * math.pi, 720, endpoint=False)
    angles = 1.0 + (-turned if clockwise else turned)
    x, y, z = room(angles, (0.0, 0.2))
    times = np.repeat(turned / (2.0 * math.pi) * 0.1, 2)
    message = cloud(
        {'x': ('f4', x), 'y': ('f4', y), 'z': ('f4', z), name: (kind, of(times))},
        stamp=(10, 0),
    )
    scan = cloud_scan(message, FLAT, 0.1, 1.0)
    begin = 10.0 + (-0.1 if name == 'time' else 0.0)
    assert scan.stamp == pytest.approx(begin, abs=2e-4)
    assert scan.timing.duration == pytest.approx(0.1 * 719 / 720, rel=0.01)
    assert (scan.timing.direction, scan.timing.stamp) == ('forward', 'first')
    assert math.cos(scan.angle_min - 1.0) == pytest.approx(1.0, abs=1e-4)
    assert (scan.angle_increment < 0.0) is clockwise
    assert np.isfinite(scan.ranges).mean() > 0.98


def test_times_that_tell_no_turn_are_not_used():
    x, y, z = room(ANGLES, (0.0,))
    random = np.random.default_rng(0)
    pattern = {'t': ('u4', random.uniform(0.0, 1e8, len(x)))}  # as of a lidar that does not turn
    absurd = {'time': ('f4', np.full(len(x), 77.0))}
    for times, stamp in ((pattern, 10.05), (absurd, 10.0)):
        message = cloud({'x': ('f4', x), 'y': ('f4', y), 'z': ('f4', z), **times})
        scan = cloud_scan(message, FLAT, 0.1, 1.0)
        assert (scan.time_increment, scan.timing.duration) == (0.0, None)
        assert scan.stamp == pytest.approx(stamp, abs=0.005)


def test_an_empty_cloud_is_a_scan_without_returns():
    nothing = {name: ('f4', np.empty(0)) for name in 'xyz'}
    scan = cloud_scan(cloud(nothing), FLAT, 0.1, 1.0)
    assert np.isnan(scan.ranges).all()


def test_clouds_that_cannot_be_read_are_named():
    good = {name: ('f4', np.ones(6)) for name in 'xyz'}
    flat = cloud({name: good[name] for name in 'xy'})
    with pytest.raises(DataError, match=r"\[\('x', 7\), \('y', 7\)\], expected x, y and z"):
        cloud_scan(flat, FLAT, 0.1, 1.0)
    with pytest.raises(DataError, match=r"\('z', 5\)\], expected x, y and z"):
        cloud_scan(cloud({**good, 'z': ('i4', np.ones(6))}), FLAT, 0.1, 1.0)
    short = cloud(good)
    short.data = short.data[:-1]
    with pytest.raises(DataError, match='71 bytes, point_step 12'):
        cloud_scan(short, FLAT, 0.1, 1.0)
    outside = cloud(good)
    outside.fields[2].offset = 10
    with pytest.raises(DataError, match="field 'z' at 10"):
        cloud_scan(outside, FLAT, 0.1, 1.0)
    strange = cloud(good)
    strange.fields[0].datatype = 9
    with pytest.raises(DataError, match="field 'x' has the datatype 9"):
        cloud_scan(strange, FLAT, 0.1, 1.0)
