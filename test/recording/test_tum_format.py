"""Text files of the TUM RGB-D benchmark."""

import numpy as np
import pytest

from explore_slam.errors import RecordingError
from explore_slam.recording.tum_format import (
    SpatialPoses,
    read_associations,
    read_poses,
    write_poses,
)


def test_trajectories_round_trip(tmp_path):
    poses = SpatialPoses(
        np.array([1e9, 1e9 + 0.5]), np.arange(6.0).reshape(2, 3), np.eye(4)[[3, 1]]
    )
    write_poses(tmp_path / 'a.txt', poses)
    for written, read in zip(poses, read_poses(tmp_path / 'a.txt'), strict=True):
        np.testing.assert_allclose(read, written, atol=1e-9)
    (tmp_path / 'empty.txt').write_text('# timestamp tx ty tz qx qy qz qw\n\n')
    assert [len(part) for part in read_poses(tmp_path / 'empty.txt')] == [0, 0, 0]


@pytest.mark.parametrize(
    ('text', 'words'),
    [
        ('1 2 3\n4 5 6\n', '3 columns, expected 8'),
        ('1 2 3 4 5 6 7 eight\n', 'is not a TUM trajectory'),
        ('1 2 3 4 5 6 7 nan\n', 'not finite'),
    ],
)
def test_other_tables_are_refused(tmp_path, text, words):
    (tmp_path / 'bad.txt').write_text(text)
    with pytest.raises(RecordingError, match=words) as caught:
        read_poses(tmp_path / 'bad.txt')
    assert 'bad.txt' in str(caught.value)
    with pytest.raises(RecordingError, match='cannot be read'):
        read_poses(tmp_path / 'absent.txt')


def test_associations_are_sorted_by_the_stamp_of_the_color_image(tmp_path):
    path = tmp_path / 'associations.txt'
    path.write_text('# comment\n2.0 rgb/2.png 2.1 depth/2.png\n1 rgb/1.png 1.1 depth/1.png\n')
    first, second = read_associations(path)
    assert first == (1.0, 'rgb/1.png', 1.1, 'depth/1.png')
    assert second.color_stamp == 2.0
    for text, words in (('#\n1.0 a.png 1.0', 'line 2 is'), ('# none\n', 'names no frames')):
        path.write_text(text)
        with pytest.raises(RecordingError, match=words):
            read_associations(path)
