"""How the processes of the nodes end."""

import subprocess
import sys

import pytest

ENDS = """
import atexit, ctypes, importlib, sys, threading, time, types
from explore_slam.nodes import executables

libc = ctypes.CDLL(None)

def finish():
    time.sleep(0.3)
    print('thread', flush=True)

def main():
    threading.Thread(target=finish).start()
    atexit.register(print, 'exit function')  # not flushed
    unload = ctypes.cast(libc.abort, ctypes.c_void_p)
    libc.__cxa_atexit(unload, None, None)  # as a C++ library does
    {ending}

importlib.import_module = lambda name: types.SimpleNamespace(main=main)
sys.exit(executables.start('agent_node'))
"""


@pytest.mark.parametrize(
    ('ending', 'code'),
    [
        ('return 0', 0),
        ('return 1', 1),
        ("raise ValueError('a bug')", 1),
        ('sys.exit()', 0),
        ('sys.exit(2)', 2),
        ("sys.exit('a bug')", 1),
    ],
)
def test_the_exit_code_is_the_nodes_whatever_libraries_do_when_they_are_unloaded(ending, code):
    result = subprocess.run(
        [sys.executable, '-c', ENDS.format(ending=ending)],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert result.returncode == code, result.stderr
    assert result.stdout.split('\n') == ['thread', 'exit function', '']
    assert ('a bug' in result.stderr) is ('a bug' in ending)
