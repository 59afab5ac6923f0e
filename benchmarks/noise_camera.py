"""Noise of features in RGB-D frames, beside what the settings of vision claim.

    python benchmarks/noise_camera.py [--tum FOLDER] [--office SECONDS] [--seed N]

Observations of one landmark from different frames are brought together by ground truth and
descriptor; how they scatter shows three errors:
- of each feature by itself: along the ray (`depth_noise`) and across it (`pixel_noise`), as
  factors of what the settings claim, by the turn rate of the camera: 1 in slow frames if they are
  right; what grows with the rate is the rolling shutter's (`camera_readout_time`), which is undone
  with the true motion; --as-exposed leaves it,
- of a frame as a whole (`frame_position_deviation`, `frame_heading_deviation`): the planar motion
  that brings it closest to the landmarks, less what the errors of the features explain of it,
- how the errors of one feature in two frames correlate, by the motion between them
  (`correlation_distance`, `correlation_turn`),
- how the errors of two features of one frame correlate, by the distance between them, and as many
  independent errors as claimed their mean is worth (`graph_independent_observations`).

Of depth images, it also prints the noise of 1 / depth on flat surfaces, and how much neighbouring
pixels share of it, by their distance: a matching window of n pixels makes it fall to zero at n.

--tum: a folder of the TUM RGB-D benchmark, with ground truth from motion capture. --office: a run
of two vehicles in the simulated office.
"""

import argparse
import itertools
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from explore_slam.data import LandmarkObservations, LaserScan, OdometryReading, RgbdFrame
from explore_slam.geometry import Array, Pose2, planar_rotation
from explore_slam.recording.tum_sequence import TRUTH
from explore_slam.settings import with_values
from explore_slam.studies.closed_loop import ClosedLoop, ClosedLoopConfig
from explore_slam.studies.experiments.tum_frames import (
    DEFAULTS,
    DEPTH_SCALE,
    CameraTruth,
    read_tum,
)
from explore_slam.vision import VisionConfig

OFFICE = Path(__file__).parents[1] / 'config' / 'worlds' / 'office.yaml'
SAME_PLACE = 0.08  # m, by ground truth
SAME_DESCRIPTOR = 0.15  # squared distance of descriptors, well below the 0.4 of the filter
MINIMUM_FRAMES = 4  # in which a landmark is seen
MINIMUM_FEATURES = 15  # of a frame, five times the unknowns of its error
OUTLIER = 5.0  # robust deviations
ROUNDS = 5
RATE_TIME = 0.02  # s to either side of a stamp, in which the camera's turn is measured
SQUARE = 48  # pixels, side of the parts of depth images that may be flat; five matching windows
ROUGH = 0.01  # 1/m, noise of 1 / depth above which a part is not flat; that of a Kinect is 0.002
PIXEL_LAGS = (1, 2, 4, 6, 8, 10, 12)
TO_DEVIATION = 1.4826  # of the median absolute deviation of a normal distribution
DISTANCES = (0.0, 0.03, 0.1, 0.2, 0.4, 0.8, 1.6)  # m, between features of one frame
LAGS = ((0.0, 0.05), (0.05, 0.1), (0.1, 0.2), (0.2, 0.3), (0.3, 0.5), (0.5, 0.8), (0.8, 1.2))


class Frame(NamedTuple):
    """Observations of a frame and its true pose.

    rate: of the camera's turn (rad/s); driven, turned: way (m, rad) of the vehicle until then.
    """

    vehicle: int
    pose: Array
    rate: float
    driven: float
    turned: float
    observations: LandmarkObservations


class Features(NamedTuple):
    """Features (N,) that belong to landmarks: frame and landmark of each, and more.

    points (N, 3): in the vehicle frame; along and across (N,): claimed deviations (m).
    """

    frame: NDArray[np.int64]
    landmark: NDArray[np.int64]
    points: Array
    along: Array
    across: Array


