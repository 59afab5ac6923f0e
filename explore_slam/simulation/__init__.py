"""Simulated vehicles: a rendered simulator, a grid simulator, emulators of vehicle hardware.

Importing this package does not import MuJoCo; accessing `Simulator` does.
"""

from typing import TYPE_CHECKING, Any

from explore_slam.simulation.config import SimulationConfig
from explore_slam.simulation.grid.grid_simulator import warm_up
from explore_slam.simulation.records import Collision, SimEvent, TruePose
from explore_slam.simulation.worlds.loading import load_grid_world, load_world, world_path
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
    'load_grid_world',
    'load_world',
    'warm_up',
    'world_path',
]


def __getattr__(name: str) -> Any:
    """Import `Simulator` on first access (PEP 562)."""
    if name == 'Simulator':
        from explore_slam.simulation.rendered.simulator import Simulator

        return Simulator
    raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
