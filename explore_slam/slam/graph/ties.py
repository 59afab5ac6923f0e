"""Connected components of the graph: vehicles that measurements tie together."""

import numpy as np
from scipy.sparse.csgraph import connected_components

from explore_slam.slam.graph.storage import Storage

Component = tuple[int, ...]


def components(storage: Storage) -> dict[int, Component]:
    """Return, for each vehicle, the vehicles that it is connected with, itself included.

    Vehicles are connected by landmarks that both have observed and by relative measurements.
    """
    vehicles = sorted(storage.newest)
    index = np.searchsorted(vehicles, storage.keyframes['vehicle'])
    factors, observations = storage.factors, storage.observations
    linked = np.eye(len(vehicles), dtype=np.bool_)
    between = factors['a'] >= 0
    linked[index[factors['a'][between]], index[factors['b'][between]]] = True
    alive = observations['landmark'] >= 0
    landmark, observer = observations['landmark'][alive], index[observations['keyframe'][alive]]
    some = np.zeros(len(storage.landmarks), np.int64)
    some[landmark] = observer  # one of the vehicles that observed each landmark
    linked[some[landmark], observer] = True
    _, label = connected_components(linked, directed=False)
    return {
        vehicle: tuple(v for v, other in zip(vehicles, label, strict=True) if other == own)
        for vehicle, own in zip(vehicles, label, strict=True)
    }
