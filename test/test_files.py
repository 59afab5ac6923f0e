"""Atomic writing: complete or not at all, nothing left beside the destination; YAML files."""

import os

import pytest

from explore_slam import files
from explore_slam.errors import MappingError, SimulationError


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_text_and_bytes_replace_what_was_there(tmp_path):
    path = tmp_path / 'state.bin'
    files.write_bytes(path, b'old')
    files.write_bytes(path, memoryview(b'new'))
    assert path.read_bytes() == b'new'
    files.write_text(tmp_path / 'note.txt', 'Gruß\n')
    assert (tmp_path / 'note.txt').read_bytes() == 'Gruß\n'.encode()
    assert names(tmp_path) == ['note.txt', 'state.bin']


def test_permissions_follow_the_umask(tmp_path):
    mask = os.umask(0o027)
    try:
        files.write_text(tmp_path / 'shared.txt', 'text')
    finally:
        os.umask(mask)
    assert (tmp_path / 'shared.txt').stat().st_mode & 0o777 == 0o640


def fail_halfway(path):
    with files.atomic(path) as partial:
        partial.write_text('half of the ne', encoding='utf-8')
        raise RuntimeError('interrupted')


def test_an_interrupted_write_leaves_the_old_content(tmp_path):
    path = tmp_path / 'map.pgm'
    files.write_text(path, 'old')
    with pytest.raises(RuntimeError, match='interrupted'):
        fail_halfway(path)
    assert path.read_text() == 'old'
    assert names(tmp_path) == ['map.pgm']


def test_the_partial_file_has_the_final_name_and_is_not_seen_before_the_end(tmp_path):
    path = tmp_path / 'picture.svg'
    with files.atomic(path) as partial:
        assert partial.name == 'picture.svg'
        partial.write_text('<svg/>')
        assert not path.exists()
    assert path.read_text() == '<svg/>'


def test_a_folder_appears_as_a_whole(tmp_path):
    with files.atomic(tmp_path / 'bag') as partial:
        partial.mkdir()
        (partial / 'data').write_text('records')
        assert not (tmp_path / 'bag').exists()
    assert (tmp_path / 'bag' / 'data').read_text() == 'records'
    assert names(tmp_path) == ['bag']


def write_folder(path):
    with files.atomic(path) as partial:
        partial.mkdir()
        (partial / 'data').write_text('new')


def test_a_folder_that_exists_is_kept(tmp_path):
    (tmp_path / 'bag').mkdir()
    (tmp_path / 'bag' / 'data').write_text('old')
    with pytest.raises(OSError, match='bag'):
        write_folder(tmp_path / 'bag')
    assert (tmp_path / 'bag' / 'data').read_text() == 'old'
    assert names(tmp_path) == ['bag']


def test_a_link_is_redirected_and_a_folder_in_its_place_is_kept(tmp_path):
    for name in ('first', 'second'):
        (tmp_path / name).mkdir()
        files.replace_link(tmp_path / 'latest', name)
    assert (tmp_path / 'latest').readlink().name == 'second'
    with pytest.raises(OSError, match='first'):
        files.replace_link(tmp_path / 'first', 'second')
    assert names(tmp_path) == ['first', 'latest', 'second']


def test_nothing_written_is_an_error(tmp_path):
    with pytest.raises(FileNotFoundError), files.atomic(tmp_path / 'nothing'):
        pass
    assert names(tmp_path) == []


def test_a_missing_folder_is_an_error(tmp_path):
    with pytest.raises(OSError, match='absent'):
        files.write_text(tmp_path / 'absent' / 'note.txt', 'text')


def test_yaml_is_read_or_refused_by_name(tmp_path):
    path = tmp_path / 'a.yaml'
    path.write_text('size: [3, 2]\n')
    assert files.read_yaml(path, MappingError) == {'size': [3, 2]}
    path.write_text('size: [')
    with pytest.raises(MappingError, match=r'a\.yaml is not YAML'):
        files.read_yaml(path, MappingError)
    path.write_bytes(b'\xff\xfe\xfa')
    with pytest.raises(SimulationError, match=r'a\.yaml cannot be read'):
        files.read_yaml(path, SimulationError)
    with pytest.raises(SimulationError, match=r'b\.yaml: no such file'):
        files.read_yaml(tmp_path / 'b.yaml', SimulationError)
