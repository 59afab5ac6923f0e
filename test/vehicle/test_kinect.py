"""The Kinect's driver: pairing and conversion alone, and whole over libfreenect's own fake.

fakenect replays a session through the real API; Debian's handles raw depth only and lacks one
function, which a stub supplies. The library must be preloaded, so it runs in a process apart.
"""

import importlib.util
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from explore_slam.errors import VehicleError
from explore_slam.vehicle import CameraConfig, Kinect, KinectConfig
from explore_slam.vehicle.kinect import Image, StampPairing, raw_to_millimetres

FRAME = 2_000_000  # ticks of 60 MHz between two images


def image(ticks):
    return Image(ticks % 2**32, ticks / 60e6, np.zeros((1, 1)))


def test_images_pair_with_the_nearest_even_where_stamps_wrap():
    pairing, pairs = StampPairing(), []
    for k in range(20):
        start = 2**32 - 10 * FRAME + k * FRAME
        for kind, ticks in (('depth', start), ('color', start + 700_000)):
            pair = pairing.add(kind, image(ticks))
            pairs += [pair] if pair else []
    assert len(pairs) == 20
    assert all((color.ticks - depth.ticks) % 2**32 == 700_000 for depth, color in pairs)


def test_a_lost_image_costs_one_pair():
    pairing = StampPairing()
    results = []
    for k in range(6):
        if k != 2:
            results.append(pairing.add('depth', image(k * FRAME)))
        results.append(pairing.add('color', image(k * FRAME + 400_000)))
    assert sum(pair is not None for pair in results) == 5
    assert pairing.unpaired == 1


def test_raw_disparities_become_millimetres():
    raw = np.array([[0, 600, 1000, 1084, 2046, 2047]], np.uint16)
    millimetres = raw_to_millimetres(raw)
    assert millimetres.dtype == np.uint16
    assert millimetres[0, 1] == pytest.approx(1000 / (3.3309495 - 0.0030711016 * 600), abs=1)
    assert list(millimetres[0, 3:]) == [0, 0, 0]  # beyond 10 m or no data


@pytest.mark.skipif(importlib.util.find_spec('freenect') is None, reason='freenect not installed')
def test_no_kinect_plugged_in_says_what_to_do():
    with pytest.raises(VehicleError, match=r'Kinect 15: not found or busy.*udev'):
        Kinect(CameraConfig(), KinectConfig(camera_index=15)).connect()


def test_without_the_binding_the_error_tells_how_to_get_it(monkeypatch):
    monkeypatch.setitem(sys.modules, 'freenect', None)
    with pytest.raises(VehicleError, match='pip install freenect'):
        Kinect(CameraConfig()).connect()


def write_session(folder, frames=40):
    """Record a session: depth grows by one count per frame, and so does the red channel."""
    folder.mkdir()
    names, start = [], 1_300_000_000.0
    for k in range(frames):
        depth = np.full((480, 640), 600 + k, '<u2')
        depth[:, :100] = 2047
        color = np.zeros((480, 640, 3), np.uint8)
        color[..., 0] = k
        time, ticks = start + k / 30, k * FRAME + 100
        for kind, ending, late, head, pixels in (
            ('d', 'pgm', 0, b'P5 640 480 65535\n', depth),
            ('r', 'ppm', 600_000, b'P6 640 480 255\n', color),
        ):
            name = f'{kind}-{time + late / 60e6:.6f}-{ticks + late}.{ending}'
            (folder / name).write_bytes(head + pixels.tobytes())
            names.append(name)
    (folder / 'INDEX.txt').write_text('\n'.join(names) + '\n')


SCRIPT = """
import numpy as np
from explore_slam.vehicle import CameraConfig, Kinect, KinectConfig
camera = Kinect(CameraConfig(camera_rate=30.0), KinectConfig(camera_depth='raw'))
print(camera.connect())
frames = []
while len(frames) < 8:
    frames += camera.poll(0.2)
for frame in frames:
    red, near, none = frame.rgb[200, 300, 0], frame.depth[200, 300], frame.depth[200, 50]
    print('frame', red, near, none, frame.depth.dtype, frame.rgb.shape, flush=True)
camera._running.clear()
import os
os._exit(0)  # fakenect itself ends the process at the end of the session
"""


@pytest.fixture
def fakenect(tmp_path):
    """Return the environment in which libfreenect is its own fake."""
    found = sorted(Path('/usr/lib').glob('*/fakenect/libfreenect.so.0*'))
    if not found:
        pytest.skip('fakenect is absent: apt install libfreenect-bin')
    if importlib.util.find_spec('freenect') is None:
        pytest.skip('the Python binding is absent: pip install freenect')
    compiler = shutil.which('cc') or shutil.which('gcc')
    if compiler is None:
        pytest.skip('a C compiler is absent: fakenect lacks a function that must be stubbed')
    source, stub = tmp_path / 'stub.c', tmp_path / 'stub.so'
    source.write_text('int freenect_camera_to_world(void) { return 0; }\n')
    subprocess.run([compiler, '-shared', '-fPIC', '-o', stub, source], check=True)
    write_session(tmp_path / 'session')
    return {'LD_PRELOAD': f'{found[0]} {stub}', 'FAKENECT_PATH': str(tmp_path / 'session')}


def test_frames_come_through_libfreenect(fakenect):
    import os

    result = subprocess.run(
        [sys.executable, '-c', SCRIPT],
        env={**os.environ, **fakenect},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    lines = [line.split() for line in result.stdout.splitlines() if line.startswith('frame')]
    assert len(lines) >= 8, result.stdout + result.stderr
    for _, red, near, none, kind, *shape in lines:
        expected = 1000 / (3.3309495 - 0.0030711016 * (600 + int(red)))
        assert abs(int(near) - expected) <= 1.0  # depth and colour of the same moment
        assert (none, kind) == ('0', 'uint16')
        assert shape == ['(480,', '640,', '3)']
