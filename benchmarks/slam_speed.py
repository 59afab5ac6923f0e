"""Speed and memory of the filter, relative to reference computations run beside it.

python benchmarks/slam_speed.py update      one update relative to one SIFT extraction
python benchmarks/slam_speed.py map         updates with 1,000 to 100,000 landmarks in the map
python benchmarks/slam_speed.py paper       relative to a literal transcription of the paper
python benchmarks/slam_speed.py vehicles    1, 2, 4, 8 vehicles: time and effective sample size
python benchmarks/slam_speed.py memory      1000 particles, 100,000 landmarks, 500 resamplings
python benchmarks/slam_speed.py index       recall and time beside brute force and FLANN
Times are medians over updates: cpu is the processor time of all threads, wall the elapsed time.
On a busy machine only cpu is comparable.
"""

import argparse
import resource
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import Intrinsics, LandmarkObservations, RgbdFrame
from explore_slam.geometry import Pose2, to_world
from explore_slam.recording.tum_format import read_associations
from explore_slam.settings import with_values
from explore_slam.slam import FastSlam, FastSlamConfig, warm_up
from explore_slam.slam.descriptors.index import BruteForceIndex, DescriptorIndex
from explore_slam.slam.descriptors.kd_forest import KdForestIndex
from explore_slam.slam.descriptors.kd_tree import KdTreeIndex
from explore_slam.slam.descriptors.kinds import Vectors

STEP = Pose2(0.1, 0.0, 0.05)
NOISE = np.diag([0.01, 0.005, 0.01]) ** 2
SEEN = 200
COVARIANCE = np.diag([0.03, 0.02, 0.02]) ** 2


def like_sift(random: np.random.Generator, count: int) -> NDArray[np.float32]:
    """Return random unit vectors, clipped and sparse like SIFT descriptors."""
    rows = random.gamma(0.3, 1.0, (count, 128)).astype(np.float32)
    rows = np.minimum(rows / np.linalg.norm(rows, axis=1, keepdims=True), 0.2)
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def timed(call: Callable[[], object]) -> tuple[float, float]:
    """Return wall and processor time (ms) of a call."""
    wall, cpu = time.perf_counter(), time.process_time()
    call()
    return 1e3 * (time.perf_counter() - wall), 1e3 * (time.process_time() - cpu)


def median(rows: list[tuple[float, float]]) -> tuple[float, float]:
    """Return the median wall and processor times."""
    wall, cpu = np.median(np.array(rows), axis=0)
    return float(wall), float(cpu)


class Corridor:
    """Landmarks on a ring around circling vehicles; the nearest `seen` are observed at each step.

    strangers: fraction of the observations with a descriptor that never occurs again.
    """

    def __init__(self, seed: int = 0, seen: int = SEEN, strangers: float = 0.0) -> None:
        self.random = np.random.default_rng(seed)
        self.seen = seen
        self.strangers = round(strangers * seen)
        ring = np.sort(self.random.uniform(0.0, 2.0 * np.pi, 6 * seen))
        radius = 2.0 + self.random.uniform(1.0, 3.0, len(ring))
        height = self.random.uniform(0.0, 1.5, len(ring))
        self.points = np.c_[radius * np.cos(ring), radius * np.sin(ring), height]
        self.descriptors = like_sift(self.random, len(ring))
        self.true: dict[str, Pose2] = {}

    def start(self, vehicles: int) -> dict[str, Pose2]:
        """Place the vehicles evenly on a circle of 2 m; return their start poses."""
        angles = 2.0 * np.pi * np.arange(vehicles) / vehicles
        self.true = {
            f'robot{i + 1}': Pose2(2.0 * np.cos(a), 2.0 * np.sin(a), a + 0.5 * np.pi)
            for i, a in enumerate(angles)
        }
        return dict(self.true)

    def step(self, vehicle: str, stamp: float) -> LandmarkObservations:
        """Drive one step and observe the nearest landmarks with noisy descriptors."""
        noise = self.random.standard_normal(3) * np.sqrt(np.diag(NOISE))
        self.true[vehicle] = self.true[vehicle].compose(Pose2(*(np.asarray(STEP) + noise)))
        local = to_world(np.asarray(self.true[vehicle].inverse()), self.points)
        near = np.argsort(np.hypot(local[:, 0], local[:, 1]))[: self.seen]
        noisy = local[near] + self.random.standard_normal((self.seen, 3)) @ np.sqrt(COVARIANCE)
        like = self.descriptors[near] + 0.03 * self.random.standard_normal((self.seen, 128))
        like /= np.linalg.norm(like, axis=1, keepdims=True)
        like[: self.strangers] = like_sift(self.random, self.strangers)
        covariances = np.tile(COVARIANCE, (self.seen, 1, 1))
        return LandmarkObservations(stamp, noisy, covariances, like.astype(np.float32))


