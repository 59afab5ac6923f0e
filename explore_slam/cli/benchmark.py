"""`explore_slam benchmark KIND`: studies, one for each entry of KINDS."""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from explore_slam.cli import (
    benchmark_mapping,
    benchmark_obstacles,
    benchmark_sensors,
    benchmark_tags,
)
from explore_slam.cli.arguments import (
    add_seeds_option,
    add_set_option,
    add_workers_options,
    named_settings,
    whole_numbers,
    workers_of,
)

if TYPE_CHECKING:
    from explore_slam.studies.exploration_run import ExplorationRun

HELP = (
    'measure exploration, mapping, consistency, endurance, aliasing, obstacles, sensors, or tags'
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    kinds = parser.add_subparsers(dest='kind', required=True, metavar='KIND')
    for name, (summary, declare, _) in KINDS.items():
        kind = kinds.add_parser(name, help=summary, description=summary.capitalize() + '.')
        declare(kind)


def run(arguments: argparse.Namespace) -> int:
    """Run the study of this kind."""
    _, _, study = KINDS[arguments.kind]
    return study(arguments)


def _configure_exploration(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        '--map', type=Path, required=True, help='map_server map (YAML or PGM) or a world file'
    )
    parser.add_argument(
        '--vehicles', type=whole_numbers, default=[1, 2, 4], help='team sizes: 1..8 or 1,2,4'
    )
    parser.add_argument(
        '--strategy',
        action='append',
        metavar='NAME',
        help='exploration strategy; may be repeated (default: default and nearest)',
    )
    parser.add_argument(
        '--scenario', type=Path, metavar='FILE', help='events of the runs: doors, people, failures'
    )
    parser.add_argument(
        '--slam',
        action='store_true',
        help='run the whole agent, with laser and wheel odometry (--set simulated_drift_variance, '
        'range_noise, ...), instead of known poses; runs.csv then has map_rms (m), the position '
        'error of the scans in the map',
    )
    add_seeds_option(parser, range(10))
    add_workers_options(parser)
    parser.add_argument('--output', type=Path, help='folder for table, runs and plots')
    add_set_option(parser)


def _run_exploration(arguments: argparse.Namespace) -> int:
    """Make the runs, print their table, save it with --output."""
    from explore_slam.studies.exploration_study import make_study, run_study
    from explore_slam.studies.exploration_tables import markdown_table, save_study

    study = make_study(
        arguments.map,
        arguments.vehicles,
        arguments.strategy or ['default', 'nearest'],
        arguments.seeds,
        arguments.set,
        arguments.scenario,
        arguments.slam,
    )
    total = sum(1 for _ in study.tasks())
    runs = []
    for done in run_study(study, workers_of(arguments)):
        runs.append(done)
        print(
            f'[{len(runs)}/{total}] {done.strategy}, {done.vehicles} vehicles, seed {done.seed}: '
            f'{done.status} after {done.duration:.0f} s, 99 % after '
            f'{done.curve.time_to(0.99):.0f} s, {done.real_time_factor:.0f} x real time'
            f'{_unreached(done)}{_map_error(done)}',
            file=sys.stderr,
            flush=True,
        )
    print(markdown_table(runs))
    if arguments.output is not None:
        for path in save_study(runs, arguments.output):
            print(f'written: {path}', file=sys.stderr)
    return 0


def _unreached(run: 'ExplorationRun') -> str:
    """Return what a run has left, '' if nothing."""
    from explore_slam.exploration import unreached_text

    if not run.unreached_frontiers:
        return ''
    return f', {unreached_text(run.unreached_frontiers, run.unreached_m2)} out of reach'


def _map_error(run: 'ExplorationRun') -> str:
    """Return the position error of the map of a run with SLAM, '' if poses were known."""
    return '' if run.map_rms is None else f', map_rms {run.map_rms:.3f} m'


def _add_world(parser: argparse.ArgumentParser, duration: float) -> None:
    parser.add_argument(
        '--world', default='office', help='world file, map_server YAML, or name (default office)'
    )
    parser.add_argument('--vehicles', type=int, default=2, help='number of vehicles (default 2)')
    parser.add_argument(
        '--duration',
        type=float,
        default=duration,
        help=f'simulated time (s) after which a run ends (default {duration:g})',
    )


def _configure_consistency(parser: argparse.ArgumentParser) -> None:
    _add_world(parser, 300.0)
    parser.add_argument(
        '--vision',
        choices=('agent', 'none'),
        default='agent',
        help='features from the cameras, or laser and odometry alone (default agent)',
    )
    add_seeds_option(parser, range(5))
    add_workers_options(parser)
    parser.add_argument(
        '--output', type=Path, required=True, help='folder for consistency.json, plots and runs'
    )
    add_set_option(parser)


def _run_consistency(arguments: argparse.Namespace) -> int:
    """Make the runs, report each as it ends, print the table."""
    from explore_slam.simulation import world_path
    from explore_slam.studies.consistency_study import (
        ConsistencyStudy,
        markdown_table,
        run_study,
    )

    study = ConsistencyStudy(
        world_path(arguments.world),
        arguments.vehicles,
        arguments.vision,
        arguments.duration,
        tuple(arguments.seeds),
        named_settings(arguments, ()),
    )
    results = []
    for result in run_study(study, arguments.output, workers_of(arguments)):
        results.append(result)
        found = ', '.join(
            f'{item.vehicle} NEES {item.pose_nees_mean:.1f}, inside {item.position_in_95:.2f}, '
            f'RMS {item.position_rms:.4f} m'
            for item in result.runs
        )
        print(
            f'[{len(results)}/{len(study.seeds)}] seed {result.seed}: {found}',
            file=sys.stderr,
            flush=True,
        )
    results.sort(key=lambda result: result.seed)
    print(markdown_table([item for result in results for item in result.runs]))
    print(f'written: {arguments.output / "consistency.json"}', file=sys.stderr)
    return 0


def _configure_endurance(parser: argparse.ArgumentParser) -> None:
    _add_world(parser, 3600.0)
    parser.add_argument('--seed', type=int, default=0, help='random seed (default 0)')
    parser.add_argument(
        '--period',
        type=float,
        default=60.0,
        help='simulated time (s) between samples (default 60)',
    )
    parser.add_argument(
        '--output', type=Path, required=True, help='folder for endurance.json and its plot'
    )
    add_set_option(parser)


def _run_endurance(arguments: argparse.Namespace) -> int:
    """Run the team, print a line per sample."""
    from explore_slam.simulation import world_path
    from explore_slam.studies.endurance_study import EnduranceStudy, run_study

    study = EnduranceStudy(
        world_path(arguments.world),
        arguments.vehicles,
        arguments.duration,
        arguments.seed,
        arguments.period,
        named_settings(arguments, ()),
    )
    print(
        f'{"t (s)":>8s}{"memory (MiB)":>14s}{"landmarks":>11s}{"update (ms)":>13s}'
        f'{"anchors":>9s}{"keyframes":>11s}'
    )
    for sample in run_study(study, arguments.output):
        print(
            f'{sample.t:8.0f}{sample.memory_mb:14.0f}{sample.landmarks:11d}'
            f'{sample.update_ms:13.1f}{sample.anchors:9d}{sample.keyframes:11d}',
            flush=True,
        )
    print(f'written: {arguments.output / "endurance.json"}', file=sys.stderr)
    return 0


def _configure_twins(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        '--worlds',
        type=whole_numbers,
        default=list(range(12)),
        help='such as 0..11 or 3,5; one run each (default 0..11)',
    )
    parser.add_argument('--vehicles', type=int, default=1, help='1 or 2 (default 1)')
    parser.add_argument(
        '--starts',
        choices=('known', 'unknown'),
        default='known',
        help='whether the start pose of the second vehicle is given (default known)',
    )
    add_workers_options(parser)
    parser.add_argument('--output', type=Path, help='folder for twins.json')
    add_set_option(parser)


def _run_twins(arguments: argparse.Namespace) -> int:
    """Make the runs, print their table, save it with --output."""
    from explore_slam.cli.progress import report_runs
    from explore_slam.studies.twin_study import TwinStudy, markdown_table, run_study, save_study

    study = TwinStudy(
        arguments.worlds, arguments.vehicles, arguments.starts, named_settings(arguments, ())
    )
    output = arguments.output
    runs = report_runs(
        run_study(study, workers_of(arguments)),
        len(study.worlds),
        lambda one: (
            f'world {one.world}: {one.false_closures} of {one.closures} closures false, '
            f'{one.false_joins} joins false, {one.seconds:.1f} s'
        ),
        output and (lambda so_far: save_study(study, so_far, output)),
    )
    print(markdown_table(runs), end='')
    if arguments.output is not None:
        print(f'written: {arguments.output / "twins.json"}', file=sys.stderr)
    return 0


Declare = Callable[[argparse.ArgumentParser], None]
Run = Callable[[argparse.Namespace], int]
KINDS: dict[str, tuple[str, Declare, Run]] = {
    'exploration': (
        'explore a map with teams of simulated vehicles in the grid simulator',
        _configure_exploration,
        _run_exploration,
    ),
    'consistency': (
        'compare the errors of a closed loop with their published covariance (NEES)',
        _configure_consistency,
        _run_consistency,
    ),
    'endurance': (
        'measure memory, landmarks and update time of a team that patrols after exploring',
        _configure_endurance,
        _run_endurance,
    ),
    'twins': (
        'count false closures and false joins in corridors of equal rooms',
        _configure_twins,
        _run_twins,
    ),
    'mapping': (benchmark_mapping.HELP, benchmark_mapping.configure, benchmark_mapping.run),
    'obstacles': (
        benchmark_obstacles.HELP,
        benchmark_obstacles.configure,
        benchmark_obstacles.run,
    ),
    'sensors': (benchmark_sensors.HELP, benchmark_sensors.configure, benchmark_sensors.run),
    'tags': (benchmark_tags.HELP, benchmark_tags.configure, benchmark_tags.run),
}
