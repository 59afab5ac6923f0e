"""Nothing is compiled in the middle of a run: seconds would pass in which vehicles drive on."""

import subprocess
import sys

SCRIPT = """
import importlib
import pkgutil

from numba.core.dispatcher import Dispatcher

from explore_slam import slam
from explore_slam.studies.experiments.scenarios import draw_scenario
from explore_slam.settings import with_values

slam.warm_up()
kernels = {}
for module in pkgutil.walk_packages(slam.__path__, "explore_slam.slam."):
    for name, value in vars(importlib.import_module(module.name)).items():
        if isinstance(value, Dispatcher):
            kernels[f'{module.name}.{name}'] = value
before = {name: len(kernel.signatures) for name, kernel in kernels.items()}
assert len(kernels) > 20, sorted(kernels)
for engine in ('fastslam2', 'paper'):
    values = {'engine': engine, 'maximum_descriptor_distance': 0.0}
    scene = draw_scenario('late crossing', 1)
    config = with_values(slam.FastSlamConfig(), values)
    belief = slam.FastSlam(scene.start_poses, config, seed=1)
    for step in scene.steps:
        belief.predict(step.vehicle, step.increment, step.covariance)
        if len(step.observations):
            belief.update(step.vehicle, step.observations)
        belief.add_keyframe(step.vehicle, step.observations.stamp)
    belief.best_path()
    belief.landmarks()
for name, kernel in kernels.items():
    if len(kernel.signatures) != before[name]:
        print(name, kernel.signatures)
"""


def test_a_run_compiles_nothing_after_warm_up():
    done = subprocess.run(
        [sys.executable, '-c', SCRIPT], capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == ''
