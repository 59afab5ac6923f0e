"""Start poses as users write them."""

import math

import pytest

from explore_slam.errors import ConfigError
from explore_slam.recording.start_poses import start_pose, start_poses


@pytest.mark.parametrize(
    ('text', 'theta'),
    [
        ('robot1=1,-2.5,0.5', 0.5),
        ('robot1=1, -2.5, 0.5rad', 0.5),
        ('robot1=1,-2.5,90deg', math.pi / 2),
        ('robot1=1,-2.5,-45 deg', -math.pi / 4),
        ('robot1=1,-2.5,180°', math.pi),
        ('robot1=1,-2.5,-6.28', -6.28),
    ],
)
def test_angles_are_radians_or_have_a_unit(text, theta):
    name, pose = start_pose(text)
    assert name == 'robot1'
    assert pose[:2] == (1.0, -2.5)
    assert math.remainder(pose.theta - theta, math.tau) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize('angle', ['90', '-180', '6.3'])
def test_a_bare_angle_beyond_a_full_turn_is_refused_with_the_hint(angle):
    with pytest.raises(ConfigError, match=f'write {angle}deg for degrees'):
        start_pose(f'robot1=0,0,{angle}')


@pytest.mark.parametrize(
    'text', ['', 'robot1', 'robot1=', 'robot1=1,2', 'robot1=1,2,3,4', '=1,2,3', 'robot1=1,2,north',
             'robot1=nan,0,0', 'robot1=1,2,nandeg', 'robot1=0,inf,1', 'robot1=unknown']
)  # fmt: skip
def test_anything_else_is_refused(text):
    with pytest.raises(ConfigError, match=r'expected VEHICLE=X,Y,THETA'):
        start_pose(text)


def test_unknown_where_it_is_possible_and_each_vehicle_once():
    assert start_poses(['a=unknown'], unknown=True) == {'a': None}
    with pytest.raises(ConfigError, match='twice for a'):
        start_poses(['a=0,0,0', 'a=1,0,0'])
