import numpy as np
import pytest

from explore_slam.errors import SlamError
from explore_slam.geometry import Pose2
from explore_slam.settings import with_values
from explore_slam.slam import FastSlam, FastSlamConfig, TeamBelief, checkpoint

STARTS = {'a': Pose2(1.0, 1.0, 0.0), 'b': Pose2(5.0, 4.0, 1.0)}


@pytest.mark.parametrize('index', ['forest', 'kd_tree', 'brute_force'])
def test_continuing_from_a_file_is_as_never_having_stopped(
    make_world, make_slam, drive_circles, tmp_path, index
):
    states = []
    for stop in (False, True):
        world = make_world()
        slam = make_slam(world.start(**STARTS), descriptor_index=index)
        drive_circles(slam, world, 15)
        slam.predict('b', Pose2(0.2, 0.0, 0.1), 1e-3 * np.eye(3))
        if stop:
            slam.save(tmp_path / 'belief.npz')
            slam = FastSlam.load(tmp_path / 'belief.npz')
        drive_circles(slam, world, 15, first=15)
        states.append(slam.state_dict())
    assert states[0].keys() == states[1].keys()
    for name, value in states[0].items():
        np.testing.assert_array_equal(value, states[1][name], err_msg=name)
    assert [item.name for item in tmp_path.iterdir()] in ([], ['belief.npz'])


def test_paper_engine_continues_in_the_middle_of_a_round(make_world, make_slam, drive_circles):
    results = []
    for stop in (False, True):
        world = make_world()
        slam = make_slam(
            world.start(**STARTS), engine='paper', minimum_association_probability=0.1
        )
        drive_circles(slam, world, 5)
        slam.predict('a', Pose2(0.0, 0.0, 0.0), np.zeros((3, 3)))
        slam.update('a', world.see('a', 5.0))
        if stop:
            slam = FastSlam.from_state(slam.state_dict())
        drive_circles(slam, world, 3, first=6)
        results.append(slam.best_path())
    np.testing.assert_array_equal(*results)


@pytest.mark.parametrize('maps', ['common', 'dedicated'])
def test_team_belief_round_trips(make_world, drive_circles, tmp_path, maps):
    config = with_values(
        FastSlamConfig(), {'particles': 50, 'maps': maps, 'maximum_descriptor_distance': 0.0}
    )
    world = make_world()
    belief = TeamBelief(world.start(**STARTS), config, seed=3)
    drive_circles(belief, world, 6)
    belief.save(tmp_path / 'team.npz')
    again = TeamBelief.load(tmp_path / 'team.npz')
    assert again.vehicles == ('a', 'b')
    assert again.config == config
    np.testing.assert_array_equal(again.best_path(), belief.best_path())
    np.testing.assert_array_equal(again.landmarks().means, belief.landmarks().means)
    assert again.add_keyframe('b', 9.0) == 12


def test_files_without_a_saved_state_are_rejected(make_slam, tmp_path):
    path = tmp_path / 'belief.npz'
    with pytest.raises(SlamError, match='no saved state can be read'):
        FastSlam.load(path)
    path.write_bytes(b'not a zip file')
    with pytest.raises(SlamError, match=r'belief\.npz'):
        FastSlam.load(path)
    make_slam({'a': Pose2(0.0, 0.0, 0.0)}).save(path)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(SlamError, match='no saved state can be read'):
        FastSlam.load(path)
    np.savez(path, format=np.array(99))
    with pytest.raises(SlamError, match='format of the saved state is 99'):
        FastSlam.load(path)
    np.savez(path, format=np.array(checkpoint.FORMAT), poses=np.zeros(3))
    with pytest.raises(SlamError, match='incomplete'):
        FastSlam.load(path)
    with pytest.raises(SlamError, match='cannot be written'):
        make_slam({'a': Pose2(0.0, 0.0, 0.0)}).save(tmp_path / 'absent' / 'belief.npz')
