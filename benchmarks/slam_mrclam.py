"""Accuracy on MR.CLAM 6: five robots, online estimates, common or dedicated maps, several seeds.

python benchmarks/slam_mrclam.py FOLDER [--seeds 10] [--particles 300] [--inter-robot]
Prints, for each seed, the RMS position error of each robot and their mean (m), the largest error
and the RMS error of the landmarks, in the frame of the true start poses, without alignment.
"""

import argparse
import time
from pathlib import Path

import mrclam
import numpy as np
import yaml

from explore_slam.geometry import Array, Pose2
from explore_slam.recording.importers.mrclam import FILTER_SETTINGS, landmark_descriptor
from explore_slam.settings import with_values
from explore_slam.slam import FastSlamConfig, TeamBelief

SUBJECTS = range(mrclam.ROBOTS + 1, 21)  # the landmarks


def drive(
    team: mrclam.Team, config: FastSlamConfig, seed: int, inter_robot: bool
) -> tuple[Array, Array, TeamBelief]:
    """Run the filter; return errors (T, robots, 2) m, stamps (T,) s and the filter."""
    belief = TeamBelief(mrclam.start_poses(team), config, seed)
    errors: dict[float, Array] = {}
    for event in mrclam.events(team):
        name = f'robot{event.robot + 1}'
        for step in event.steps:
            belief.predict(name, Pose2(*step))
        if not len(event.measured):
            pose, _ = belief.estimate(name)
            true = mrclam.true_poses(team.robots[event.robot], np.array([event.stamp]))[0]
            row = errors.setdefault(event.stamp, np.full((mrclam.ROBOTS, 2), np.nan))
            row[event.robot] = pose.x - true[0], pose.y - true[1]
            continue
        if not len(event.steps):
            belief.predict(name, Pose2(0.0, 0.0, 0.0), np.zeros((3, 3)))
        seen, others = mrclam.observations(event.stamp, event.measured)
        if len(seen):
            belief.update(name, seen)
        if inter_robot and others:
            belief.update_inter_robot(name, others)
    return np.array(list(errors.values())), np.array(list(errors)), belief


def landmark_errors(team: mrclam.Team, belief: TeamBelief) -> Array:
    """Return errors (N, 2) m of the landmarks, with dedicated maps those of the first vehicle."""
    found = belief.landmarks(belief.vehicles[0])
    known = np.stack([landmark_descriptor(subject) for subject in SUBJECTS])
    subjects = np.argmax(found.descriptors @ known.T, axis=1) + SUBJECTS[0]
    return found.means[:, :2] - team.landmarks[subjects - mrclam.ROBOTS - 1]


def main() -> None:
    """Run all seeds and print a line for each."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n')[0])
    parser.add_argument('folder', type=Path)
    parser.add_argument('--seeds', type=int, default=10)
    parser.add_argument('--first', type=int, default=0)
    parser.add_argument('--particles', type=int, default=FastSlamConfig().particles)
    parser.add_argument('--maps', default='common', choices=('common', 'dedicated'))
    parser.add_argument('--inter-robot', action='store_true')
    parser.add_argument('--set', nargs='*', default=[], metavar='NAME=VALUE')
    arguments = parser.parse_args()
    values = {
        **FILTER_SETTINGS,
        'particles': arguments.particles,
        'maps': arguments.maps,
        'maximum_descriptor_distance': 0.0,
    }
    for text in arguments.set:
        name, _, value = text.partition('=')
        values[name] = yaml.safe_load(value)
    config = with_values(FastSlamConfig(), values)
    team = mrclam.corrected(mrclam.read(arguments.folder))
    means, marks = [], []
    for seed in range(arguments.first, arguments.first + arguments.seeds):
        begin = time.perf_counter()
        errors, _, belief = drive(team, config, seed, arguments.inter_robot)
        lengths = np.linalg.norm(errors, axis=2)
        rms = np.sqrt(np.mean(lengths**2, axis=0))
        mark = np.sqrt(np.mean(np.sum(landmark_errors(team, belief) ** 2, axis=1)))
        means.append(rms.mean())
        marks.append(mark)
        print(
            f'seed {seed}: robots {rms.round(3)} mean {rms.mean():.3f} m, largest '
            f'{lengths.max():.2f} m, last {lengths[-1].round(2)}, landmarks {mark:.3f} m, '
            f'{time.perf_counter() - begin:.1f} s',
            flush=True,
        )
    print(f'mean over seeds: robots {np.mean(means):.3f} m, landmarks {np.mean(marks):.3f} m')


if __name__ == '__main__':
    main()
