"""The executables of the nodes; each imports its module only when it starts.

An import that fails, of ROS or of a library, is one line then, as any other failure is
(`run_guarded`).
"""

import atexit
import contextlib
import importlib
import logging
import os
import sys

from explore_slam.environment import prepare_ros, return_large_arrays, start_isolated
from explore_slam.failures import run_guarded


class _ProcessEnd:
    """Last step of the interpreter, after its threads and what libraries do at the exit.

    It leaves the process with the node's exit code before the C++ libraries of DDS are unloaded,
    which may take the process down beside threads that are still in them (seen once on Kilted,
    exit code -11).
    """

    def __init__(self) -> None:
        self.code = 1

    def __call__(self) -> None:
        logging.shutdown()
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError):
                stream.flush()
        os._exit(self.code)


def start(module: str) -> int:
    """Run the node of a module of this package; return the exit code."""
    start_isolated()
    end = _ProcessEnd()
    atexit.register(end)  # functions registered first run last

    def run() -> int:
        prepare_ros(os.environ)
        return_large_arrays()
        return int(importlib.import_module(f'explore_slam.nodes.{module}').main())

    try:
        end.code = run_guarded(module, run)
    except SystemExit as leaving:  # of the options, as after --help
        end.code = _exit_code(leaving)
        raise
    return end.code


def _exit_code(leaving: SystemExit) -> int:
    """Return the exit code that the interpreter gives a SystemExit: 1 if it holds a message."""
    code = leaving.code
    return code if isinstance(code, int) else int(code is not None)


def agent() -> int:
    """Run the agent."""
    return start('agent_node')


def pioneer_driver() -> int:
    """Run the driver of a vehicle."""
    return start('pioneer_driver')


def path_follower() -> int:
    """Run the path follower of a vehicle."""
    return start('path_follower')


def feature_extractor() -> int:
    """Run the feature extractor of a vehicle."""
    return start('feature_extractor')


def simulator() -> int:
    """Run the simulator."""
    return start('simulator')


def recorder() -> int:
    """Run the recorder."""
    return start('recorder')


def player() -> int:
    """Run the player."""
    return start('player')


if __name__ == '__main__':  # python -m explore_slam.nodes.executables MODULE ...
    del sys.argv[0]
    sys.exit(start(sys.argv[0]))
