"""The live demo over several seeds: coverage, collisions, errors beside odometry, latency.

python benchmarks/demo_seeds.py --seeds 5
"""

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

ROWS = (
    ('seconds', 'wall time (s)', 1.0),
    ('duration', 'simulated time (s)', 1.0),
    ('coverage', 'explored (%)', 100.0),
    ('collisions', 'collisions', 1.0),
    ('position', 'position RMS, mean of vehicles (m)', 1.0),
    ('worst', 'position RMS, worst vehicle (m)', 1.0),
    ('odometry', 'position RMS of odometry alone (m)', 1.0),
    ('latency', 'image stamp to pose, median (ms)', 1.0),
    ('latency95', 'image stamp to pose, p95 (ms)', 1.0),
)


def run_once(seed: int, options: list[str], out: Path) -> dict[str, float]:
    """Run the demo as a command; return its metrics."""
    began = time.monotonic()
    command = [sys.executable, '-m', 'explore_slam.cli.main', 'demo', '--seed', str(seed)]
    done = subprocess.run(
        [*command, '--out', str(out), *options], capture_output=True, text=True, check=False
    )
    seconds = time.monotonic() - began
    if done.returncode not in (0, 1):
        raise SystemExit(done.stdout[-1000:] + done.stderr)
    metrics = json.loads((out / 'latest' / 'metrics.json').read_text())
    vehicles = [found['online']['position_rms'] for found in metrics['vehicles'].values()]
    agent = metrics['agent']
    return {
        'seconds': seconds,
        'duration': metrics['duration'],
        'coverage': metrics['coverage'],
        'collisions': float(sum(metrics['collisions'].values())),
        'position': float(np.mean(vehicles)),
        'worst': max(vehicles),
        'odometry': metrics['mean_odometry_position_rms'],
        'latency': 1e3 * agent['wall_latency_median_s'],
        'latency95': 1e3 * agent['wall_latency_p95_s'],
        'complete': float(metrics['complete']),
    }


def main() -> int:
    """Run all seeds and print a table: one column per seed, then mean and deviation."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seeds', type=int, default=5)
    parser.add_argument('--first', type=int, default=0)
    parser.add_argument('--out', type=Path, default=Path('runs'))
    parser.add_argument('options', nargs='*', help='further options of the demo, after --')
    arguments = parser.parse_args()
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    found = []
    for seed in seeds:
        found.append(run_once(seed, arguments.options, arguments.out))
        print(f'seed {seed}: {json.dumps(found[-1])}', flush=True)
    print(f'{"":38s}' + ''.join(f'{seed:>9d}' for seed in seeds) + f'{"mean":>9s}{"std":>9s}')
    for key, label, factor in ROWS:
        values = np.array([one[key] for one in found]) * factor
        cells = ''.join(f'{value:9.3f}' for value in [*values, values.mean(), values.std()])
        print(f'{label:38s}{cells}')
    return 0 if all(one['complete'] for one in found) else 1


if __name__ == '__main__':
    sys.exit(main())
