"""`explore_slam report`: compare the metrics of run folders."""

import argparse
from pathlib import Path
from typing import Any

HELP = 'print the metrics of run folders side by side, and the paths of their reports'
METRICS = (
    ('mean_online_position_rms', 'position (m)', 3),
    ('mean_online_heading_rms', 'heading (rad)', 4),
    ('mean_odometry_position_rms', 'odometry (m)', 3),
    ('coverage', 'coverage', 3),
    ('collisions', 'collisions', 0),
    ('landmarks', 'landmarks', 0),
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        'runs', type=Path, nargs='*', default=[Path('runs/latest')], help='run folders'
    )
    parser.add_argument(
        '--map', type=Path, metavar='FILE', help='draw map and paths of the first run as PNG'
    )


def run(arguments: argparse.Namespace) -> int:
    """Print a table; with --map, draw the map of the first run."""
    from explore_slam.results.run_reader import read_metrics, read_run

    print(f'{"run":28s}' + ''.join(f'{title:>15s}' for _, title, _ in METRICS))
    for folder in arguments.runs:
        metrics = read_metrics(folder)
        cells = (_cell(metrics.get(name), digits) for name, _, digits in METRICS)
        print(f'{folder.resolve().name:28s}' + ''.join(cells))
    for folder in arguments.runs:
        print((folder / 'report.html').resolve())
    if arguments.map is not None:
        from explore_slam.results.plots import save_map_picture

        save_map_picture(read_run(arguments.runs[0]), arguments.map)
        print(f'map: {arguments.map}')
    return 0


def _cell(value: Any, digits: int) -> str:
    if isinstance(value, dict):  # counts per vehicle
        value = sum(value.values())
    return f'{"-":>15s}' if value is None else f'{float(value):15.{digits}f}'
