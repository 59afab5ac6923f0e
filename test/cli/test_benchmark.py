"""The command `explore_slam benchmark exploration`, and lists of numbers as options."""

import argparse
import csv

import pytest

from explore_slam.cli import benchmark, experiment
from explore_slam.cli.arguments import whole_numbers
from explore_slam.errors import EvaluationError, ExploreSlamError


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


def test_a_scenario_changes_the_runs_and_its_mistakes_are_named(tmp_path, capsys):
    world, events = tmp_path / 'room.yaml', tmp_path / 'events.yaml'
    world.write_text('size: [6.0, 4.0]\n')
    words = [
        '--map', str(world), '--vehicles', '1', '--strategy', 'nearest', '--seeds', '0',
        '--workers', '1', '--output', str(tmp_path / 'out'), '--scenario', str(events),
    ]  # fmt: skip
    events.write_text('events:\n  - {type: slow, start: 0, vehicle: robot1, factor: 0.3}\n')
    assert benchmark.run(parse(*words)) == 0
    capsys.readouterr()
    with (tmp_path / 'out' / 'runs.csv').open() as stream:
        (row,) = csv.DictReader(stream)
    assert {'coverage', 'status', 'unreached_m2', 't90', 't99', 'end'} <= row.keys()
    assert not {'time_to_90', 'time_to_99', 'duration', 'seen'} & row.keys()
    assert float(row['coverage']) > 0.99
    assert float(row['t90']) <= float(row['t99']) <= float(row['end'])
    assert (row['status'], float(row['unreached_m2'])) == ('exploration_complete', 0.0)
    events.write_text('events:\n  - {type: slow, start: 0, vehicle: robot2}\n')
    with pytest.raises(ExploreSlamError, match=r"events\.yaml: events\[0\]\.vehicle is 'robot2'"):
        benchmark.run(parse(*words))


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
        'coverage.png', 'curves.json', 'runs.csv', 'table.md', 'times.png', 'timings.csv',
    ]  # fmt: skip


def test_workers_and_cluster_exclude_each_other(capsys):
    with pytest.raises(SystemExit):
        parse('--map', 'room.yaml', '--workers', '3', '--cluster', 'tcp://127.0.0.1:8786')
    assert 'not allowed with argument' in capsys.readouterr().err


@pytest.mark.parametrize('name', ['2', '3', '4'])
@pytest.mark.parametrize('option', [['--workers', '2'], ['--cluster', 'tcp://127.0.0.1:8786']])
def test_experiments_that_measure_times_run_in_one_process(name, option):
    parser = argparse.ArgumentParser()
    experiment.configure(parser)
    with pytest.raises(EvaluationError, match=f'experiment {name} runs in one process'):
        experiment.run(parser.parse_args([name, *option]))