class RecordedLoop(ClosedLoop):
    """A closed loop that keeps the features that its vehicles extract, and true poses."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.seen: list[tuple[str, LandmarkObservations]] = []
        self.true: dict[str, list[tuple[float, ...]]] = {name: [] for name in self.followers}

    def _add(
        self, name: str, record: OdometryReading | LaserScan | RgbdFrame | LandmarkObservations
    ) -> None:
        if isinstance(record, LandmarkObservations):
            self.seen.append((name, record))
        super()._add(name, record)


def office(seconds: float, seed: int, undo: bool) -> list[Frame]:
    """Drive in the simulated office; return the frames of all vehicles."""
    config = with_values(ClosedLoopConfig(), {'time_limit': seconds})
    loop = RecordedLoop(OFFICE, config, 2, seed, vision='vehicle')
    while not loop.ended:
        loop.step()
        for name, poses in loop.true.items():
            poses.append((loop.simulator.time, *loop.simulator.true_pose(name)))
    loop.simulator.close()
    return [
        frame
        for number, (name, true) in enumerate(loop.true.items())
        for frame in frames_of(
            number, np.array(true), [s for n, s in loop.seen if n == name], undo
        )
    ]


def undone(seen: LandmarkObservations, velocity: Array, turn: Array) -> LandmarkObservations:
    """Return what was seen as if at the stamp; velocity (3,) m/s, turn (3,) rad/s: both true."""
    if seen.delays is None:
        return seen
    motion = velocity + np.cross(turn, seen.positions)
    return replace(seen, positions=seen.positions + seen.delays[:, None] * motion, delays=None)


def frames_of(
    number: int, true: Array, observations: Iterable[LandmarkObservations], undo: bool
) -> Iterator[Frame]:
    """Yield the frames of a vehicle with its true poses (T, 4): stamp (s), x, y (m), θ (rad)."""
    true[:, 3] = np.unwrap(true[:, 3])
    steps = np.abs(np.diff(true[:, 1:], axis=0))
    driven = np.concatenate([[0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))])
    turned = np.concatenate([[0.0], np.cumsum(steps[:, 2])])
    for seen in observations:
        x, y, theta, distance, angle = (
            float(np.interp(seen.stamp, true[:, 0], column))
            for column in (*true[:, 1:].T, driven, turned)
        )
        around = [seen.stamp - RATE_TIME, seen.stamp + RATE_TIME]
        ends = [np.interp(around, true[:, 0], column) for column in true[:, 1:].T]
        vx, vy, rate = (float(np.diff(end)[0]) / (2.0 * RATE_TIME) for end in ends)
        velocity = planar_rotation(-theta) @ [vx, vy, 0.0]
        still = undone(seen, velocity, np.array([0.0, 0.0, rate])) if undo else seen
        yield Frame(number, np.array([x, y, theta]), abs(rate), distance, angle, still)


def tum(folder: Path, undo: bool) -> list[Frame]:
    """Read a TUM RGB-D folder."""
    frames, driven, turned, last = list[Frame](), 0.0, 0.0, None
    truth = CameraTruth(folder / TRUTH)
    for frame in read_tum(folder, VisionConfig()):
        stamp = frame.stamp + DEFAULTS.truth_offset
        (before, start), (after, end) = (truth.at(stamp + s * RATE_TIME) for s in (-1.0, 1.0))
        level = planar_rotation(-frame.pose.theta)
        turn = Rotation.from_matrix(after @ before.T).as_rotvec() / (2.0 * RATE_TIME)
        velocity = level @ (end - start) / (2.0 * RATE_TIME)
        height = np.array([0.0, 0.0, truth.at(stamp)[1][2]])  # of the camera, about which it turns
        velocity -= np.cross(level @ turn, height)
        seen = undone(frame.observations, velocity, level @ turn) if undo else frame.observations
        rate = np.linalg.norm(turn)
        moved = Pose2(0.0, 0.0, 0.0) if last is None else last.between(frame.pose)
        driven += float(np.hypot(moved.x, moved.y))
        turned += abs(moved.theta)
        pose = np.asarray(frame.pose)
        frames.append(Frame(0, pose, float(rate), driven, turned, seen))
        last = frame.pose
    return frames


def place(pose: Array, points: Array) -> Array:
    """Return points (K, 3) of the vehicle frame in the world."""
    placed: Array = points @ planar_rotation(float(pose[2])).T
    placed[:, :2] += pose[:2]
    return placed


def place_all(poses: Array, features: Features) -> Array:
    """Return the features (N, 2) in the world, those of each frame placed at its pose."""
    world = np.empty((len(features.frame), 2))
    for number in np.unique(features.frame):
        rows = features.frame == number
        world[rows] = place(poses[number], features.points[rows])[:, :2]
    return world


def associate(frames: Iterable[Frame]) -> Features:
    """Find the landmarks that the features of frames belong to, by true place and descriptor."""
    descriptors, places = np.empty((0, 0)), np.empty((0, 3))
    rows = list[tuple[float, ...]]()
    for number, frame in enumerate(frames):
        seen = frame.observations
        world = place(frame.pose, seen.positions)
        mine = np.full(len(world), -1)
        if len(places):
            near = KDTree(places).query_ball_point(world, SAME_PLACE)
            taken = set[int]()
            for k, some in enumerate(near):
                apart = ((descriptors[some] - seen.descriptors[k]) ** 2).sum(axis=1)
                if len(some) and apart.min() < SAME_DESCRIPTOR:
                    best = some[int(apart.argmin())]
                    if best not in taken:
                        mine[k] = best
                        taken.add(best)
        else:
            descriptors = np.empty((0, seen.descriptors.shape[1]), np.float32)
        new = np.flatnonzero(mine < 0)
        mine[new] = len(places) + np.arange(len(new))
        places = np.concatenate([places, world[new]])
        descriptors = np.concatenate([descriptors, seen.descriptors[new]])
        bearing = np.arctan2(seen.positions[:, 1], seen.positions[:, 0])
        along = np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
        across = np.stack([-along[:, 1], along[:, 0]], axis=1)
        P = seen.covariances[:, :2, :2]
        for k in range(len(world)):
            claimed = [float(np.sqrt(u[k] @ P[k] @ u[k])) for u in (along, across)]
            rows.append((number, mine[k], *seen.positions[k], *claimed))
    table = np.array(rows)
    count = np.bincount(table[:, 1].astype(np.int64))
    table = table[count[table[:, 1].astype(np.int64)] >= MINIMUM_FRAMES]
    return Features(
        table[:, 0].astype(np.int64),
        table[:, 1].astype(np.int64),
        table[:, 2:5],
        table[:, 5],
        table[:, 6],
    )


def robust(values: Array) -> float:
    """Return the deviation of values around zero, by their median."""
    return float(TO_DEVIATION * np.median(np.abs(values))) if len(values) else float('nan')


class Scatter(NamedTuple):
    """How features scatter around their landmarks, once the errors of frames are taken away.

    normal (N, 2): errors along and across the ray, in claimed deviations; inlier (N,): to be used.
    corrections (F, 3): of the poses of frames, in the world; explained (F, 3): what variance of
    them the errors of the features explain, NaN for frames with too few.
    """

    normal: Array
    inlier: NDArray[np.bool_]
    corrections: Array
    explained: Array


def ray_axes(poses: Array, features: Features) -> Array:
    """Return the directions (N, 2, 2) along and across the ray of each feature, in the map."""
    direction = np.arctan2(features.points[:, 1], features.points[:, 0])
    direction += poses[features.frame, 2]
    c, s = np.cos(direction), np.sin(direction)
    return np.stack([np.stack([c, s], axis=1), np.stack([-s, c], axis=1)], axis=1)


def scatter(poses: Array, features: Features) -> Scatter:
    """Fit the planar error of every frame with poses (F, 3), and the places of the landmarks."""
    corrections, explained = np.zeros_like(poses), np.full_like(poses, np.nan)
    count = np.bincount(features.landmark)[features.landmark]
    groups = [np.flatnonzero(features.landmark == n) for n in np.unique(features.landmark)]
    for _ in range(ROUNDS):
        corrected = poses + corrections
        world, own = place_all(corrected, features), corrected[features.frame]
        off = np.empty_like(world)
        for rows in groups:
            off[rows] = world[rows] - np.median(world[rows], axis=0)
        axes = ray_axes(corrected, features)
        claimed = np.stack([features.along, features.across], axis=1)
        normal = np.einsum('nij,nj->ni', axes, off) / claimed
        scale = np.array([robust(normal[:, 0]), robust(normal[:, 1])])
        inlier = (np.abs(normal) < OUTLIER * scale).all(axis=1)
        # of the errors (N, 2) in a step (dx, dy, dθ) of the pose, weighted
        arm = world - own[:, :2]
        turned = np.einsum('nij,nj->ni', axes, np.stack([-arm[:, 1], arm[:, 0]], axis=1))
        J = np.concatenate([axes, turned[:, :, None]], axis=2) / (scale * claimed)[:, :, None]
        for number in np.unique(features.frame):
            rows = np.flatnonzero((features.frame == number) & inlier)
            if len(rows) >= MINIMUM_FEATURES:
                A, b = J[rows].reshape(-1, 3), (normal[rows] / scale).ravel()
                corrections[number] -= np.linalg.lstsq(A, b, rcond=None)[0]
                explained[number] = np.diag(np.linalg.inv(A.T @ A))
    # landmarks are made of the features themselves: (n - 1)/n of the variance is in the errors
    normal = normal * np.sqrt(count / (count - 1.0))[:, None]
    inlier &= ~np.isnan(explained[features.frame, 0])
    return Scatter(normal, inlier, corrections, explained)


def evaluate(frames: list[Frame]) -> None:
    """Print the errors of features and frames, and the correlations."""
    features, poses = associate(frames), np.array([frame.pose for frame in frames])
    found = scatter(poses, features)
    normal = found.normal[found.inlier]
    print(
        f'{len(frames)} frames, {len(normal)} features of landmarks seen in '
        f'{MINIMUM_FRAMES} or more'
    )
    rates = np.array([frame.rate for frame in frames])[features.frame[found.inlier]]
    bounds = np.quantile(rates, [0.0, 0.1, 0.25, 0.5, 0.75, 1.0])
    print('feature: along the ray and across it, of the claimed deviations, by turn rate')
    for low, high in itertools.pairwise(bounds):
        some = normal[(rates >= low) & (rates <= high)]
        print(
            f'  {low:.2f} to {high:.2f} rad/s: {robust(some[:, 0]):.2f} {robust(some[:, 1]):.2f}'
        )
    print(f'  all: {robust(normal[:, 0]):.2f} {robust(normal[:, 1]):.2f}')
    fitted = ~np.isnan(found.explained[:, 0])
    own = np.array(
        [
            planar_rotation(-pose[2]) @ step
            for pose, step in zip(poses[fitted], found.corrections[fitted], strict=True)
        ]
    )
    spread = np.array([robust(column) for column in own.T])
    rest = 1e3 * np.sqrt(np.maximum(spread**2 - np.median(found.explained[fitted], axis=0), 0.0))
    print(
        f'frame: forward {rest[0]:.1f} mm, sideways {rest[1]:.1f} mm, heading {rest[2]:.1f} mrad'
    )
    correlations(frames, features, found.normal, found.inlier)
    neighbours(poses, features, found)


def neighbours(poses: Array, features: Features, found: Scatter) -> None:
    """Print how errors of features of one frame correlate, and how many independent ones count.

    Errors are those from true poses (F, 3), in units of the claimed deviations. The variance of
    the mean of n independent ones would be 1 / n.
    """
    world = place_all(poses, features)
    off = np.full_like(world, np.nan)
    for landmark in np.unique(features.landmark[found.inlier]):
        rows = np.flatnonzero(found.inlier & (features.landmark == landmark))
        if len(rows) >= MINIMUM_FRAMES:
            # of n places, of which the mean is one: (n - 1)/n of the variance is in the errors
            off[rows] = (world[rows] - world[rows].mean(axis=0)) * np.sqrt(
                len(rows) / (len(rows) - 1.0)
            )
    claimed = np.stack([features.along, features.across], axis=1)
    z = np.einsum('nij,nj->ni', ray_axes(poses, features), off) / claimed
    products, pairs = np.zeros((len(DISTANCES), 2)), np.zeros(len(DISTANCES))
    counts, sums = list[int](), list[Array]()
    for number in np.unique(features.frame):
        rows = np.flatnonzero((features.frame == number) & np.isfinite(z[:, 0]))
        if len(rows) < MINIMUM_FEATURES:
            continue
        counts.append(len(rows))
        sums.append(z[rows].sum(axis=0))
        a, b = np.triu_indices(len(rows), 1)
        apart = np.hypot(*(world[rows[a]] - world[rows[b]]).T)
        band = np.digitize(apart, DISTANCES) - 1
        np.add.at(pairs, band, 1.0)
        np.add.at(products, band, z[rows[a]] * z[rows[b]])
    variance = np.nanmean(z**2, axis=0)
    print('correlation by distance within a frame (m): along, across')
    for low, high, n, total in zip(
        DISTANCES, (*DISTANCES[1:], np.inf), pairs, products, strict=True
    ):
        if n >= MINIMUM_FEATURES:
            print(f'  {low:.2f} to {high:.2f}: {total[0] / n / variance[0]:5.2f} '
                  f'{total[1] / n / variance[1]:5.2f}')  # fmt: skip
    size = np.array(counts, np.float64)
    worth = (size**2).sum() / (np.array(sums) ** 2).sum(axis=0)
    print(
        f'mean of {size.mean():.0f} features of a frame: worth {worth[0]:.0f} along and '
        f'{worth[1]:.0f} across'
    )


def correlations(
    frames: list[Frame], features: Features, normal: Array, used: NDArray[np.bool_]
) -> None:
    """Print the correlation of the errors of a landmark in two frames of a vehicle."""
    way = np.array([[frame.driven, frame.turned, frame.vehicle] for frame in frames])
    pairs = list[Array]()
    for landmark in np.unique(features.landmark[used]):
        rows = np.flatnonzero(used & (features.landmark == landmark))
        a, b = np.triu_indices(len(rows), 1)
        a, b = rows[a], rows[b]
        between = way[features.frame[b]] - way[features.frame[a]]
        pairs.append(np.column_stack([between, normal[a], normal[b]]))
    table = np.concatenate(pairs)
    table = table[table[:, 2] == 0.0]
    for title, own, other in (('driven (m)', 0, 1), ('turned (rad)', 1, 0)):
        print(f'correlation by what was {title}: along, across (pairs)')
        for low, high in LAGS:
            some = (table[:, own] >= low) & (table[:, own] < high)
            some &= table[:, other] < 0.15
            if np.count_nonzero(some) < 50:
                continue
            rho = [
                2.0 * np.mean(table[some, 3 + n] * table[some, 5 + n])
                / np.mean(table[some, 3 + n] ** 2 + table[some, 5 + n] ** 2)
                for n in (0, 1)
            ]  # fmt: skip
            print(f'  {low:.2f} to {high:.2f}: {rho[0]:5.2f} {rho[1]:5.2f} ({some.sum()})')


def pixels(images: Iterable[NDArray[np.uint16] | NDArray[np.float32]]) -> None:
    """Print the noise of flat surfaces in depth images (H, W) in m, and what neighbours share.

    In a plane, 1 / depth is linear in the pixels (Konolige and Mihelich, Technical description of
    Kinect calibration, 2011): what a linear fit leaves of squares of the images is noise.
    """
    rows, columns = np.mgrid[:SQUARE, :SQUARE]
    basis = np.column_stack([np.ones(SQUARE**2), rows.ravel(), columns.ravel()])
    basis = np.linalg.qr(basis)[0]
    deviations, shared = list[float](), list[list[float]]()
    for depth in images:
        for row in range(0, depth.shape[0] - SQUARE + 1, SQUARE):
            for column in range(0, depth.shape[1] - SQUARE + 1, SQUARE):
                square = depth[row : row + SQUARE, column : column + SQUARE].astype(np.float64)
                if square.min() <= 0.0 or square.max() > VisionConfig().depth.max_depth:
                    continue
                inverse = 1.0 / square.ravel()
                noise = inverse - basis @ (basis.T @ inverse)
                deviation = float(noise.std())
                if deviation > ROUGH or np.abs(noise).max() > OUTLIER * deviation:
                    continue  # an edge
                noise = noise.reshape(SQUARE, SQUARE)
                deviations.append(deviation)
                shared.append([_shared(noise, lag) for lag in PIXEL_LAGS])
    if not shared:
        print('no flat surfaces')
        return
    print(f'noise of 1 / depth: {np.median(deviations):.4f} 1/m, in {len(shared)} flat squares')
    together = ' '.join(
        f'{lag}: {part:.2f}'
        for lag, part in zip(PIXEL_LAGS, np.median(shared, axis=0), strict=True)
    )
    print(f'shared by pixels that are apart by {together}')


def _shared(noise: Array, lag: int) -> float:
    """Return the autocorrelation of noise (n, n) at a lag along rows and columns."""
    products = noise[lag:] * noise[:-lag], noise[:, lag:] * noise[:, :-lag]
    return float(np.mean(products[0]) + np.mean(products[1])) / (2.0 * float(np.mean(noise**2)))


def tum_depths(folder: Path) -> Iterator[NDArray[np.float32]]:
    """Yield every tenth depth image (H, W) m of a TUM RGB-D folder."""
    for path in sorted((folder / 'depth').glob('*.png'))[::10]:
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        if image is not None:
            yield np.asarray(image, np.float32) * DEPTH_SCALE


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--tum', type=Path, help='folder of the TUM RGB-D benchmark')
    parser.add_argument('--office', type=float, help='seconds in the simulated office')
    parser.add_argument('--seed', type=int, default=0, help='of the simulation (default 0)')
    parser.add_argument(
        '--as-exposed', action='store_true', help='leave rolling shutters as they are'
    )
    options = parser.parse_args()
    undo = not options.as_exposed
    if options.tum is not None:
        print(options.tum.name)
        evaluate(tum(options.tum, undo))
        pixels(tum_depths(options.tum))
    if options.office is not None:
        print(f'office, {options.office:.0f} s, seed {options.seed}')
        evaluate(office(options.office, options.seed, undo))


if __name__ == '__main__':
    main()
