"""After warm_up no run in a grid world waits for the compiler."""

import numpy as np
from grid_worlds import drawn_world

from explore_slam import simulation
from explore_slam.data import Plan
from explore_slam.geometry import Pose2
from explore_slam.simulation.grid import kernels
from explore_slam.simulation.grid.grid_simulator import GridSimulator


def signatures():
    compiled = {n: k for n, k in vars(kernels).items() if hasattr(k, 'signatures')}
    return {name: [str(s) for s in kernel.signatures] for name, kernel in compiled.items()}


def test_nothing_is_compiled_after_warm_up():
    simulation.warm_up()
    before = signatures()
    assert sum(map(bool, before.values())) >= 5
    world = drawn_world(['########', '#......#', '#......#', '########'])
    starts = {'a': Pose2(1.0, 1.0, 0.0), 'b': Pose2(3.0, 1.0, 0.0)}
    simulator = GridSimulator(world, starts)
    goal = Pose2(2.0, 1.0, 0.0)
    simulator.set_plan('a', Plan(0.0, 'a', goal, np.array([[1.0, 1.0], [2.0, 1.0]])))
    for _ in range(20):
        simulator.step()
        simulator.scan('a')
    assert simulator.travelled('a') > 0.1
    new = {name for name, found in signatures().items() if not set(found) <= set(before[name])}
    # Loops that are only called by other loops are compiled with these.
    assert not [name for name in new if before[name]]