def make(vehicles: int, corridor: Corridor, **values: object) -> FastSlam:
    """Make a filter with 1000 particles and the given settings."""
    config = with_values(FastSlamConfig(), {'particles': 1000} | values)
    return FastSlam(corridor.start(vehicles), config, seed=1)


def run_updates(
    slam: FastSlam, corridor: Corridor, steps: int, first: int = 0
) -> tuple[list[tuple[float, float]], list[float]]:
    """Drive all vehicles; return times and effective sample sizes of the updates."""
    times, effective = [], []
    for number in range(first, first + steps):
        for vehicle in slam.vehicles:
            seen = corridor.step(vehicle, float(number))
            slam.predict(vehicle, STEP, NOISE)
            times.append(timed(lambda v=vehicle, s=seen: effective.append(
                slam.update(v, s).effective_particles
            )))  # fmt: skip
    return times, effective


def extraction(folder: Path | None) -> tuple[list[RgbdFrame], str]:
    """Return frames and their name: recorded ones (TUM RGB-D), or random images."""
    import cv2

    intrinsics = Intrinsics(640, 480, 517.3, 516.5, 318.6, 255.3)
    if folder is not None:
        frames = []
        chosen = read_associations(folder / 'associations.txt')[:40:2]
        for number, association in enumerate(chosen):
            rgb = cv2.imread(str(folder / association.color_file))[:, :, ::-1].copy()
            depth = cv2.imread(str(folder / association.depth_file), cv2.IMREAD_UNCHANGED)
            metres = depth.astype(np.float32) / 5000.0
            frames.append(RgbdFrame(float(number), rgb, metres, intrinsics))
        return frames, str(folder.name)
    random = np.random.default_rng(0)
    frames = []
    for number in range(10):
        small = random.integers(0, 255, (60, 80, 3), dtype=np.uint8)
        rgb = cv2.resize(small, (640, 480), interpolation=cv2.INTER_CUBIC)
        depth = np.full((480, 640), 2.0, np.float32)
        frames.append(RgbdFrame(float(number), rgb, depth, intrinsics))
    return frames, 'random images'


def compare_update(folder: Path | None) -> None:
    """Compare an update (1000 particles, 200 observations) with the extraction of one frame."""
    from explore_slam.vision import CameraMount, FeatureExtractor, VisionConfig

    frames, name = extraction(folder)
    extractor = FeatureExtractor(VisionConfig(), CameraMount())
    extractor.extract(frames[0])
    corridor = Corridor()
    slam = make(1, corridor)
    run_updates(slam, corridor, 30)
    sift, update = [], []
    for number, frame in enumerate(frames):  # alternate, so that both run under the same load
        sift.append(timed(lambda f=frame: extractor.extract(f)))
        update += run_updates(slam, corridor, 1, 30 + number)[0]
    (sw, sc), (uw, uc) = median(sift), median(update)
    print(f'extraction of a 640 x 480 frame ({name}): wall {sw:.1f} ms, cpu {sc:.1f} ms')
    print(f'update, 1000 particles, {SEEN} observations: wall {uw:.1f} ms, cpu {uc:.1f} ms')
    print(f'update / extraction: wall {uw / sw:.2f}, cpu {uc / sc:.2f} (required: at most 0.5)')


def fill(slam: FastSlam, landmarks: int, random: np.random.Generator) -> None:
    """Insert landmarks far away, as if from an earlier part of the exploration.

    Resampling in between leaves the landmarks with few common ancestors.
    """
    particles = slam.config.particles
    while len(slam.map) < landmarks:
        count = min(500, landmarks - len(slam.map))
        addresses = slam.map.rows.allocate(count)
        data = slam.map.rows.workspace
        points = random.uniform(20.0, 120.0, (count, 3))
        data[addresses] = 0.0
        data[addresses, :3] = points[:, :, None]
        data[addresses, 3] = data[addresses, 6] = data[addresses, 8] = 0.01
        slam.map.add(addresses, like_sift(random, count), 0, points, slam.groups.of(0).tree)
        for _ in range(4):
            weights = random.exponential(size=particles)
            slam.resample_now(weights / weights.sum())


