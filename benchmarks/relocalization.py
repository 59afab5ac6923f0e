"""Vehicles that are placed wrongly in a map: whether and when they find their pose again.

python benchmarks/relocalization.py [--mrclam FOLDER] [--restarts 20] [--seed 0]
Two maps: a synthetic office of 16 × 10 m with 400 landmarks, a quarter of which look like another
one elsewhere, and that of five robots (MR.CLAM). A vehicle is placed 1 to 5 m and up to 180° off,
with a covariance of 0.1 m and 0.1 rad, and goes on. Each restart begins with the same filter and
ends when the pose has been right for some time, or after 60 s.
Prints, for each restart, how far off the vehicle was placed, after how long its pose was right (to
0.5 m and 0.3 rad) and stayed so, and how often it was moved to a wrong pose.
"""

import argparse
import math
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import mrclam
import numpy as np

from explore_slam.data import LandmarkObservations
from explore_slam.geometry import Array, Pose2, to_world, wrap_angle
from explore_slam.recording.importers.mrclam import FILTER_SETTINGS
from explore_slam.settings import with_values
from explore_slam.slam import FastSlam, FastSlamConfig

NEAR, TURNED = 0.5, 0.3  # m and rad: a pose is right within them
PLACED = np.diag([0.1, 0.1, 0.1]) ** 2  # covariance that a wrong pose is given with
PATIENCE = 60.0  # s
STAYS = 10.0  # s that a pose must stay right
WAITING = 300.0  # s of MR.CLAM before the first restart

SIZE = (16.0, 10.0)  # m, of the office
LANDMARKS, COPIES = 400, 100
REACH, VIEW = 4.0, 0.5  # m and rad to either side
STEP_NOISE = np.array([0.005, 0.003, 0.01])  # m, m, rad per step
DEVIATION = 0.02  # m of an observation


class Moment(NamedTuple):
    """What a vehicle gets at one time: motion (steps (n, 3)), observations, and its true pose."""

    vehicle: str
    stamp: float
    steps: Array
    observations: LandmarkObservations | None
    truth: Pose2


def office(seed: int, count: int) -> Iterator[Moment]:
    """Yield a drive of one vehicle on laps through a synthetic office."""
    random = np.random.default_rng(seed)
    points = random.uniform([0.0, 0.0, 0.2], [*SIZE, 2.0], (LANDMARKS, 3))
    vectors = random.standard_normal((LANDMARKS, 128))
    copies = random.permutation(LANDMARKS)[: 2 * COPIES]
    vectors[copies[:COPIES]] = vectors[copies[COPIES:]]
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    pose = Pose2(3.0, 2.0, 0.0)
    for number in range(count):
        increment = Pose2(0.1, 0.0, 0.0 if _is_straight(pose) else 0.1)
        noise = random.normal(0.0, STEP_NOISE)
        pose = pose.compose(Pose2.from_array(np.add(increment, noise)))
        local = to_world(pose.inverse(), points)
        seen = np.flatnonzero(
            (np.hypot(local[:, 0], local[:, 1]) < REACH)
            & (np.abs(np.arctan2(local[:, 1], local[:, 0])) < VIEW)
        )
        noisy = local[seen] + random.normal(0.0, DEVIATION, (len(seen), 3))
        spread = np.tile(DEVIATION**2 * np.eye(3), (len(seen), 1, 1))
        found = LandmarkObservations(0.5 * number, noisy, spread, vectors[seen].astype(np.float32))
        steps = np.array([increment])
        yield Moment('robot1', 0.5 * number, steps, found if len(seen) else None, pose)


def _is_straight(pose: Pose2) -> bool:
    """Return whether the vehicle is on a side of the rectangle that it drives, not in a corner."""
    side = round(pose.theta / (0.5 * math.pi)) % 4
    off = abs(wrap_angle(pose.theta - 0.5 * math.pi * side))
    ahead = (SIZE[0] - 3.0 - pose.x, SIZE[1] - 2.0 - pose.y, pose.x - 3.0, pose.y - 2.0)[side]
    return ahead > 0.0 and off < 0.1


def team_moments(team: mrclam.Team) -> Iterator[Moment]:
    """Yield what the robots of MR.CLAM got; robots that they observe are left out."""
    for event in mrclam.events(team):
        truth = mrclam.true_poses(team.robots[event.robot], np.array([event.stamp]))[0]
        seen = None
        if len(event.measured):
            found, _ = mrclam.observations(event.stamp, event.measured)
            seen = found if len(found) else None
        name = f'robot{event.robot + 1}'
        yield Moment(name, event.stamp, event.steps, seen, Pose2.from_array(truth))


