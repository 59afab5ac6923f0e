"""Nothing is compiled in the middle of a search for loops."""

import subprocess
import sys
from pathlib import Path

SCRIPT = """
import importlib
import pkgutil
import sys

import numpy as np
from numba.core.dispatcher import Dispatcher

from explore_slam import registration
from explore_slam.slam import closures, graph

closures.warm_up()
graph.warm_up()
kernels = {}
for module in pkgutil.iter_modules(registration.__path__):
    name = f'explore_slam.registration.{module.name}'
    for label, value in vars(importlib.import_module(name)).items():
        if isinstance(value, Dispatcher):
            kernels[label] = value
before = {name: len(kernel.signatures) for name, kernel in kernels.items()}
from slam.closures.drives import Vehicle, along, drive
from slam.closures.test_global_search import joined
from slam.closures.test_loop_search import LAP, OFFICE

path = along(*LAP, *LAP[1:2])
run = drive(lambda *_: OFFICE, [Vehicle(path, way_scale=1.01)], calibrated=True)
assert run.search.closures
restored = closures.LoopSearch.from_state(run.search.state_dict(), run.search.config)
restored.search(len(path) - 1, run.graph.path())
assert joined(OFFICE, along(*LAP), along(LAP[3], LAP[2], LAP[1], LAP[0]))[0]
for name, kernel in kernels.items():
    if len(kernel.signatures) != before[name]:
        print(name, kernel.signatures)
"""


def test_a_search_compiles_nothing_after_warm_up():
    tests = Path(__file__).resolve().parents[2]
    code = f'import sys; sys.path.insert(0, {str(tests)!r})\n' + SCRIPT
    done = subprocess.run(
        [sys.executable, '-c', code], capture_output=True, text=True, timeout=600, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == ''
