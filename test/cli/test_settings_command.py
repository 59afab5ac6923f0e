"""`explore_slam settings` prints files that the settings trees load again."""

import pytest

from explore_slam.cli.main import main
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


def test_tiers_divide_the_settings(capsys):
    counts = {}
    for option in ([], ['--tier', 'basic'], ['--tier', 'advanced']):
        assert main(['settings', 'agent', *option]) == 0
        counts[tuple(option)] = capsys.readouterr().out.count('    # ')
    assert counts[()] == counts['--tier', 'basic'] + counts['--tier', 'advanced']
