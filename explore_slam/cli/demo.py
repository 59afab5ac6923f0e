"""`explore_slam demo`: live exploration with simulated vehicles over ROS topics."""

import argparse
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from explore_slam.cli.arguments import add_set_option, named_settings
from explore_slam.errors import ExploreSlamError
from explore_slam.failures import INTERRUPTED

if TYPE_CHECKING:
    from explore_slam.live.live_run import LiveRun
    from explore_slam.live.run_monitor import RunState
    from explore_slam.results.run_data import RunData

HELP = 'explore a simulated building with several vehicles, live over ROS topics'
# Time (s) between two reports of progress on a terminal, and elsewhere.
TERMINAL_PERIOD, LOG_PERIOD = 0.5, 5.0


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument('--vehicles', type=int, default=2, help='number of vehicles (default 2)')
    parser.add_argument(
        '--world', default='office', help='world file, map_server YAML, or name (default office)'
    )
    parser.add_argument('--seed', type=int, default=0, help='random seed (default 0)')
    parser.add_argument('--engine', choices=('fastslam2', 'paper'), help='variant of FastSLAM')
    parser.add_argument(
        '--maps', choices=('common', 'dedicated'), help='one common map, or one for each vehicle'
    )
    parser.add_argument('--particles', type=int, help='number of particles')
    add_set_option(parser)
    parser.add_argument(
        '--vision',
        choices=('agent', 'vehicle'),
        default='agent',
        help='where features are extracted (default agent)',
    )
    parser.add_argument(
        '--hardware', action='store_true', help='use the serial drivers on emulated hardware'
    )
    parser.add_argument(
        '--laser-boot-time',
        type=float,
        default=0.0,
        help='with --hardware: lasers whose power their port switches, and which boot for this '
        'long (s; default 0: they have power all the time)',
    )
    parser.add_argument('--record', action='store_true', help='record a bag in the run folder')
    parser.add_argument(
        '--real-time-factor',
        type=float,
        default=0.0,
        help='simulated time per wall time (default: as fast as the machine allows)',
    )
    parser.add_argument(
        '--wall-time-limit',
        type=float,
        default=900.0,
        help='time (s) after which to end, by the clock of this machine (default 900)',
    )
    parser.add_argument(
        '--out', type=Path, default=Path('runs'), help='parent of the run folder (default runs)'
    )


def run(arguments: argparse.Namespace) -> int:
    """Run until complete or until Ctrl-C; write the run folder in both cases."""
    from explore_slam.live.processes import use_one_machine

    use_one_machine(arguments.out)  # before ROS is imported; the logs go to the run's own folder
    from explore_slam.live.live_run import LiveRun, LiveRunOptions

    settings = named_settings(arguments, ('engine', 'maps', 'particles'))
    options = LiveRunOptions(
        world=arguments.world,
        vehicles=arguments.vehicles,
        seed=arguments.seed,
        settings=settings,
        vision=arguments.vision,
        hardware=arguments.hardware,
        record=arguments.record,
        real_time_factor=arguments.real_time_factor,
        laser_boot_time=arguments.laser_boot_time,
        wall_time_limit=arguments.wall_time_limit,
    )
    live = LiveRun(options, arguments.out)
    print(
        f'{options.vehicles} vehicles explore {live.world.name!r} '
        f'({live.area.area:.0f} m² reachable); stop with Ctrl-C. Results: {live.folder.path}'
    )
    interrupted = False
    failure: ExploreSlamError | OSError | None = None
    began = time.monotonic()
    try:
        _show(live)
    except KeyboardInterrupt:
        interrupted = True
        print('\ninterrupted: stopping all nodes', flush=True)
    except (ExploreSlamError, OSError) as error:  # a node has ended, or the disk is full
        if not live.has_results:
            raise
        failure = error
        print('\nended early: the results so far are written', flush=True)
    data = live.finish()
    _summarize(live, data, time.monotonic() - began)
    if failure is not None:
        raise failure
    if interrupted:
        return INTERRUPTED
    return 0 if live.complete else 1


def _show(live: 'LiveRun') -> None:
    terminal = sys.stdout.isatty()
    period = TERMINAL_PERIOD if terminal else LOG_PERIOD
    lines, shown = 0, -1e9
    for state in live.run():
        if time.monotonic() < shown + period:
            continue
        shown = time.monotonic()
        text = progress_text(live, state)
        if terminal and lines:
            print(f'\x1b[{lines}A\x1b[J', end='')
        print('\n'.join(text), flush=True)
        lines = len(text)


def progress_text(live: 'LiveRun', state: 'RunState') -> list[str]:
    """Return the current state: a line for the team, one for each vehicle."""
    assert live.monitor is not None
    if not state.poses:
        return ['starting: waiting for the first poses ...']
    _, clock = live.monitor.values('simulator: time')
    _, agent = live.monitor.values('agent: agent')
    factor = float(clock.get('real_time_factor', 'nan'))
    lines = [
        f'{state.stamp:6.1f} s (x{factor:.1f})  explored {100 * state.coverage:5.1f} %  '
        f'frontiers {agent.get("frontiers", "-"):>3}  '
        f'effective particles {_effective(live)}  {state.status.replace("_", " ")}'
    ]
    for name in live.starts:
        text, values = live.monitor.values(f'agent: vehicle {name}')
        lines.append('  ' + _vehicle_text(name, text, values, state))
    return lines


def _effective(live: 'LiveRun') -> str:
    assert live.monitor is not None
    counts = [
        float(live.monitor.values(f'agent: vehicle {name}')[1].get('effective_particles', 'nan'))
        for name in live.starts
    ]
    return f'{min(counts):.0f}'


def _vehicle_text(name: str, text: str, values: dict[str, str], state: 'RunState') -> str:
    if not values:
        return f'{name}: no status from the agent yet'
    goal = values.get('goal', '')
    doing = text + (f' to ({goal.replace(" ", ", ")})' if goal else '')
    deviation = float(values.get('position_deviation_m', 'nan'))
    error = state.position_error(name)
    rate = float(values.get('keyframes_per_second', 'nan'))
    quality = f'pose ±{deviation:.3f} m, error {error:.3f} m'
    return f'{name}  {doing:40.40s} {quality}  {rate:.1f} keyframes/s'


def _summarize(live: 'LiveRun', data: 'RunData', elapsed: float) -> None:
    from explore_slam.cli.summary import print_summary

    metrics: dict[str, Any] = data.metrics
    print()
    print_summary(data)
    collisions = sum(metrics['collisions'].values())
    print(
        f'{metrics["status"].replace("_", " ")} after {metrics["duration"]:.0f} s of simulated '
        f'time ({elapsed:.0f} s), {collisions} collisions'
    )
    agent = metrics['agent']
    if 'wall_latency_median_s' in agent:
        print(
            f'image to pose: median {1e3 * agent["wall_latency_median_s"]:.0f} ms, '
            f'p95 {1e3 * agent["wall_latency_p95_s"]:.0f} ms'
        )
    print(f'report: {live.folder.path / "report.html"}')
