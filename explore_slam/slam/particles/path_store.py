"""Poses of keyframes in all particles, stored along the lineages that still exist."""

import numpy as np
from numpy.typing import NDArray

from explore_slam.geometry import Array
from explore_slam.slam.checkpoint import State, part, under
from explore_slam.slam.storage.ancestry import AncestryTree
from explore_slam.slam.storage.row_store import ParticleOf, RowStore


class PathStore:
    """Keyframes 0, 1, 2 … over all vehicles: stamp, vehicle and a pose per particle."""

    def __init__(self, particles: int) -> None:
        self.rows = RowStore(particles, 3)
        self.stamps: list[float] = []
        self.vehicles: list[int] = []
        self.nodes: list[int] = []  # of the joint graph, where that holds the poses

    def __len__(self) -> int:
        return len(self.stamps)

    def append(self, vehicle: int, stamp: float, poses: Array, tree: AncestryTree) -> int:
        """Store the poses (M, 3) of a keyframe and return its number."""
        number = len(self.stamps)
        addresses = self.rows.allocate(1)
        self.rows.workspace[addresses[0]] = poses.T
        self.rows.commit(np.array([number], np.int64), addresses, tree)
        self.stamps.append(stamp)
        self.vehicles.append(vehicle)
        return number

    def append_node(self, vehicle: int, stamp: float, node: int) -> int:
        """Append a keyframe whose pose is a node of the joint graph; return its number."""
        self.stamps.append(stamp)
        self.vehicles.append(vehicle)
        self.nodes.append(node)
        return len(self.stamps) - 1

    def of_particle(self, particle_of: ParticleOf) -> Array:
        """Return the poses (K, 3) of all keyframes along the lineage of a particle."""
        return self.rows.read_particle(np.arange(len(self), dtype=np.int64), particle_of)

    def of_vehicle(self, vehicle: int) -> NDArray[np.int64]:
        """Return the numbers of the keyframes of one vehicle."""
        return np.flatnonzero(np.array(self.vehicles, np.int64) == vehicle)

    def state_dict(self) -> State:
        """Return all keyframes; ancestry trees save themselves."""
        return {
            'stamps': np.array(self.stamps, np.float64),
            'vehicles': np.array(self.vehicles, np.int64),
            'nodes': np.array(self.nodes, np.int64),
            **under('rows', self.rows.state_dict()),
        }

    def restore(self, state: State) -> None:
        """Restore a store of the same number of particles."""
        self.stamps = state['stamps'].tolist()
        self.vehicles = state['vehicles'].tolist()
        self.nodes = state['nodes'].tolist()
        self.rows.restore(part('rows', state))
