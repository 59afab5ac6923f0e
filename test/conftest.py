"""Fixtures that all tests share."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import settings
from ros_domain import default_domain

from explore_slam.environment import profile_variable

REPOSITORY = Path(__file__).resolve().parents[1]
os.environ.setdefault('ROS_PYTHON_CHECK_FIELDS', '1')
os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
os.environ['ROS_DOMAIN_ID'] = str(default_domain())
# Large images are lost without it. Fast DDS reads it once per process, for its first participant:
# a test that set it for itself would come too late after any other test with a node.
os.environ.setdefault(profile_variable(), str(REPOSITORY / 'config' / 'fastdds_one_machine.xml'))

# the same examples in every run (HYPOTHESIS_PROFILE=search looks for new ones), and results are
# asserted, never seconds: a busy machine must not fail them
settings.register_profile('same', derandomize=True, deadline=None)
settings.register_profile('search', deadline=None)
settings.load_profile(os.environ.get('HYPOTHESIS_PROFILE', 'same'))


@pytest.fixture(scope='session')
def recordings() -> Callable[[str], Path]:
    """Return a function: name of a recorded data set -> its folder, or a skip with the reason."""
    root = Path(os.environ.get('EXPLORE_SLAM_DATA', REPOSITORY.parent / 'shared' / 'data'))

    def folder(name: str) -> Path:
        path = root / name
        if not path.exists():
            pytest.skip(f'recording {name!r} is absent: set EXPLORE_SLAM_DATA to its folder')
        return path

    return folder
