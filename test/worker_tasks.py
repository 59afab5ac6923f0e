"""Runs for tests of several workers, in a module that the workers can import."""

import os
import signal
import time

from explore_slam.errors import EvaluationError


def square(number):
    return number * number, os.getpid()


def die_once(number, marker):
    """End the process, as one that runs out of memory, the first time that it is asked for 3."""
    if number == 3 and not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.05)
    return number * number


def always_die():
    os.kill(os.getpid(), signal.SIGKILL)


def refuse(number):
    if number == 2:
        raise EvaluationError('the map is missing')
    return number
