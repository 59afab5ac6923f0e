"""Nothing of the graph is compiled in the middle of a run."""

import subprocess
import sys

SCRIPT = """
import importlib
import pkgutil

import numpy as np
from numba.core.dispatcher import Dispatcher

from explore_slam.slam import graph

graph.warm_up()
kernels = {}
for module in pkgutil.iter_modules(graph.__path__, 'explore_slam.slam.graph.'):
    for name, value in vars(importlib.import_module(module.name)).items():
        if isinstance(value, Dispatcher):
            kernels[name] = value
before = {name: len(kernel.signatures) for name, kernel in kernels.items()}
assert len(kernels) > 20, sorted(kernels)
noise = 1e-4 * np.eye(3)
joint = graph.JointGraph()
for vehicle in (0, 1):
    joint.add_start(vehicle, vehicle, [0.0, vehicle, 0.0])
for k in range(2, 60):
    joint.add_keyframe(k % 2, k, (0.1, 0, 0), noise, None if k % 3 else noise)
    joint.add_observations(k, [k // 5], [[1, 2, 3]], [[1, 0, 0, 1, 0, 1]])
closure = joint.add_relative_pose(58, 59, [0, 1, 0], np.diag([1, 1, 0]))
joint.add_relative_position(57, 58, [0, 1], np.eye(2))
state = joint.state_dict()
problem = joint.snapshot(0)
solution = joint.solve(problem)
joint.adopt(solution)
draws = joint.draw(7, np.random.default_rng(0))
joint.covariance(59), joint.relative_covariance(59, [58, 57]), joint.path()
joint.closure_residuals()
joint.remove_factor(closure)
joint = graph.JointGraph.from_state(state)
joint.merge_landmarks([3], [4])
joint.remove_landmarks([5])
joint.optimize()
stored = joint.observations_of([8, 9])
out = np.empty((2, 9, 7))
node = stored.located(draws.keyframes)
graph.fuse_rows(stored.first, node, stored.z, stored.W, draws.poses, out, 0, 7)
after = {name: len(kernel.signatures) for name, kernel in kernels.items()}
assert before == after, {n: (before[n], after[n]) for n in before if before[n] != after[n]}
"""


def test_no_kernel_is_compiled_after_warm_up():
    run = subprocess.run(
        [sys.executable, '-c', SCRIPT], capture_output=True, text=True, timeout=300, check=False
    )
    assert run.returncode == 0, run.stderr
