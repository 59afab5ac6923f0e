"""`explore_slam replay`: a recording through the agent, offline, into a run folder."""

import argparse
import math
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from explore_slam.geometry import Pose2
    from explore_slam.results.run_data import RunData

HELP = 'run a recorded bag through the agent and write a run folder'
THREAD_VARIABLES = (
    'OMP_NUM_THREADS',
    'OPENBLAS_NUM_THREADS',
    'MKL_NUM_THREADS',
    'NUMBA_NUM_THREADS',
    'OPENCV_FOR_THREADS_NUM',
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument('bag', type=Path, help='rosbag2 folder, or its .mcap or .db3 file')
    parser.add_argument('--maps', choices=('common', 'dedicated'), help='one map, or one each')
    parser.add_argument('--engine', choices=('fastslam2', 'paper'), help='which FastSLAM')
    parser.add_argument('--particles', type=int, help='number of particles')
    parser.add_argument('--seed', type=int, default=0, help='of all randomness (default 0)')
    parser.add_argument(
        '--config', type=Path, help='ROS parameter file; replaces the settings in the bag'
    )
    parser.add_argument(
        '--set',
        action='append',
        default=[],
        metavar='NAME=VALUE',
        help='one more setting; may be repeated',
    )
    parser.add_argument('--vehicles', nargs='+', default=(), help='only these vehicles')
    parser.add_argument(
        '--start',
        action='append',
        default=[],
        metavar='VEHICLE=X,Y,THETA',
        help='start pose in the map (m, rad), where the bag has none',
    )
    parser.add_argument('--until', type=float, metavar='SECONDS', help='stop after this time')
    parser.add_argument('--threads', type=int, help='most threads of the numeric libraries')
    parser.add_argument(
        '--out', type=Path, default=Path('runs'), help='where run folders go (default runs)'
    )
    parser.add_argument('--no-progress', action='store_true', help='do not draw the bar')


def run(arguments: argparse.Namespace) -> int:
    """Replay, write the run folder, print errors beside odometry alone."""
    _limit_threads(arguments.threads)
    from explore_slam.cli.progress import progress_bar
    from explore_slam.cli.settings_options import named_settings
    from explore_slam.results.replay_run import replay_bag
    from explore_slam.results.run_folder import RunFolder
    from explore_slam.settings import load_settings

    config = None
    if arguments.config:  # may be a file of the live agent, which has parameters of the node too
        from explore_slam.nodes.agent_parameters import AgentNodeConfig

        config = load_settings(AgentNodeConfig(), arguments.config).agent
    with progress_bar(arguments.bag.name, enabled=not arguments.no_progress) as show:
        data = replay_bag(
            arguments.bag,
            config=config,
            options=named_settings(arguments, ('maps', 'engine', 'particles')),
            seed=arguments.seed,
            vehicles=arguments.vehicles,
            starts=dict(_start(text) for text in arguments.start),
            until=arguments.until,
            progress=show,
        )
    folder = RunFolder.create(arguments.out)
    report = folder.write_run(data)
    print_summary(data)
    print(f'report: {report}')
    return 0


def _limit_threads(count: int | None) -> None:
    """Bound the threads of libraries that are not loaded yet."""
    if count is None:
        return
    from explore_slam.errors import ConfigError

    if count < 1:
        raise ConfigError(f'--threads is {count}, expected at least 1')
    for name in THREAD_VARIABLES:
        os.environ[name] = str(count)


def _start(text: str) -> tuple[str, 'Pose2']:
    from explore_slam.errors import ConfigError
    from explore_slam.geometry import Pose2

    name, _, values = text.partition('=')
    try:
        x, y, theta = (float(value) for value in values.split(','))
    except ValueError:
        raise ConfigError(f'--start is {text!r}, expected VEHICLE=X,Y,THETA') from None
    pose = Pose2(x, y, theta)
    if not name or not pose.is_finite():
        raise ConfigError(f'--start is {text!r}, expected VEHICLE=X,Y,THETA')
    return name, pose


def print_summary(data: 'RunData') -> None:
    """Print errors per vehicle, odometry alone beside them, and what else was measured."""
    for note in data.notes:
        print(f'note: {note}', file=sys.stderr)
    vehicles = data.metrics.get('vehicles', {})
    if any(found.get('online') for found in vehicles.values()):
        print(
            f'{"":12s}{"position RMS (m)":>36s}{"heading RMS (deg)":>34s}\n'
            f'{"vehicle":12s}{"online":>12s}{"final":>12s}{"odometry":>12s}'
            f'{"online":>12s}{"final":>11s}{"odometry":>11s}'
        )
        for name, found in vehicles.items():
            print(_line(name, found))
        if len(vehicles) > 1:
            print(_mean_line(data.metrics))
    for name, found in data.metrics.get('observations', {}).items():
        print(name, ', '.join(f'{key} {value:.4g}' for key, value in found.items()))
    if 'coverage' in data.metrics:
        share = data.coverage_unit == '%'
        value = data.metrics['coverage'] * (100.0 if share else 1.0)
        print(f'{"explored" if share else "known area"} {value:.1f} {data.coverage_unit}')
    if 'landmarks' in data.metrics:
        print(f'landmarks {data.metrics["landmarks"]}')
    timing = data.metrics.get('timing')
    if timing:
        print(
            f'{timing["recorded_seconds"]:.1f} s recorded, {timing["wall_seconds"]:.1f} s needed'
        )


_CELLS = (('online', 12), ('estimated', 12), ('odometry', 12))


def _line(name: str, found: dict[str, Any]) -> str:
    return f'{name:12s}' + ''.join(
        _cell(found.get(kind), metric, factor, digits, width)
        for metric, factor, digits, width_of in (
            ('position_rms', 1.0, 3, (12, 12, 12)),
            ('heading_rms', 180.0 / math.pi, 2, (12, 11, 11)),
        )
        for (kind, _), width in zip(_CELLS, width_of, strict=True)
    )


def _cell(
    errors: dict[str, float] | None, metric: str, factor: float, digits: int, width: int
) -> str:
    if not errors:
        return f'{"-":>{width}s}'
    return f'{factor * errors[metric]:{width}.{digits}f}'


def _mean_line(metrics: dict[str, Any]) -> str:
    found: dict[str, dict[str, float]] = {}
    for kind, _ in _CELLS:
        values = {
            name: metrics[f'mean_{kind}_{name}']
            for name in ('position_rms', 'heading_rms')
            if f'mean_{kind}_{name}' in metrics
        }
        if len(values) == 2:
            found[kind] = values
    return _line('mean', found)
