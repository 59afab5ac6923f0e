"""The decorator of compiled functions: bare and with options, NumPy's division, cached on disk."""

import math
import os
import subprocess
import sys

import numpy as np

from explore_slam.compiled import kernel


@kernel
def quotient(a, b):
    return a / b


@kernel(inline='always')
def doubled(a):
    return 2.0 * a


@kernel(nogil=False)
def sum_of_doubled(values):
    total = 0.0
    for value in values:
        total += doubled(value)
    return total


@kernel(reassociate=True)
def total(values):
    result = 0.0
    for value in values:
        result += value
    return result


def test_division_by_zero_gives_numpy_results():
    assert quotient(1.0, 0.0) == math.inf
    assert math.isnan(quotient(0.0, 0.0))


def test_options_reach_the_compiler():
    assert sum_of_doubled(np.arange(4.0)) == 12.0
    assert quotient.targetoptions['nogil']
    assert not sum_of_doubled.targetoptions['nogil']
    assert doubled.targetoptions['inline'] == 'always'
    assert not quotient.targetoptions['fastmath']
    assert math.isclose(total(np.full(1000, 0.1)), 100.0)
    assert 'reassoc' in total.targetoptions['fastmath']
    assert total.targetoptions['error_model'] == 'numpy'


BEFORE_AN_UPDATE = """
from typing import NamedTuple
from explore_slam.compiled import kernel


class Old(NamedTuple):
    value: float


@kernel
def doubled(given):
    return 2.0 * given.value


print(doubled(Old(2.0)))
"""


def test_an_update_that_renames_the_type_of_an_argument_reads_no_old_cache(tmp_path):
    module = tmp_path / 'updated.py'
    for name in ('Old', 'New'):
        module.write_text(BEFORE_AN_UPDATE.replace('Old', name))
        run = subprocess.run(
            [sys.executable, '-c', 'import updated'],
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
            env=os.environ | {'PYTHONPATH': os.pathsep.join([str(tmp_path), *sys.path])},
        )
        assert (run.returncode, run.stdout.strip()) == (0, '4.0'), run.stderr
    assert list(tmp_path.rglob('*.nbi')), 'the first run has written a cache'
