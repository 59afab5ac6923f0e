"""Importers are found by a scan of their package, and the command line derives from them."""

import sys
from pathlib import Path

import pytest

from explore_slam.cli.main import main
from explore_slam.errors import ConfigError, RecordingError
from explore_slam.recording.importers import registry
from explore_slam.settings import values_of

EXAMPLE = """
from dataclasses import dataclass
from explore_slam.recording.importers.registry import importer
from explore_slam.settings import Section, setting

@dataclass(frozen=True)
class Options(Section):
    frame_rate: float = setting(10.0, 'Frames per second', unit='Hz', low=1.0)

@importer('example', 'An example', options=Options)
def import_example(folder, out, frame_rate=10.0):
    out.mkdir()
    (out / 'seen').write_text(f'{folder.name} {frame_rate}')
    return {'/robot1/scan': 3}
"""


@pytest.fixture
def example(tmp_path, monkeypatch) -> Path:
    """Put a module with an importer beside those of the package; nothing else is changed."""
    (tmp_path / 'modules').mkdir()
    (tmp_path / 'modules' / 'example.py').write_text(EXAMPLE)
    package = sys.modules[registry.PACKAGE]
    monkeypatch.setattr(package, '__path__', [*package.__path__, str(tmp_path / 'modules')])
    known = dict(registry._registered)
    yield tmp_path
    registry._registered.clear()
    registry._registered.update(known)
    sys.modules.pop(f'{registry.PACKAGE}.example', None)


def test_all_importers_of_the_package_are_found():
    found = registry.importers()
    assert {'intel', 'mrclam', 'tum'} <= found.keys()
    assert values_of(found['tum'].options)['camera'] == 'auto'
    assert values_of(found['intel'].options) == {}
    assert all(importer.description for importer in found.values())


def test_a_new_module_is_found_and_has_a_command(example, capsys):
    out = example / 'out'
    assert main(['import', 'example', str(example), str(out), '--frame-rate', '5']) == 0
    assert (out / 'seen').read_text() == f'{example.name} 5.0'
    assert '3 messages in' in capsys.readouterr().out


@pytest.mark.usefixtures('example')
def test_its_options_are_checked_and_named(tmp_path, capsys):
    arguments = ['import', 'example', str(tmp_path), str(tmp_path / 'out')]
    assert main([*arguments, '--frame-rate', '0.1']) == 1
    assert 'frame_rate is 0.1, expected at least 1.0 Hz' in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main([*arguments, '--camera', 'freiburg1'])
    with pytest.raises(SystemExit):
        main(['import', 'unknown', str(tmp_path), str(tmp_path / 'out')])
    assert 'intel' in capsys.readouterr().err


def test_a_choice_that_is_none_is_refused(tmp_path, capsys):
    for name in ('rgb', 'depth'):
        (tmp_path / name).mkdir()
    (tmp_path / 'associations.txt').write_text('')
    with pytest.raises(ConfigError, match='camera is'):
        registry.importers()['tum'].function(tmp_path, tmp_path / 'out', camera='webcam')
    with pytest.raises(SystemExit):
        main(['import', 'tum', str(tmp_path), str(tmp_path / 'out'), '--camera', 'webcam'])
    assert 'freiburg2' in capsys.readouterr().err


def test_several_sources_only_where_the_importer_takes_them(tmp_path, capsys):
    logs = [str(tmp_path / name) for name in ('a.log', 'b.log')]
    assert main(['import', 'carmen', *logs, str(tmp_path / 'out')]) == 1
    assert 'a.log cannot be read' in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(['import', 'intel', *logs, str(tmp_path / 'out')])
    found = registry.importers()['intel']
    with pytest.raises(RecordingError, match='takes one folder of the data set, 2 were given'):
        found.run([tmp_path, tmp_path], tmp_path / 'out', found.options)


def test_two_importers_of_one_name_are_refused():
    registry.importers()

    def import_other(_folder, _out):
        return {}

    with pytest.raises(RecordingError, match=r"'intel' of .* is already registered by .*intel"):
        registry.importer('intel', 'another')(import_other)
