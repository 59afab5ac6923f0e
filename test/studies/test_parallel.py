"""Runs by several processes and on a Dask cluster: the same results, also when workers die."""

import os
import socket
import sys

import pytest
from worker_tasks import always_die, die_once, refuse, square

from explore_slam.cli.main import main
from explore_slam.errors import EvaluationError
from explore_slam.studies.parallel import ALONE, Workers, make_runs

pytest.importorskip('joblib', reason='several workers need joblib')

NUMBERS = [(number,) for number in range(6)]


def test_one_worker_is_this_process():
    assert list(make_runs(square, NUMBERS, ALONE)) == [
        (number * number, os.getpid()) for (number,) in NUMBERS
    ]
    assert next(make_runs(square, NUMBERS[:1], Workers(2)))[1] == os.getpid()


def test_results_come_in_order_from_other_processes():
    results = list(make_runs(square, NUMBERS, Workers(2)))
    assert [value for value, _ in results] == [number * number for (number,) in NUMBERS]
    assert os.getpid() not in {process for _, process in results}


def test_an_error_of_a_run_is_its_own():
    with pytest.raises(EvaluationError, match='the map is missing'):
        list(make_runs(refuse, NUMBERS, Workers(2)))


def test_the_run_of_a_process_that_has_died_is_made_again(tmp_path, caplog):
    marker = tmp_path / 'died'
    tasks = [(number, marker) for (number,) in NUMBERS]
    assert list(make_runs(die_once, tasks, Workers(2))) == [n * n for (n,) in NUMBERS]
    assert marker.exists()
    assert 'a worker process has died' in caplog.text


def test_processes_that_keep_dying_are_an_error():
    with pytest.raises(EvaluationError, match=r'have died 3 times, 2 of 2 runs are missing'):
        list(make_runs(always_die, [(), ()], Workers(2)))


# -- on a cluster ---------------------------------------------------------------------------------


@pytest.fixture(scope='module')
def cluster():
    """Address of the scheduler of a Dask cluster of two workers, processes of this machine."""
    distributed = pytest.importorskip('distributed', reason='--cluster needs dask, distributed')
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as made:
        yield made.scheduler_address


def test_a_cluster_gives_the_same_results_in_order(cluster):
    results = list(make_runs(square, NUMBERS, Workers(cluster=cluster)))
    assert [value for value, _ in results] == [number * number for (number,) in NUMBERS]
    assert os.getpid() not in {process for _, process in results}


def test_the_run_of_a_lost_worker_of_a_cluster_is_made_again(cluster, tmp_path):
    marker = tmp_path / 'died'
    tasks = [(number, marker) for (number,) in NUMBERS]
    assert list(make_runs(die_once, tasks, Workers(cluster=cluster))) == [
        n * n for (n,) in NUMBERS
    ]
    assert marker.exists()


def test_an_error_of_a_run_on_a_cluster_is_its_own(cluster):
    with pytest.raises(EvaluationError, match='the map is missing'):
        list(make_runs(refuse, NUMBERS, Workers(cluster=cluster)))


@pytest.mark.usefixtures('cluster')
@pytest.mark.parametrize('address', ['tcp://127.0.0.1:{port}', 'nowhere', 'udp://127.0.0.1:1'])
def test_an_address_without_a_scheduler_is_named(address, monkeypatch):
    monkeypatch.setattr('explore_slam.studies.parallel._CONNECTION_TIMEOUT', 1.0)
    with socket.socket() as free:
        free.bind(('127.0.0.1', 0))
        port = free.getsockname()[1]
    full = address.format(port=port)
    with pytest.raises(EvaluationError, match=f'no Dask scheduler at {full!r}'):
        list(make_runs(square, NUMBERS, Workers(cluster=full)))


def test_without_the_packages_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, 'distributed', None)
    with pytest.raises(EvaluationError, match='pip install dask distributed'):
        list(make_runs(square, NUMBERS, Workers(cluster='tcp://127.0.0.1:8786')))


def test_files_of_a_study_are_the_same_byte_for_byte_wherever_it_runs(cluster, tmp_path, capsys):
    world = tmp_path / 'rooms.yaml'
    world.write_text(
        'size: [8.0, 5.0]\n'
        'walls:\n  inner:\n'
        '    - {from: [4.0, 0.0], to: [4.0, 5.0], doors: [[2.0, 1.2]]}\n'
    )
    places = {
        'here': ['--workers', '1'],
        'two': ['--workers', '2'],
        'dask': ['--cluster', cluster],
    }
    for name, where in places.items():
        command = ['benchmark', 'exploration', '--map', str(world), '--vehicles', '1,2']
        command += ['--strategy', 'default', '--seeds', '0..1', '--set', 'time_limit=300']
        assert main([*command, *where, '--output', str(tmp_path / name)]) == 0
    capsys.readouterr()
    for file in ('runs.csv', 'curves.json', 'table.md'):
        contents = {name: (tmp_path / name / file).read_bytes() for name in places}
        assert contents['two'] == contents['here'], file
        assert contents['dask'] == contents['here'], file
    assert (tmp_path / 'dask' / 'timings.csv').read_text().count('\n') == 5
