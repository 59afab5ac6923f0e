"""Run all benchmarks: `make bench`, or `make bench ARGS='slam planning'` for some.

Benchmarks on recordings are skipped, with a message, unless EXPLORE_SLAM_DATA is their folder.
"""

import os
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
DATA = Path(os.environ.get('EXPLORE_SLAM_DATA', HERE.parents[1] / 'shared' / 'data'))
# Script, its arguments, and the recordings that it takes as first argument.
BENCHMARKS: list[tuple[str, list[str], str | None]] = [
    ('slam_speed', ['all'], None),
    ('slam_mrclam', [], 'mrclam6'),
    ('mapping_speed', [], None),
    ('mapping_intel', [], 'intel_lab'),
    ('planning_speed', [], None),
    ('planning_cycles', [], None),
    ('simulation_speed', [], None),
    ('vehicle_following', [], None),
    ('vehicle_faults', [], None),
    ('vehicle_driver', [], None),
    ('vehicle_recordings', [], 'lms200'),
    ('vehicle_fuzz', [], None),
    ('demo_seeds', [], None),
]


def main(wanted: list[str]) -> int:
    """Run the benchmarks whose name contains one of the words; return the number of failures."""
    failed = 0
    for name, arguments, recordings in BENCHMARKS:
        if wanted and not any(word in name for word in wanted):
            continue
        folder = [] if recordings is None else [str(DATA / recordings)]
        if recordings is not None and not (DATA / recordings).exists():
            print(
                f'== {name}: skipped, {DATA / recordings} does not exist (set EXPLORE_SLAM_DATA)'
            )
            continue
        print(f'== {name} {" ".join(folder + arguments)}', flush=True)
        command = [sys.executable, str(HERE / f'{name}.py'), *folder, *arguments]
        failed += subprocess.run(command, check=False).returncode != 0
    return failed


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
