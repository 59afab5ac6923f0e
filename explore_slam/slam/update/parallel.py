"""Kernels over ranges of particles on several threads; every split gives the same bits."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise

from explore_slam.slam.update.blocks import BLOCK


@cache
def _executor(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix='particles')


def over_particles(call: Callable[[int, int], None], particles: int, threads: int) -> None:
    """Run call(begin, end) over 0 … particles, split between blocks, one part per thread."""
    blocks = -(-particles // BLOCK)
    parts = max(1, min(threads, blocks))
    edges = [min(particles, BLOCK * (blocks * part // parts)) for part in range(parts + 1)]
    others = [_executor(threads).submit(call, begin, end) for begin, end in pairwise(edges[1:])]
    call(edges[0], edges[1])
    for other in others:
        other.result()
