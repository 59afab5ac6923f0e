"""TUM RGB-D sequences as they are downloaded: frames by stamps, cameras by the folder's name."""

import numpy as np
import pytest

from explore_slam.errors import RecordingError
from explore_slam.recording.tum_sequence import CAMERAS, associate, camera_of, frame_files


def write_lists(folder, colors, depths):
    for name, stamps in (('rgb', colors), ('depth', depths)):
        lines = [f'{stamp:.6f} {name}/{stamp:.6f}.png\n' for stamp in stamps]
        (folder / f'{name}.txt').write_text('# timestamp filename\n' + ''.join(lines))


def test_images_are_paired_by_their_stamps(tmp_path, caplog):
    write_lists(tmp_path, [1.0, 1.033, 1.066, 2.0], [1.002, 1.031, 1.09, 2.021])
    frames = frame_files(tmp_path)
    assert [(f.color_stamp, f.depth_stamp) for f in frames] == [(1.0, 1.002), (1.033, 1.031)]
    assert frames[0].depth_file == 'depth/1.002000.png'
    assert '2 of 4 colour images have no depth image within 0.02 s' in caplog.text
    assert len(frame_files(tmp_path, tolerance=0.03)) == 4


def test_no_image_is_used_twice_and_the_nearest_are_paired():
    pairs = associate(np.array([1.0, 1.01]), np.array([1.008, 1.018]), 0.02)
    assert pairs == [(0, 1), (1, 0)]  # the nearest first, then what is left
    rng = np.random.default_rng(2)
    first = np.sort(rng.uniform(0.0, 5.0, 200))
    second = np.sort(rng.uniform(0.0, 5.0, 180))
    found = associate(first, second, 0.02)
    assert len({i for i, _ in found}) == len({j for _, j in found}) == len(found) > 50
    assert all(abs(first[i] - second[j]) <= 0.02 for i, j in found)


def test_associations_of_the_data_set_come_first_in_either_order(tmp_path):
    write_lists(tmp_path, [1.0], [1.0])
    (tmp_path / 'associations.txt').write_text(
        '3.0 depth/3.0.png 3.01 rgb/3.01.png\n2.0 rgb/2.0.png 2.01 depth/2.01.png\n'
    )
    assert [(f.color_file, f.depth_file) for f in frame_files(tmp_path)] == [
        ('rgb/2.0.png', 'depth/2.01.png'),
        ('rgb/3.01.png', 'depth/3.0.png'),
    ]


def test_what_is_missing_or_does_not_fit_is_named(tmp_path):
    with pytest.raises(RecordingError, match=r'rgb\.txt, depth\.txt is missing.*associations'):
        frame_files(tmp_path)
    write_lists(tmp_path, [1.0, 1.1], [7.0])
    with pytest.raises(RecordingError, match=r'no colour image of 2 .* of 1 within 0\.02 s'):
        frame_files(tmp_path)
    (tmp_path / 'rgb.txt').write_text('first rgb/1.png\n')
    with pytest.raises(RecordingError, match=r'rgb\.txt line 1'):
        frame_files(tmp_path)
    (tmp_path / 'rgb.txt').write_text('version https://git-lfs.github.com/spec/v1\n')
    with pytest.raises(RecordingError, match='Git LFS pointer'):
        frame_files(tmp_path)


@pytest.mark.parametrize(
    ('name', 'camera'),
    [
        ('rgbd_dataset_freiburg1_desk', 'freiburg1'),
        ('rgbd_dataset_freiburg2_pioneer_slam', 'freiburg2'),
        ('rgbd_dataset_Freiburg3_long_office_household', 'freiburg3'),
        ('tum_fr1_rpy', 'freiburg1'),
        ('fr3-office', 'freiburg3'),
    ],
)
def test_the_camera_follows_from_the_name_of_the_folder_and_is_said(
    tmp_path, name, camera, caplog, monkeypatch
):
    folder = tmp_path / name
    folder.mkdir()
    assert camera_of(folder) == CAMERAS[camera]
    assert f'intrinsics of {camera}, by the name of the folder' in caplog.text
    monkeypatch.chdir(folder)
    assert camera_of(folder.relative_to(folder)) == CAMERAS[camera]
    (folder / 'inner').mkdir()
    assert camera_of(folder / 'inner') == CAMERAS[camera]
    assert camera_of(folder, 'freiburg2') == CAMERAS['freiburg2']
    assert ('--camera freiburg2 is used' in caplog.text) == (camera != 'freiburg2')


def test_a_name_without_a_camera_gives_a_warning(tmp_path, caplog):
    (tmp_path / 'office_fr10').mkdir()
    assert camera_of(tmp_path / 'office_fr10') == CAMERAS['freiburg1']
    assert '--camera takes others' in caplog.text
