"""Hash the state of the filter after three fixed runs, to show that a change does not affect it.

python benchmarks/filter_state.py [office] [mrclam] [experiment1] [--duration S]

Each line holds the name of a run and the SHA-256 of poses and weights of all particles, the
keyframe path and all landmark rows. Two commits with equal results print equal lines on the same
machine with the same library versions; other processors or libraries may round differently.
"""

import argparse
import hashlib
import os
import tempfile
from pathlib import Path

import numpy as np

from explore_slam.agent import Agent
from explore_slam.recording.bag import BagReader
from explore_slam.recording.importers.mrclam import import_mrclam
from explore_slam.recording.replay import Replay
from explore_slam.results.replay_run import configuration, recorded_starts
from explore_slam.slam import TeamBelief
from explore_slam.studies.closed_loop import ClosedLoop, ClosedLoopConfig
from explore_slam.studies.experiments.experiment1 import Options, make_estimator
from explore_slam.studies.experiments.scenarios import draw_scenario
from explore_slam.studies.experiments.trials import run_trial

ROOT = Path(__file__).resolve().parents[1]


def digest(belief: TeamBelief) -> str:
    """Return the hash of poses, weights, paths and landmark rows of all filters."""
    sha = hashlib.sha256()
    for filter_ in belief.filters:
        for vehicle in filter_.vehicles:
            sha.update(np.ascontiguousarray(filter_.particle_poses(vehicle)).tobytes())
            sha.update(np.ascontiguousarray(filter_.weights(vehicle)).tobytes())
        sha.update(np.ascontiguousarray(filter_.best_path()).tobytes())
        entries = filter_.map.entries()
        filter_.map.fuse(entries, filter_.groups)
        sha.update(filter_.map.ids[entries].tobytes())
        for begin in range(0, len(entries), 500):
            rows = filter_.map.rows.read(entries[begin : begin + 500])
            sha.update(np.ascontiguousarray(rows).tobytes())
    return sha.hexdigest()


def office(duration: float) -> str:
    """Explore the office in one process, two vehicles, seed 0."""
    loop = ClosedLoop(ROOT / 'config' / 'worlds' / 'office.yaml', ClosedLoopConfig())
    while loop.simulator.time < duration and not loop.ended:
        loop.step()
    loop.simulator.close()
    return digest(loop.agent.belief)


def mrclam() -> str:
    """Import MR.CLAM 6 and replay it, seed 0."""
    data = Path(os.environ['EXPLORE_SLAM_DATA']) / 'mrclam6'
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / 'bag'
        import_mrclam(data, bag)
        with BagReader(bag) as reader:
            replay = Replay(reader, (), None, recorded_starts(bag), None)
            agent = Agent(configuration(bag), replay.start_poses(), 0)
            replay.feed(agent)
        return digest(agent.belief)


def experiment1() -> str:
    """Run both scenes of experiment 1 with a common map, seed 0."""
    sha = hashlib.sha256()
    for scene in ('crossing', 'separate'):
        scenario = draw_scenario(scene, 0, landmarks=60)
        for method in ('paper', 'fastslam2'):
            estimator = make_estimator(method, 'common', scenario, Options(), 0)
            run_trial(scenario, estimator)
            sha.update(digest(estimator.belief).encode())
    return sha.hexdigest()


def main() -> None:
    """Run the selected runs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        'runs', nargs='*', default=[], help='office, mrclam, experiment1; default: all'
    )
    parser.add_argument('--duration', type=float, default=60.0, help='office: simulated time (s)')
    arguments = parser.parse_args()
    runs = {
        'experiment1': experiment1,
        'mrclam': mrclam,
        'office': lambda: office(arguments.duration),
    }
    for name in arguments.runs or runs:
        print(f'{name:12s} {runs[name]()}', flush=True)


if __name__ == '__main__':
    main()
