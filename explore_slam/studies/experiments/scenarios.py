"""World of experiment 1: landmarks with unique descriptors, paths on a grid, noise of table I."""

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import DESCRIPTOR_LENGTH, LandmarkObservations
from explore_slam.errors import EvaluationError
from explore_slam.geometry import Array, Pose2

WIDTH, HEIGHT = 17.0, 10.5  # m, figures 5 and 6 of the paper
STEP = 0.5  # m


@dataclass(frozen=True)
class Noise:
    """Noise of table I of the paper: standard deviations are these factors times sigma."""

    sigma: float = 0.5
    distance: float = 0.05  # of the step length, along the motion
    heading: float = 3.0 * math.pi / 180.0  # rad per step
    depth: float = 0.1  # of the range
    angle: float = 0.1 * math.pi / 180.0  # rad, both angles

    def motion_covariance(self, increment: Pose2) -> Array:
        """Return the covariance (3, 3) of a step: a turn on the spot, then a straight line."""
        length = math.hypot(increment.x, increment.y)
        along = self.distance * length * self.sigma
        # The paper has no noise across the motion: a hundredth of that along it, and 1 µm
        # without motion, keep the matrix regular.
        across = 0.01 * along
        floor = 1e-6**2
        c, s = (increment.x / length, increment.y / length) if length > 0.0 else (1.0, 0.0)
        turn = np.array([[c, -s], [s, c]])
        covariance = np.zeros((3, 3))
        covariance[:2, :2] = turn @ np.diag([along**2 + floor, across**2 + floor]) @ turn.T
        covariance[2, 2] = (self.heading * self.sigma) ** 2 + floor
        return covariance


@dataclass(frozen=True)
class VehicleStep:
    """One step of one vehicle: true pose after it, odometry, observations with identities (K,)."""

    vehicle: str
    true_pose: Pose2
    increment: Pose2
    covariance: Array
    observations: LandmarkObservations
    identities: NDArray[np.int64]


@dataclass(frozen=True)
class Scenario:
    """A simulated run: landmarks (N, 3) m, start poses, steps of the vehicles in turn."""

    name: str
    landmarks: Array
    start_poses: dict[str, Pose2]
    steps: list[VehicleStep]

    def true_path(self, vehicle: str) -> Array:
        """Return the true poses (T + 1, 3) of a vehicle, beginning with its start."""
        poses = [s.true_pose for s in self.steps if s.vehicle == vehicle]
        return np.array([self.start_poses[vehicle], *poses])


# Corners (m) of the paths, of 28 and 16 steps as in figures 5 and 6 of the paper. 'crossing': two
# overlapping loops from opposite corners; 'separate': no landmark is in range of both vehicles;
# 'late crossing' (not in the paper): each vehicle drives about 12 steps before it enters the area
# that the other has mapped.
PATHS: dict[str, dict[str, list[tuple[float, float]]]] = {
    'crossing': {
        'robot1': [(6.0, 4.0), (10.0, 4.0), (10.0, 7.0), (6.0, 7.0), (6.0, 4.0)],
        'robot2': [(10.0, 6.0), (6.0, 6.0), (6.0, 3.0), (10.0, 3.0), (10.0, 6.0)],
    },
    'separate': {
        'robot1': [(2.0, 2.0), (2.0, 5.0), (4.5, 5.0), (4.5, 2.5)],
        'robot2': [(15.0, 8.5), (15.0, 5.5), (12.5, 5.5), (12.5, 8.0)],
    },
    'late crossing': {
        'robot1': [(3.0, 3.0), (11.0, 3.0), (11.0, 6.0), (8.0, 6.0)],
        'robot2': [(13.0, 7.0), (5.0, 7.0), (5.0, 4.0), (8.0, 4.0)],
    },
}


def path_poses(corners: list[tuple[float, float]], step: float = STEP) -> list[Pose2]:
    """Return poses along a path of straight legs, each heading along its leg."""
    poses: list[Pose2] = []
    for (x0, y0), (x1, y1) in itertools.pairwise(corners):
        heading = math.atan2(y1 - y0, x1 - x0)
        count = round(math.hypot(x1 - x0, y1 - y0) / step)
        if not poses:
            poses.append(Pose2(x0, y0, heading))
        shares = (k / count for k in range(1, count + 1))
        poses.extend(Pose2(x0 + (x1 - x0) * k, y0 + (y1 - y0) * k, heading) for k in shares)
    return poses


def unique_descriptors(count: int, rng: np.random.Generator) -> NDArray[np.float32]:
    """Return random unit descriptors (count, 128), far from each other."""
    raw = np.abs(rng.standard_normal((count, DESCRIPTOR_LENGTH)))
    unit: NDArray[np.float32] = (raw / np.linalg.norm(raw, axis=1, keepdims=True)).astype(
        np.float32
    )
    return unit