def compare_map() -> None:
    """Measure updates with increasing numbers of landmarks that are not in view.

    Without the joint graph: a redraw would remove landmarks that it has no observations of.
    """
    for strangers, required in ((0.0, ' (required: at most 1.3)'), (0.5, '')):
        print(f'{strangers:.0%} of {SEEN} observations are of new landmarks')
        base = 0.0
        for landmarks in (1_000, 10_000, 100_000):
            corridor = Corridor(strangers=strangers)
            slam = make(1, corridor, joint_graph=False)
            fill(slam, landmarks, np.random.default_rng(5))
            run_updates(slam, corridor, 30)
            times, _ = run_updates(slam, corridor, 40, 30)
            wall, cpu = median(times)
            base = base or cpu
            print(
                f'{len(slam.map):7d} landmarks: wall {wall:.1f} ms, cpu {cpu:.1f} ms, '
                f'{cpu / base:.2f} of the first{required}',
                flush=True,
            )


def compare_paper(landmarks: int) -> None:
    """Compare one step on the same data: 1000 particles, 2,000 landmarks, 20 observations."""
    from paper_transcription import PaperFastSlam

    corridor = Corridor(seen=20)
    slam = make(1, corridor, engine='paper', minimum_association_probability=0.5)
    fill(slam, landmarks, np.random.default_rng(5))
    start = np.asarray(corridor.true['robot1'])
    run_updates(slam, corridor, 10)
    ours, _ = run_updates(slam, corridor, 20, 10)
    corridor = Corridor(seen=20)
    corridor.start(1)
    particles = 100
    plain = PaperFastSlam(start, particles, 1, 0.5, 0.4)
    random = np.random.default_rng(5)
    far, descriptors = random.uniform(20.0, 120.0, (landmarks, 3)), like_sift(random, landmarks)
    for particle in plain.particles:
        particle.means = far.copy()
        particle.covariances = np.tile(0.01 * np.eye(3), (landmarks, 1, 1))
        particle.descriptors = descriptors.astype(np.float64)
        particle.rebuild_tree()
    theirs = []
    for number in range(3):
        seen = corridor.step('robot1', float(number))
        theirs.append(timed(lambda s=seen: plain.step(np.asarray(STEP), NOISE, s)))
    (ow, oc), (tw, tc) = median(ours), median(theirs)
    tw, tc = tw * 1000 / particles, tc * 1000 / particles
    print(f'engine paper: wall {ow:.2f} ms, cpu {oc:.2f} ms per step')
    print(
        f'transcription ({particles} particles run, times 1000 / {particles}): wall {tw:.0f} ms, '
        f'cpu {tc:.0f} ms: {tc / oc:.0f} times the engine (required: at least 100)'
    )


