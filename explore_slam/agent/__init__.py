"""The central agent without ROS: filter, occupancy grid and planner for a team of vehicles."""

import threading
import time
from collections.abc import Callable

from explore_slam import exploration, mapping, registration, slam
from explore_slam.agent.agent import Agent
from explore_slam.agent.config import AgentConfig, explicit_mounts
from explore_slam.agent.loop_closing import Join
from explore_slam.agent.operator_areas import OperatorAreas
from explore_slam.agent.team import KeyframeEvent
from explore_slam.agent.team_planner import TeamPlanner
from explore_slam.slam import closures
from explore_slam.vision import obstacles

__all__ = [
    'Agent',
    'AgentConfig',
    'Join',
    'KeyframeEvent',
    'OperatorAreas',
    'TeamPlanner',
    'explicit_mounts',
    'warm_up',
]


_LOADING = 3.0  # s; loading all kernels from the cache takes half of that
_NOTICEABLE = 1.0  # s; what takes less is no step of the progress


def warm_up(progress: Callable[[str], None] | None = None) -> None:
    """Compile all kernels that the agent runs, or load them from the cache.

    progress: called with a sentence, from any thread, if it takes longer than loading does: first
    that kernels are compiled, then which part of them is done. A part that shares its kernels with
    those before takes no time, and is not named.
    """
    packages = (registration, slam, closures, mapping, obstacles, exploration)
    compiling = threading.Event()

    def announce() -> None:
        compiling.set()
        if progress is not None:
            progress('compiling kernels (once, about a minute) ...')

    timer = threading.Timer(_LOADING, announce)
    timer.daemon = True
    timer.start()
    try:
        for number, package in enumerate(packages, 1):
            begun = time.monotonic()
            package.warm_up()
            worth_saying = package is packages[-1] or time.monotonic() - begun > _NOTICEABLE
            if compiling.is_set() and progress is not None and worth_saying:
                name = package.__name__.rpartition('.')[2]
                progress(f'kernels of {name} are ready ({number} of {len(packages)})')
    finally:
        timer.cancel()
