"""The command `explore_slam benchmark exploration`, and lists of numbers as options."""

import argparse

import pytest

from explore_slam.cli import benchmark
from explore_slam.cli.arguments import whole_numbers


def parse(*words):
    parser = argparse.ArgumentParser()
    benchmark.configure(parser)
    return parser.parse_args(['exploration', *words])


def test_numbers_come_as_ranges_and_lists():
    assert whole_numbers('1..4') == [1, 2, 3, 4]
    assert whole_numbers('1,2,4') == [1, 2, 4]
    assert whole_numbers('0..2,2,7') == [0, 1, 2, 7]


@pytest.mark.parametrize('text', ['', 'a', '4..1', '-1', '1..', '1.5'])
def test_other_numbers_are_refused(text):
    with pytest.raises(argparse.ArgumentTypeError, match='expected'):
        whole_numbers(text)


def test_a_small_study_prints_its_table_and_writes_its_files(tmp_path, capsys):
    world = tmp_path / 'room.yaml'
    world.write_text('size: [6.0, 4.0]\n')
    output = tmp_path / 'out'
    arguments = parse(
        '--map', str(world), '--vehicles', '1,2', '--strategy', 'nearest', '--seeds', '0',
        '--workers', '1', '--output', str(output), '--set', 'time_limit=300',
    )  # fmt: skip
    assert benchmark.run(arguments) == 0
    printed = capsys.readouterr()
    assert printed.out.startswith('| strategy | vehicles |')
    assert printed.out.count('| nearest |') == 2
    assert '[2/2] nearest, 2 vehicles, seed 0: exploration_complete' in printed.err
    assert sorted(path.name for path in output.iterdir()) == [
        'coverage.png', 'curves.json', 'runs.csv', 'table.md', 'times.png',
    ]  # fmt: skip
