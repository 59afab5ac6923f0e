"""Simulated vehicles in a world; see doc/architecture.

`World` and the grid world need nothing special; `Simulator` imports MuJoCo, and only when it is
asked for.
"""

from typing import TYPE_CHECKING, Any

from explore_slam.simulation.config import SimulationConfig
from explore_slam.simulation.records import Collision, SimEvent, TruePose
from explore_slam.simulation.worlds.world import World

if TYPE_CHECKING:
    from explore_slam.simulation.rendered.simulator import Simulator

__all__ = [
    'Collision',
    'SimEvent',
    'SimulationConfig',
    'Simulator',
    'TruePose',
    'World',
    'warm_up',
]


def __getattr__(name: str) -> Any:
    if name == 'Simulator':
        from explore_slam.simulation.rendered.simulator import Simulator

        return Simulator
    raise AttributeError(f'module {__name__!r} has no attribute {name!r}')


def warm_up() -> None:
    """Compile the kernels of the grid world, or read them from the cache."""
    from explore_slam.simulation.grid import grid_simulator

    grid_simulator.warm_up()
