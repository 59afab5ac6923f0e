"""`explore_slam replay`: run a recording through the agent, offline, and write a run folder."""

import argparse
import os
import sys
from pathlib import Path

from explore_slam.cli.arguments import add_set_option, add_topic_option, named_settings

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
    parser.add_argument(
        'bag', type=Path, help='rosbag2 folder, or a .mcap, .db3 or ROS 1 .bag file'
    )
    parser.add_argument(
        '--maps', choices=('common', 'dedicated'), help='one common map, or one for each vehicle'
    )
    parser.add_argument('--engine', choices=('fastslam2', 'paper'), help='variant of FastSLAM')
    parser.add_argument('--particles', type=int, help='number of particles')
    parser.add_argument('--seed', type=int, default=0, help='random seed (default 0)')
    parser.add_argument(
        '--config', type=Path, help='ROS parameter file; replaces the settings in the bag'
    )
    add_set_option(parser)
    parser.add_argument('--vehicles', nargs='+', default=(), help='only these vehicles')
    parser.add_argument(
        '--start',
        action='append',
        default=[],
        metavar='VEHICLE=X,Y,THETA',
        help='start pose in the map (m; rad, or degrees as in 90deg) where the bag has none; '
        'VEHICLE=unknown: the vehicle '
        'joins the map when its scans are found there',
    )
    add_topic_option(parser)
    parser.add_argument(
        '--until', type=float, metavar='SECONDS', help='stop after this recorded time'
    )
    parser.add_argument('--threads', type=int, help='number of threads of numeric libraries')
    parser.add_argument(
        '--out', type=Path, default=Path('runs'), help='parent of the run folder (default runs)'
    )
    parser.add_argument('--no-progress', action='store_true', help='do not show progress')


def run(arguments: argparse.Namespace) -> int:
    """Replay, write the run folder, print errors beside those of odometry alone."""
    _limit_threads(arguments.threads)
    from explore_slam.cli.progress import progress_bar
    from explore_slam.cli.summary import print_summary
    from explore_slam.recording.start_poses import start_poses
    from explore_slam.results.replay_run import replay_bag
    from explore_slam.results.run_folder import RunFolder

    config, vehicle_values = None, None
    if arguments.config:  # may be a file of the live agent, which has parameters of the node too
        from explore_slam.nodes.agent_parameters import load_agent_settings

        config, vehicle_values = load_agent_settings(arguments.config)
    with progress_bar(arguments.bag.name, enabled=not arguments.no_progress) as show:
        data = replay_bag(
            arguments.bag,
            config=config,
            options=named_settings(arguments, ('maps', 'engine', 'particles')),
            seed=arguments.seed,
            vehicles=arguments.vehicles,
            starts=start_poses(arguments.start, unknown=True),
            until=arguments.until,
            progress=show,
            topics=arguments.topic,
            vehicle_values=vehicle_values,
        )
    folder = RunFolder.create(arguments.out)
    report = folder.write_run(data)
    print_summary(data)
    print(f'report: {report}')
    for reason in data.metrics.get('unusable', []):
        print(f'explore_slam replay: {reason}', file=sys.stderr)
    return 1 if data.metrics.get('unusable') else 0


def _limit_threads(count: int | None) -> None:
    """Limit the threads of numeric libraries, before they are loaded."""
    if count is None:
        return
    from explore_slam.errors import ConfigError

    if count < 1:
        raise ConfigError(f'--threads is {count}, expected at least 1')
    for name in THREAD_VARIABLES:
        os.environ[name] = str(count)
