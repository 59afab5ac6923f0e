"""`explore_slam report`: the figures of run folders side by side, and where their reports are."""

import argparse
import json
from pathlib import Path
from typing import Any

HELP = 'show the figures of one or more run folders'
FIGURES = (
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


def run(arguments: argparse.Namespace) -> int:
    """Print a table."""
    print(f'{"run":28s}' + ''.join(f'{title:>15s}' for _, title, _ in FIGURES))
    for folder in arguments.runs:
        metrics = _read(folder)
        cells = (_cell(metrics.get(name), digits) for name, _, digits in FIGURES)
        print(f'{folder.resolve().name:28s}' + ''.join(cells))
    for folder in arguments.runs:
        print((folder / 'report.html').resolve())
    return 0


def _read(folder: Path) -> dict[str, Any]:
    from explore_slam.errors import EvaluationError

    path = folder / 'metrics.json'
    try:
        content = json.loads(path.read_text(encoding='utf-8'))
    except (OSError, ValueError) as error:
        raise EvaluationError(f'{path} cannot be read: {error}') from error
    if not isinstance(content, dict):
        raise EvaluationError(f'{path} holds {type(content).__name__}, expected an object')
    return content


def _cell(value: Any, digits: int) -> str:
    if isinstance(value, dict):  # counts per vehicle
        value = sum(value.values())
    return f'{"-":>15s}' if value is None else f'{float(value):15.{digits}f}'
