"""Settings: checked when made, found by leaf name, saved and loaded as ROS parameter files."""

from dataclasses import dataclass
from pathlib import Path

import pytest

from explore_slam.agent import AgentConfig
from explore_slam.errors import ConfigError
from explore_slam.nodes.agent_parameters import AgentNodeConfig
from explore_slam.settings import (
    Section,
    load_settings,
    read_parameters,
    save_settings,
    section,
    setting,
    settings_of,
    settings_text,
    values_of,
    with_values,
)
from explore_slam.slam import FastSlamConfig


@dataclass(frozen=True)
class Inner(Section):
    particles: int = setting(100, 'Number of particles', low=1, high=10000, tier='basic')
    engine: str = setting('paper', 'Which engine', choices=('paper', 'fastslam2'))


@dataclass(frozen=True)
class Outer(Section):
    inner: Inner = section(Inner)
    resolution: float = setting(0.05, 'Cell size', unit='m', low=0.01)
    draw: bool = setting(True, 'Draw it')
    vehicles: tuple[str, ...] = setting(('robot1',), 'Names')
    size: tuple[float, ...] = setting((1.0, 2.0), 'Size')


def test_values_are_found_and_replaced_by_leaf_name():
    tree = with_values(Outer(), {'particles': 7, 'resolution': 1, 'vehicles': ['a', 'b']})
    assert tree.inner.particles == 7
    assert values_of(tree) == {
        'particles': 7,
        'engine': 'paper',
        'resolution': 1.0,
        'draw': True,
        'vehicles': ('a', 'b'),
        'size': (1.0, 2.0),
    }


@pytest.mark.parametrize(
    ('values', 'message'),
    [
        ({'particles': 0}, 'particles is 0, expected 1 to 10000'),
        ({'particles': 1.5}, 'particles is 1.5, expected a whole number'),
        ({'particles': True}, 'particles is True, expected a whole number'),
        ({'engine': 'magic'}, "engine is 'magic', expected one of"),
        ({'resolution': float('nan')}, 'resolution is nan, expected at least 0.01 m'),
        ({'draw': 1}, 'draw is 1, expected true or false'),
        ({'particle': 3}, "no setting 'particle'; did you mean 'particles'"),
        ({'vehicles': 'robot1'}, "vehicles is 'robot1', expected a list of texts"),
        ({'vehicles': [1, 2]}, r'vehicles is \[1, 2\], expected a list of texts'),
        ({'vehicles': [True]}, r'vehicles is \[True\], expected a list of texts'),
        ({'size': ['a', 2.0]}, r"size is \['a', 2.0\], expected a list of numbers"),
        ({'size': [False, 1]}, r'size is \[False, 1\], expected a list of numbers'),
        ({'size': 3.0}, 'size is 3.0, expected a list of numbers'),
    ],
)
def test_bad_values_are_named(values, message):
    with pytest.raises(ConfigError, match=message):
        with_values(Outer(), values)


def test_round_trip_through_a_parameter_file(tmp_path):
    tree = with_values(Outer(), {'particles': 9, 'draw': False, 'vehicles': ['x', 'y: z']})
    save_settings(tree, tmp_path / 'config.yaml')
    assert load_settings(Outer(), tmp_path / 'config.yaml') == tree
    assert '# Cell size (m, at least 0.01)' in (tmp_path / 'config.yaml').read_text()


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('a: [', 'is not YAML'),
        ('- 1', 'expected a mapping'),
        ('agent: {particles: 3}', 'ros__parameters'),
        ('/**: {ros__parameters: {nothing: 3}}', "no setting 'nothing'"),
    ],
)
def test_bad_files_are_named(tmp_path, text, message):
    path = tmp_path / 'bad.yaml'
    path.write_text(text)
    with pytest.raises(ConfigError, match=message) as caught:
        load_settings(Outer(), path)
    assert 'bad.yaml' in str(caught.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r'absent\.yaml: no such file'):
        load_settings(Outer(), tmp_path / 'absent.yaml')


def test_a_setting_is_advanced_unless_declared_basic():
    tiers = {info.name: info.tier for info, _ in settings_of(Outer())}
    assert tiers.pop('particles') == 'basic'
    assert set(tiers.values()) == {'advanced'}


def test_the_text_can_be_limited_to_a_tier():
    basic = settings_text(Outer(), 'basic')
    assert basic == (
        '/**:\n  ros__parameters:\n    # Number of particles (1 to 10000)\n    particles: 100\n'
    )
    assert 'engine: paper' in settings_text(Outer(), 'advanced')
    assert 'particles' not in settings_text(Outer(), 'advanced')
    assert settings_text(Outer()).count(': ') > basic.count(': ')


def test_the_configuration_of_the_agent_starts_with_the_defaults_of_the_code():
    """Node, demo, replay, closed loop and benchmarks have one set of defaults."""
    file = Path(__file__).resolve().parents[1] / 'config' / 'agent.yaml'
    found = read_parameters(file)
    defaults = values_of(AgentNodeConfig())
    assert found
    assert {name: defaults[name] for name in found} == found
    assert values_of(AgentConfig()).items() <= defaults.items()
    assert values_of(FastSlamConfig()).items() <= values_of(AgentConfig()).items()
