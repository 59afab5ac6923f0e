"""Nothing is compiled in the middle of a run."""

import subprocess
import sys

SCRIPT = """
import importlib
import pkgutil

import numpy as np
from numba.core.dispatcher import Dispatcher

from explore_slam import registration
from explore_slam.data import LaserScan
from explore_slam.geometry import IDENTITY, Pose2

registration.warm_up()
kernels = {}
for module in pkgutil.iter_modules(registration.__path__):
    name = f'explore_slam.registration.{module.name}'
    for label, value in vars(importlib.import_module(name)).items():
        if isinstance(value, Dispatcher):
            kernels[label] = value
before = {name: len(kernel.signatures) for name, kernel in kernels.items()}
assert len(kernels) > 8, sorted(kernels)
ranges = (2.0 + np.sin(np.arange(361) / 20.0)).astype(np.float32)
scan = LaserScan(0.0, -1.5, 0.01, ranges, 0.0, 10.0)
matcher = registration.ScanMatcher(registration.ScanMatchingConfig())
for x in (0.0, 0.1, 3.0, 0.5):
    matcher.match(scan, Pose2(0.1, 0.0, 0.2), Pose2(x, 0.0, 0.0), 1e-4 * np.eye(3))
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
