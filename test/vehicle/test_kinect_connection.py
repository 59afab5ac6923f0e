"""Connections of the Kinect that do not come about: a binding whose calls block, USB devices."""

import sys
import threading
import time
import types

import numpy as np
import pytest

from explore_slam.errors import VehicleError
from explore_slam.vehicle import CameraConfig, Kinect, Supervisor
from explore_slam.vehicle.kinect_models import advice, kinect_model


@pytest.fixture
def binding(monkeypatch):
    """Return a stand-in for the binding: `blocked` holds the sensors whose calls never return."""
    made = types.ModuleType('freenect')
    made.blocked, made.release, made.ticks = set(), threading.Event(), 0
    made.DEPTH_11BIT, made.DEPTH_REGISTERED, made.VIDEO_RGB = 0, 4, 0

    def get(kind, pixels):
        if kind in made.blocked:
            made.release.wait()
        time.sleep(0.005)
        made.ticks += 1_000_000
        return pixels, made.ticks

    depth, color = np.full((480, 640), 900, np.uint16), np.zeros((480, 640, 3), np.uint8)
    made.sync_get_depth = lambda _index, _format: get('depth', depth)
    made.sync_get_video = lambda _index, _format: get('color', color)
    made.sync_stop = lambda: None
    monkeypatch.setitem(sys.modules, 'freenect', made)
    yield made
    made.release.set()


@pytest.mark.parametrize('sensor', ['depth', 'color'])
def test_a_device_that_opens_but_sends_nothing_is_named_in_time(binding, sensor, monkeypatch):
    monkeypatch.setattr('explore_slam.vehicle.kinect._OPENING_TIME', 0.1)
    binding.blocked.add(sensor)
    camera = Kinect(CameraConfig(camera_timeout=0.5))
    began = time.monotonic()
    with pytest.raises(VehicleError, match=rf'Kinect 0: opened, but no .*{sensor}.* image came'):
        camera.connect()
    assert time.monotonic() - began < 2.0
    with pytest.raises(VehicleError, match='has hung'):
        camera.connect()
    binding.blocked.clear()
    binding.release.set()
    camera._reader.join(2.0)
    assert 'depth registered to colour' in camera.connect()
    end, frames = time.monotonic() + 3.0, []
    while not frames and time.monotonic() < end:
        frames = camera.poll(0.1)
    assert frames[0].depth.max() == 900
    camera.close()


def test_waiting_for_images_can_be_interrupted(binding):
    binding.blocked.add('depth')
    camera = Kinect(CameraConfig(camera_timeout=30.0))
    part = Supervisor('camera', camera, lambda _: None)
    part.start()
    began = time.monotonic()
    part.stop()
    assert time.monotonic() - began < 2.0


def plug(folder, *products):
    for number, product in enumerate(products):
        device = folder / f'1-{number}'
        device.mkdir()
        (device / 'idVendor').write_text('045e\n')
        (device / 'idProduct').write_text(f'{product}\n')
    (folder / 'usb1').mkdir()
    (folder / 'usb1' / 'idVendor').write_text('1d6b\n')
    (folder / 'usb1' / 'idProduct').write_text('02ae\n')  # of another manufacturer


@pytest.mark.parametrize(
    ('products', 'model', 'words'),
    [
        (['02ae', '02b0', '02ad'], 'model 1414', ''),
        (['02ae', '02ad'], 'model 1473', 'audios.bin'),
        (['02bf', '02be'], 'for Windows, model 1517', 'audios.bin'),
        (['02b0'], '', '12 V'),
        (['02c4'], '', 'second generation'),
        ([], '', ''),
    ],
)
def test_models_and_what_they_need_are_recognized(tmp_path, products, model, words):
    plug(tmp_path, *products)
    assert kinect_model(tmp_path) == model
    assert (words in advice(tmp_path)) if words else (advice(tmp_path) == '')
