"""ROS domains for tests: those of two runs on one machine do not mix."""

import os


def own_domain(number: int) -> int:
    """Return the domain of a test module by its number; domains up to 101 suit Linux' ports."""
    return 1 + (number + 17 * os.getpid()) % 100