def compare_vehicles() -> None:
    """Measure cost per update and effective sample size by number of vehicles."""
    base = 0.0
    for vehicles in (1, 2, 4, 8):
        corridor = Corridor()
        slam = make(vehicles, corridor)
        run_updates(slam, corridor, 10)
        times, effective = run_updates(slam, corridor, 40 // vehicles + 5, 10)
        wall, cpu = median(times)
        base = base or cpu
        print(
            f'{vehicles} vehicles: wall {wall:.1f} ms, cpu {cpu:.1f} ms per update, '
            f'{cpu * vehicles / base:.2f} x per round of all, effective particles '
            f'{np.mean(effective):.0f} of 1000 (least {np.min(effective):.0f})',
            flush=True,
        )


def show_memory() -> None:
    """Insert 200 new landmarks before each of 500 resamplings of 1000 particles."""
    corridor = Corridor()
    slam = make(1, corridor)
    random = np.random.default_rng(3)
    weights = random.exponential(size=1000)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    for _ in range(500):
        count = 200
        addresses = slam.map.rows.allocate(count)
        data = slam.map.rows.workspace
        points = random.uniform(-50.0, 50.0, (count, 3))
        data[addresses] = 0.01
        data[addresses, :3] = points[:, :, None]
        slam.map.add(addresses, like_sift(random, count), 0, points, slam.groups.of(0).tree)
        weights = random.exponential(size=1000)
        slam.resample_now(weights / weights.sum())
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    rows = slam.map.rows
    print(
        f'{len(slam.map)} landmarks, 1000 particles, 500 resamplings: rows '
        f'{rows.rows_stored() / len(slam.map):.1f} per landmark, '
        f'slabs {rows.memory() / 2**20:.0f} MiB; process: peak {peak:.0f} MiB, '
        f'of it {before:.0f} MiB before (limit: 1024)'
    )


class FlannIndex:
    """Randomized kd-forest of FLANN (Muja and Lowe, VISAPP 2009), in OpenCV, built once."""

    def __init__(self, rows: NDArray[np.float32]) -> None:
        import cv2

        cv2.setRNGSeed(1)
        self.matcher = cv2.FlannBasedMatcher({'algorithm': 1, 'trees': 4}, {'checks': 64})
        self.matcher.add([rows])
        self.matcher.train()

    def query(self, rows: NDArray[np.float32], count: int) -> NDArray[np.int64]:
        """Return the nearest ids (K, count)."""
        found = self.matcher.knnMatch(rows, k=count)
        return np.array([[match.trainIdx for match in row] for row in found])


def lookup(index: DescriptorIndex, rows: Vectors, queries: Vectors, batch: int) -> str:
    """Fill an index in batches; return recall of the nearest neighbour and times as text."""

    def build() -> None:
        for begin in range(0, len(rows), batch):
            ids = np.arange(begin, begin + batch)
            index.add(ids, rows[ids])

    _, built = timed(build)
    index.query(queries, 0.4, 1)
    spent = median([timed(lambda: index.query(queries, 0.4, 1)) for _ in range(5)])
    recall = recall_of(index.query(queries, 0.4, 1)[0], rows, queries)
    return f'recall {recall:.3f}, 200 queries cpu {spent[1]:.1f} ms, building cpu {built:.0f} ms'


def recall_of(found: NDArray[np.int64], rows: Vectors, queries: Vectors) -> float:
    """Return the fraction of queries whose nearest neighbour was found."""
    brute = BruteForceIndex(128)
    brute.add(np.arange(len(rows)), rows)
    return float(np.mean(found == brute.query(queries, 0.4, 1)[0]))


def compare_index() -> None:
    """Compare recall of the nearest neighbour, time of 200 queries and time to build."""
    for landmarks in (1_000, 10_000, 100_000):
        random = np.random.default_rng(2)
        rows = like_sift(random, landmarks)
        queries = rows[random.choice(landmarks, 200)] + 0.03 * random.standard_normal((200, 128))
        queries = (queries / np.linalg.norm(queries, axis=1, keepdims=True)).astype(np.float32)
        print(f'{landmarks} landmarks')
        print('  forest:', lookup(KdForestIndex(128), rows, queries, 200), flush=True)
        print('  brute force:', lookup(BruteForceIndex(128), rows, queries, landmarks), flush=True)
        if landmarks <= 10_000:
            print(
                '  scipy kd-tree:', lookup(KdTreeIndex(128), rows, queries, landmarks), flush=True
            )
        flann = FlannIndex(rows)
        spent = median([timed(lambda f=flann, q=queries: f.query(q, 1)) for _ in range(5)])
        recall = recall_of(flann.query(queries, 1), rows, queries)
        print(f'  FLANN (64 checks): recall {recall:.3f}, 200 queries cpu {spent[1]:.1f} ms')


def main() -> None:
    """Run one comparison, or all."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n')[0])
    parser.add_argument(
        'what', choices=('update', 'map', 'paper', 'vehicles', 'memory', 'index', 'all')
    )
    parser.add_argument('--frames', type=Path, help='folder of frames in the layout of TUM RGB-D')
    parser.add_argument('--landmarks', type=int, default=2000, help='for paper')
    arguments = parser.parse_args()
    warm_up()
    what = arguments.what
    calls: dict[str, Callable[[], None]] = {
        'update': lambda: compare_update(arguments.frames),
        'map': compare_map,
        'paper': lambda: compare_paper(arguments.landmarks),
        'vehicles': compare_vehicles,
        'index': compare_index,
        'memory': show_memory,
    }
    for name, call in calls.items():
        if what in (name, 'all'):
            call()


if __name__ == '__main__':
    main()