def draw_scenario(
    name: str,
    seed: int,
    *,
    landmarks: int = 60,
    max_range: float = 3.5,
    noise: Noise | None = None,
    laps: int = 1,
) -> Scenario:
    """Simulate landmarks, true motion and measurements along the paths of this name.

    As in the paper, a vehicle follows its path by odometry, so that its true pose leaves the path
    with the noise of table I. It observes 180 degrees up to max_range (m).

    laps: how often closed paths are driven. In more than one, vehicles are steered back onto the
    path at each step, else they would leave the world, and the covariances of observations are
    those at the true ranges: consistency can only be judged where the noise is known.
    """
    if name not in PATHS:
        raise EvaluationError(f'scenario is {name!r}, expected one of {list(PATHS)}')
    if laps < 1 or (laps > 1 and any(path[0] != path[-1] for path in PATHS[name].values())):
        raise EvaluationError(f'laps are {laps} on the paths {name!r}, expected 1 on open paths')
    noise = noise or Noise()
    rng = np.random.default_rng(np.random.SeedSequence([seed, len(name), landmarks]))
    positions = np.column_stack(
        [
            rng.uniform(0.0, WIDTH, landmarks),
            rng.uniform(0.0, HEIGHT, landmarks),
            rng.uniform(0.2, 1.8, landmarks),
        ]
    )
    descriptors = unique_descriptors(landmarks, rng)
    planned = {
        vehicle: path_poses(corners + (laps - 1) * corners[1:])
        for vehicle, corners in PATHS[name].items()
    }
    true = {vehicle: poses[0] for vehicle, poses in planned.items()}
    starts = dict(true)
    steps = []
    for number in range(1, len(next(iter(planned.values())))):
        for vehicle, poses in planned.items():
            begin = poses[number - 1] if laps == 1 else true[vehicle]
            increment = begin.between(poses[number])
            covariance = noise.motion_covariance(increment)
            noise_sample = rng.multivariate_normal(np.zeros(3), covariance, method='cholesky')
            true[vehicle] = true[vehicle].compose(
                Pose2.from_array(np.add(increment, noise_sample))
            )
            seen = observe(
                true[vehicle], positions, descriptors, float(number), max_range, noise, rng,
                exact_covariances=laps > 1,
            )  # fmt: skip
            steps.append(VehicleStep(vehicle, true[vehicle], increment, covariance, *seen))
    return Scenario(name, positions, starts, steps)


def observe(
    pose: Pose2,
    landmarks: Array,
    descriptors: NDArray[np.float32],
    stamp: float,
    max_range: float,
    noise: Noise,
    rng: np.random.Generator,
    *,
    exact_covariances: bool = False,
) -> tuple[LandmarkObservations, NDArray[np.int64]]:
    """Simulate observations of the half plane ahead; return them with their identities (K,).

    exact_covariances: at the true ranges and angles instead of the measured ones.
    """
    c, s = math.cos(pose.theta), math.sin(pose.theta)
    dx, dy, dz = landmarks[:, 0] - pose.x, landmarks[:, 1] - pose.y, landmarks[:, 2]
    forward, left = c * dx + s * dy, -s * dx + c * dy
    distance = np.sqrt(forward**2 + left**2 + dz**2)
    rows = np.nonzero((forward > 0.0) & (distance <= max_range))[0]
    deviations = rng.standard_normal((3, len(rows))) * noise.sigma
    tau = distance[rows] * (1.0 + noise.depth * deviations[0])
    azimuth = np.arctan2(left[rows], forward[rows]) + noise.angle * deviations[1]
    elevation = np.arcsin(dz[rows] / distance[rows]) + noise.angle * deviations[2]
    positions, covariances = from_polar(tau, azimuth, elevation, noise)
    if exact_covariances:
        angles = np.arctan2(left[rows], forward[rows]), np.arcsin(dz[rows] / distance[rows])
        covariances = from_polar(distance[rows], *angles, noise)[1]
    return LandmarkObservations(stamp, positions, covariances, descriptors[rows]), rows


def from_polar(tau: Array, azimuth: Array, elevation: Array, noise: Noise) -> tuple[Array, Array]:
    """Return positions (K, 3) m and covariances (K, 3, 3) m² of ranges tau (m), angles (rad)."""
    ca, sa, ce, se = np.cos(azimuth), np.sin(azimuth), np.cos(elevation), np.sin(elevation)
    ray = np.stack([ce * ca, ce * sa, se], axis=1)
    zero = np.zeros_like(ca)
    jacobian = np.stack(
        [
            ray * (noise.depth * noise.sigma * tau)[:, None],
            np.stack([-ce * sa, ce * ca, zero], 1) * (tau * noise.angle * noise.sigma)[:, None],
            np.stack([-se * ca, -se * sa, ce], 1) * (tau * noise.angle * noise.sigma)[:, None],
        ],
        axis=2,
    )
    covariances: Array = jacobian @ jacobian.transpose(0, 2, 1)
    return ray * tau[:, None], covariances


def dead_reckoning(scenario: Scenario, vehicle: str) -> Array:
    """Return the poses (T + 1, 3) by odometry alone."""
    pose = scenario.start_poses[vehicle]
    poses = [pose]
    for step in scenario.steps:
        if step.vehicle == vehicle:
            pose = pose.compose(step.increment)
            poses.append(pose)
    return np.array(poses)
