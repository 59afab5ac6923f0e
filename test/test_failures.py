"""What ends a command: one line with the cause, and the file with the trace; never a traceback."""

import errno
import json
import os
import re
import resource
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from explore_slam.cli import main as command_line
from explore_slam.errors import ConfigError
from explore_slam.failures import cause, described, run_guarded

REPOSITORY = Path(__file__).resolve().parents[1]


def raising(error):
    def run():
        raise error

    return run


@pytest.mark.parametrize(
    ('error', 'code', 'line'),
    [
        (ConfigError('seed is x, expected a number'), 1, 'p: seed is x, expected a number'),
        (KeyboardInterrupt(), 130, 'interrupted'),
        (BrokenPipeError(), 1, ''),
        (
            OSError(errno.ENOSPC, 'No space left on device', '/a/b'),
            1,
            'p: /a/b: No space left on device; what was written before stays',
        ),
    ],
)
def test_what_is_foreseen_is_one_line(capsys, error, code, line):
    assert run_guarded('p', raising(error)) == code
    assert capsys.readouterr().err.strip() == line


@pytest.mark.parametrize(
    ('error', 'words'),
    [
        (ValueError('two\nlines'), 'ValueError: two lines'),
        (AssertionError(), 'AssertionError'),
        (MemoryError(), 'out of memory'),
        (
            PermissionError(errno.EACCES, 'Permission denied', 'x.yaml'),
            'x.yaml: Permission denied',
        ),
        (ModuleNotFoundError("No module named 'rclpy'"), 'is the environment set up'),
        (UnicodeDecodeError('utf-8', b'\xff', 0, 1, 'invalid start byte'), 'UnicodeDecodeError'),
    ],
)
def test_what_is_not_foreseen_has_its_trace_in_a_file(capsys, error, words):
    assert run_guarded('explore_slam x', raising(error)) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith('explore_slam x: ')
    assert words in line
    trace = Path(re.search(r'\(full trace: (.*)\)$', line)[1])
    text = trace.read_text()
    trace.unlink()
    assert 'Traceback (most recent call last)' in text
    assert 'in raising' in text or 'in run' in text


def test_an_exception_group_and_a_chain_are_one_line():
    assert cause(ExceptionGroup('a and b', [ValueError('a')])).count('\n') == 0
    error = RuntimeError('outer')
    error.__cause__ = ValueError('inner')
    line = described('p', error)
    trace = Path(re.search(r'\(full trace: (.*)\)$', line)[1])
    assert 'ValueError: inner' in trace.read_text()
    trace.unlink()


def test_what_a_thread_raises_is_one_line(capsys):
    before = threading.excepthook

    def run():
        thread = threading.Thread(target=raising(ValueError('in a thread')))
        thread.start()
        thread.join()
        return 0

    try:
        assert run_guarded('p', run) == 0
    finally:
        threading.excepthook = before
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith('p: ValueError: in a thread (full trace: ')


def test_every_command_is_guarded(capsys, monkeypatch):
    """A fault in the import, in the options and in the run of a command."""
    for name in command_line.COMMANDS:
        monkeypatch.setitem(command_line.COMMANDS, name, 'no_such_module')
        assert command_line.main([name]) == 1
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith(f'explore_slam {name}: ')
        assert 'no_such_module' in line
        monkeypatch.undo()


def run(*arguments, **options):
    return subprocess.run(
        [sys.executable, *arguments], text=True, timeout=60, check=False, **options
    )


def test_output_to_a_full_disk():
    with open('/dev/full', 'w') as full:
        done = run(
            '-m',
            'explore_slam.cli.main',
            'settings',
            'driver',
            stdout=full,
            stderr=subprocess.PIPE,
        )
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert line == (
        'explore_slam settings: No space left on device; what was written before stays'
    )


RESULTS = """
import sys
from pathlib import Path
import numpy as np
from explore_slam.failures import run_guarded
from explore_slam.geometry import Pose2
from explore_slam.mapping import OccupancyGrid
from explore_slam.results.run_data import RunRecorder
from explore_slam.results.run_folder import RunFolder

def write():
    recorder = RunRecorder('a run', {'robot1': Pose2(0.0, 0.0, 0.0)}, 10)
    stamps = np.arange(20.0)
    grid = OccupancyGrid.from_probability(np.full((300, 300), 0.1), np.ones((300, 300), bool))
    data = recorder.finish({'robot1': (stamps, np.zeros((20, 3)))}, grid=grid)
    RunFolder.create(Path(sys.argv[1])).write_run(data)
    return 0

sys.exit(run_guarded('demo', write))
"""


def test_results_on_a_full_disk(tmp_path):
    """No file can grow beyond 12 kB: map and report are lost, the rest is written."""
    done = run(
        '-c', RESULTS, str(tmp_path), capture_output=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (12_000, 12_000)),
    )  # fmt: skip
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert re.match(r'demo: 2 of \d+ results cannot be written, the others are in ', line), line
    assert 'map cannot be written: File too large' in line
    assert 'report.html: File too large' in line
    folder = tmp_path / 'latest'
    assert json.loads((folder / 'metrics.json').read_text())
    assert (folder / 'robot1_estimated.tum').stat().st_size > 0
    assert not (folder / 'report.html').exists()
    assert not [path for path in os.listdir(folder) if path.endswith('.part')]


KERNEL = """
import sys
import numba
from explore_slam.compiled import kernel

@kernel
def add(a):
    return a + 1

print(add(2), numba.config.CACHE_DIR)
"""


def test_compiled_functions_without_a_folder_of_their_own(tmp_path):
    (tmp_path / 'script.py').write_text(KERNEL)
    done = run(
        str(tmp_path / 'script.py'), capture_output=True,
        env={**os.environ, 'NUMBA_CACHE_DIR': '/proc/none', 'TMPDIR': str(tmp_path)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ['3', str(tmp_path / f'explore_slam_{os.getuid()}' / 'numba')]
    assert '/proc/none cannot be written' in done.stderr


def test_compiled_functions_on_a_full_disk(tmp_path):
    (tmp_path / 'script.py').write_text(KERNEL)
    done = run(
        str(tmp_path / 'script.py'), capture_output=True,
        env={**os.environ, 'NUMBA_CACHE_DIR': str(tmp_path)},
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100)),
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ['3', str(tmp_path)]
    (line,) = done.stderr.splitlines()
    assert line == 'compiled functions cannot be kept for the next run: File too large'