def advance(slam: FastSlam, moment: Moment) -> bool:
    """Give a moment to the filter; return whether the vehicle was relocalized."""
    for step in moment.steps:
        slam.predict(moment.vehicle, Pose2.from_array(step))
    if moment.observations is None:
        return False
    if not len(moment.steps):
        slam.predict(moment.vehicle, Pose2(0.0, 0.0, 0.0), np.zeros((3, 3)))
    return slam.update(moment.vehicle, moment.observations).relocated


def is_right(slam: FastSlam, moment: Moment) -> bool:
    """Return whether the estimate is near the truth."""
    pose, _ = slam.estimate(moment.vehicle)
    off = math.hypot(pose.x - moment.truth.x, pose.y - moment.truth.y)
    return off < NEAR and abs(wrap_angle(pose.theta - moment.truth.theta)) < TURNED


def restart(
    slam: FastSlam, moments: list[Moment], wrong: tuple[float, float, float]
) -> tuple[float | None, int]:
    """Place the vehicle of the first moment wrongly, and go on.

    wrong: distance (m), direction and turn (rad). Returns the time (s) until its pose was right
    for good, or None, and the number of wrong relocalizations.
    """
    vehicle, begin = moments[0].vehicle, moments[0].stamp
    distance, direction, turn = wrong
    pose, _ = slam.estimate(vehicle)
    slam.set_pose(
        vehicle,
        Pose2(
            pose.x + distance * math.cos(direction),
            pose.y + distance * math.sin(direction),
            wrap_angle(pose.theta + turn),
        ),
        PLACED,
    )
    right_since: float | None = None
    mistakes = 0
    for moment in moments[1:]:
        relocated = advance(slam, moment)
        if moment.vehicle != vehicle:
            continue
        right = is_right(slam, moment)
        mistakes += relocated and not right
        if not right:
            right_since = None
        elif right_since is None:
            right_since = moment.stamp - begin
        if right_since is not None and moment.stamp - begin > right_since + STAYS:
            return right_since, mistakes
        if moment.stamp - begin > PATIENCE:
            break
    return right_since, mistakes


def study(
    name: str, slam: FastSlam, moments: list[Moment], first: int, restarts: int, seed: int
) -> None:
    """Map until the first restart, then restart at regular intervals, and print the results."""
    random = np.random.default_rng(seed)
    last = moments[-1].stamp - PATIENCE
    stamps = np.linspace(moments[first].stamp, last, restarts)
    number, found, mistakes, times = 0, 0, 0, list[float]()
    vehicles = slam.vehicles
    for index, moment in enumerate(moments):
        due = number < restarts and moment.stamp >= stamps[number]
        if due and moment.vehicle == vehicles[number % len(vehicles)] and is_right(slam, moment):
            wrong = (
                float(random.uniform(1.0, 5.0)),
                float(random.uniform(-math.pi, math.pi)),
                float(random.uniform(-math.pi, math.pi)),
            )
            copy = FastSlam.from_state(slam.state_dict())
            time, errors = restart(copy, [moment, *moments[index:]], wrong)
            text = 'never' if time is None else f'{time:.1f} s'
            print(
                f'{name} {number + 1}: {moment.vehicle} {wrong[0]:.1f} m and '
                f'{math.degrees(wrong[2]):+.0f}° off, right after {text}, {errors} times moved '
                'to a wrong pose',
                flush=True,
            )
            number, found, mistakes = number + 1, found + (time is not None), mistakes + errors
            times += [] if time is None else [time]
        if number == restarts:
            break
        advance(slam, moment)
    median = np.median(times) if times else math.nan
    print(
        f'{name}: {found} of {number} right, {mistakes} times moved to a wrong pose, after '
        f'{median:.1f} s in the median, {max(times, default=math.nan):.1f} s at most'
    )


def main() -> None:
    """Run the restarts in both maps."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n')[0])
    parser.add_argument('--mrclam', type=Path, metavar='FOLDER')
    parser.add_argument('--restarts', type=int, default=20)
    parser.add_argument('--seed', type=int, default=0)
    arguments = parser.parse_args()
    moments = list(office(arguments.seed, 1400))
    slam = FastSlam({'robot1': Pose2(3.0, 2.0, 0.0)}, FastSlamConfig(), arguments.seed)
    study('office', slam, moments, 900, arguments.restarts, arguments.seed)
    if arguments.mrclam is not None:
        team = mrclam.corrected(mrclam.read(arguments.mrclam))
        moments = list(team_moments(team))
        first = next(n for n, m in enumerate(moments) if m.stamp > team.begin + WAITING)
        config = with_values(
            FastSlamConfig(), {**FILTER_SETTINGS, 'maximum_descriptor_distance': 0.0}
        )
        slam = FastSlam(mrclam.start_poses(team), config, arguments.seed)
        study('MR.CLAM', slam, moments, first, arguments.restarts, arguments.seed)


if __name__ == '__main__':
    main()
