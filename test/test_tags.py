"""tags.yaml: what is wrong in it is named, with its value, and the rest is used."""

import logging

import pytest

from explore_slam.errors import ConfigError
from explore_slam.tags import FAMILIES, TagConfig, TagPose, TagTable, read_tags, table_of

GOOD = """
family: tag25h9
size: 0.16
tags:
  - id: 3
  - {id: 4, size: 0.3}
  - {id: 7, pose: [1, 2.5]}
  - {id: 8, size: 0.1, pose: [-1.0, 2, 1.57]}
"""


def test_numbers_sizes_and_surveyed_poses_are_read(tmp_path):
    path = tmp_path / 'tags.yaml'
    path.write_text(GOOD)
    table, problems = read_tags(path)
    assert problems == []
    assert table.family == 'tag25h9'
    assert [table.size_of(tag) for tag in (3, 4, 7, 8, 30)] == [0.16, 0.3, 0.16, 0.1, 0.16]
    assert table.poses == {7: TagPose(1.0, 2.5), 8: TagPose(-1.0, 2.0, 1.57)}


@pytest.mark.parametrize(
    ('entry', 'words'),
    [
        ('{id: 5, size: 160}', ['size of tag 5 is 160', '0.01 to 2 m']),
        ('{id: 5, size: -0.1}', ['size of tag 5 is -0.1']),
        ('{id: 5, size: .nan}', ['size of tag 5 is nan']),
        ('{id: 587}', ['the id 587', '0 to 586', 'tag36h11']),
        ('{id: five}', ["the id 'five'"]),
        ('{size: 0.1}', ['the id None']),
        ('{id: 5, pose: [1, 2, 3, 4]}', ['pose of tag 5 is [1, 2, 3, 4]', '[x, y, yaw]']),
        ('{id: 5, pose: [1, .inf]}', ['pose of tag 5 is [1, inf]']),
        ('{id: 5, colour: red}', ["tag 5 has ['colour']"]),
        ('{id: 9}', ['tag 9 is listed twice']),
    ],
)
def test_a_wrong_entry_is_named_and_the_others_are_used(tmp_path, entry, words):
    path = tmp_path / 'tags.yaml'
    path.write_text(f'size: 0.2\ntags:\n  - {{id: 9, pose: [1, 2]}}\n  - {entry}\n')
    table, (problem,) = read_tags(path)
    assert all(word in problem for word in words), problem
    assert table.poses == {9: TagPose(1.0, 2.0)}
    assert table.size_of(9) == 0.2
    if 'size of' in problem:
        assert table.size_of(5) is None


def test_tags_without_a_size_are_left_out(tmp_path):
    path = tmp_path / 'tags.yaml'
    path.write_text('tags: [{id: 1}, {id: 2, size: 0.1}]\nsizes: 3\n')
    table, problems = read_tags(path)
    assert [table.size_of(tag) for tag in (1, 2, 3)] == [None, 0.1, None]
    assert len(problems) == 2
    assert "no entry 'sizes'" in problems[0]
    assert 'tag 1 has no size' in problems[1]


@pytest.mark.parametrize(
    ('text', 'words'),
    [
        ('family: tag36h12\nsize: 0.1\n', "family is 'tag36h12', expected one of"),
        ('- 1\n', 'holds list, expected family, size and a list of tags'),
        ('tags: {3: 0.1}\n', 'tags is {3: 0.1}, expected a list'),
        ('size: [\n', 'is not YAML'),
        (None, 'no such file'),
    ],
)
def test_a_file_that_cannot_be_used_is_one_warning(tmp_path, caplog, text, words):
    path = tmp_path / 'tags.yaml'
    if text is not None:
        path.write_text(text)
    with pytest.raises(ConfigError) as error:
        read_tags(path)
    assert words in str(error.value)
    with caplog.at_level(logging.WARNING):
        for _ in range(3):
            assert table_of(TagConfig(tags_file=str(path))).is_empty
    (record,) = caplog.records
    assert record.getMessage().endswith('; tags are not used')
    assert str(path) in record.getMessage()


def test_without_a_file_there_are_no_tags():
    assert table_of(TagConfig()) == TagTable()
    assert TagTable().is_empty
    assert not TagTable(size=0.1).is_empty
    assert len(FAMILIES) == 21
