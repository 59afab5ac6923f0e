"""Which vehicles measurements connect."""

import numpy as np

from explore_slam.slam.graph.storage import Storage

Component = tuple[int, ...]


def components(storage: Storage) -> dict[int, Component]:
    """Return, for each vehicle, the vehicles that it is connected with, itself included.

    Vehicles are connected by landmarks that both have observed and by relative measurements.
    """
    vehicle = storage.keyframes['vehicle']
    factors, observations = storage.factors, storage.observations
    between = factors['a'] >= 0
    links = set(
        zip(
            vehicle[factors['a'][between]].tolist(),
            vehicle[factors['b'][between]].tolist(),
            strict=True,
        )
    )
    alive = observations['landmark'] >= 0
    landmark, observer = observations['landmark'][alive], vehicle[observations['keyframe'][alive]]
    some = np.zeros(len(storage.landmarks), np.int64)
    some[landmark] = observer  # one of the vehicles that observed each landmark
    differ = some[landmark] != observer
    pairs = np.unique(np.stack([some[landmark], observer], axis=1)[differ], axis=0)
    links.update((int(a), int(b)) for a, b in pairs)
    group = {v: {v} for v in storage.newest}
    for a, b in sorted(links):
        if group[a] is not group[b]:
            group[a] |= group[b]
            for member in group[b]:
                group[member] = group[a]
    return {v: tuple(sorted(members)) for v, members in group.items()}
