"""ROS domains for tests: those of two runs on one machine, and of two test modules, do not mix."""

import os
import zlib

_WORKERS = 16  # numbers below are those of processes, the others those of test modules


def own_domain(number: int) -> int:
    """Return the domain of a test module by its number (16 to 99).

    All processes of one run of pytest agree on it. Domains up to 101 suit Linux' ports.
    """
    run = os.environ.get('PYTEST_XDIST_TESTRUNUID')
    start = os.getpid() if run is None else zlib.crc32(run.encode())
    return 1 + (number + 17 * start) % 100


def default_domain() -> int:
    """Return the domain of what a test starts without saying one, by the process it runs in."""
    worker = os.environ.get('PYTEST_XDIST_WORKER', 'gw0').removeprefix('gw')
    return own_domain(int(worker) % _WORKERS)
