"""`explore_slam settings` prints files that the settings trees load again."""

import re

import pytest

from explore_slam.cli.main import main
from explore_slam.cli.settings import PARTS
from explore_slam.nodes.agent_parameters import AgentNodeConfig
from explore_slam.nodes.driver_parameters import DriverNodeConfig
from explore_slam.settings import load_settings, settings_of, settings_text, with_values
from explore_slam.simulation import SimulationConfig
from explore_slam.vehicle import PathFollowerConfig


@pytest.mark.parametrize(
    ('part', 'tree'),
    [
        ('agent', AgentNodeConfig()),
        ('driver', DriverNodeConfig()),
        ('follower', PathFollowerConfig()),
        ('simulator', SimulationConfig()),
    ],
)
def test_the_printed_file_is_loaded_again(part, tree, tmp_path, capsys):
    assert main(['settings', part]) == 0
    printed = capsys.readouterr().out
    (tmp_path / 'all.yaml').write_text(printed)
    assert load_settings(tree, tmp_path / 'all.yaml') == tree
    for info, _ in settings_of(tree):
        assert f'    {info.name}: ' in printed


def test_a_changed_value_in_the_file_takes_effect(tmp_path):
    changed = with_values(AgentNodeConfig(), {'particles': 77})
    (tmp_path / 'all.yaml').write_text(settings_text(changed))
    loaded = load_settings(AgentNodeConfig(), tmp_path / 'all.yaml')
    assert loaded.agent.slam.particles == 77


def listed(capsys, *options):
    assert main(['settings', *options]) == 0
    return re.findall(r'^    (\w+): ', capsys.readouterr().out, re.MULTILINE)


@pytest.mark.parametrize('part', PARTS)
def test_every_setting_is_either_basic_or_advanced(part, capsys):
    basic = listed(capsys, part, '--tier', 'basic')
    advanced = listed(capsys, part, '--tier', 'advanced')
    assert sorted(basic + advanced) == sorted(listed(capsys, part))
    assert basic
    assert advanced


def test_basic_are_the_settings_of_vehicles_site_and_task(capsys):
    """Fifty at most: whoever brings two robots reads all of them."""
    basic = set(listed(capsys, 'agent', '--tier', 'basic'))
    assert 30 <= len(basic) <= 50
    assert basic >= {
        'vehicles', 'start_poses', 'navigator', 'vehicle_radius', 'follow_speed', 'laser_x',
        'camera_z', 'sensor_range', 'max_laser_range', 'min_depth', 'planning_radius',
        'vehicle_separation', 'strategy', 'particles', 'resolution', 'explore',
    }  # fmt: skip
    tuning = r'graph_|closure_|blacklist_|redraw|correlat|_weight$|_threshold$|_gate$|_noise$'
    assert [name for name in basic if re.search(tuning, name)] == []
