"""Errors of the simulator without OpenGL, in a fresh interpreter whose EGL is disabled."""

import os
import subprocess
import sys

import pytest

SCRIPT = """
from explore_slam.errors import SimulationError
try:
    from explore_slam.simulation import Simulator
    from explore_slam.simulation import world_path
    Simulator(world_path('small'))
except SimulationError as error:
    print(f'refused: {error}')
"""


def start(**environment):
    finished = subprocess.run(
        [sys.executable, '-c', SCRIPT],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    return finished.stdout + finished.stderr


@pytest.mark.parametrize(
    'environment',
    [
        {'__EGL_VENDOR_LIBRARY_DIRS': '/nowhere', '__EGL_VENDOR_LIBRARY_FILENAMES': ''},
        {'PYOPENGL_PLATFORM': 'glx'},
        {'MUJOCO_GL': 'nonsense'},
    ],
    ids=['no driver', 'other platform', 'unknown backend'],
)
def test_without_opengl_the_packages_to_install_are_named(environment):
    said = start(**environment)
    assert 'refused: ' in said
    assert 'apt-get install libegl1 libgl1 libgles2' in said


def test_with_opengl_nothing_is_printed():
    assert start() == ''
