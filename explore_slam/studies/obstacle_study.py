"""Obstacle study: teams explore a world with table tops, shelves and steps, with depth or without.

Every run is a closed loop without ROS; contacts are those of the simulator, in which boards that
hang lower than a vehicle is high, and steps, stop it. With depth, the layer of obstacles from
depth images is in the map; without, everything else is the same.
"""

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from explore_slam.errors import EvaluationError
from explore_slam.files import write_text
from explore_slam.mapping import OccupancyGrid
from explore_slam.results import tables
from explore_slam.results.reachable_area import ReachableArea
from explore_slam.settings import with_values
from explore_slam.simulation import load_world
from explore_slam.simulation.records import HAZARD
from explore_slam.simulation.worlds.grid_world import FREE, GridWorld
from explore_slam.simulation.worlds.world import World
from explore_slam.studies.closed_loop import ClosedLoop, ClosedLoopConfig
from explore_slam.studies.consistency_study import seed_result
from explore_slam.studies.figures import new_figure
from explore_slam.studies.parallel import ALONE, Workers, make_runs
from explore_slam.vision.obstacles import ObstacleDetector

DEPTH = ('with', 'without')
_FINE = 0.05  # m, cells by which areas are compared
# m from a solid or hazard within which a free cell may be occupied: errors of the poses and of the
# ranges, and half a cell of either grid
_BESIDE = 0.1
_TIMED_FRAMES = 50  # of one run, that are detected once more to measure the time


@dataclass(frozen=True)
class ObstacleStudy:
    """Definition of a study; settings: of ClosedLoopConfig by name."""

    world: Path
    vehicles: int = 2
    depth: str = 'with'
    duration: float = 300.0
    seeds: Sequence[int] = tuple(range(10))
    settings: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.depth not in DEPTH:
            raise EvaluationError(f'depth is {self.depth!r}, expected one of {list(DEPTH)}')
        if not self.seeds:
            raise EvaluationError('obstacle study: no seeds, expected at least one')
        self.config()  # refuse a wrong setting before the first run

    def config(self) -> ClosedLoopConfig:
        """Return the configuration of its runs."""
        values = {'time_limit': self.duration, 'depth_obstacles': self.depth == 'with'}
        return with_values(ClosedLoopConfig(), dict(self.settings) | values)


@dataclass(frozen=True)
class ObstacleRun:
    """Figures of one run; areas as shares from 0 to 1.

    contacts: with walls and vehicles; hazards: with boards and steps.
    tops, pits: area of boards and of steps, seen from above, that is occupied in the map.
    lost: area that is occupied in the map, though it is free and not beside an obstacle, of all
    that is free.
    explored: of the reachable area. position_rms: worst of the vehicles (m).
    frame_ms: median time to find the obstacles of a frame (ms of processor time).
    """

    seed: int
    status: str
    duration: float
    contacts: int
    hazards: int
    tops: float
    pits: float
    lost: float
    explored: float
    position_rms: float
    frame_ms: float


def run_seed(study: ObstacleStudy, seed: int, output: Path) -> ObstacleRun:
    """Make the run of one seed; write its map as `output/seed_N.png`."""
    config = study.config()
    loop = _TimedLoop(study.world, config, study.vehicles, seed)
    data = loop.run()
    world = load_world(study.world)
    height = config.simulation.base.simulated_height
    truth = Truth(world, height)
    grid = loop.agent.grid
    log = loop.simulator.collision_log
    rms = [run.position_rms for run in seed_result(seed, data).runs]
    result = ObstacleRun(
        seed=seed,
        status=str(data.metrics['status']),
        duration=float(data.metrics['duration']),
        contacts=sum(one.obstacle != HAZARD for one in log),
        hazards=sum(one.obstacle == HAZARD for one in log),
        tops=truth.share(grid, truth.tops),
        pits=truth.share(grid, truth.pits),
        lost=truth.share(grid, truth.free),
        explored=loop.coverage,
        position_rms=max(rms),
        frame_ms=loop.frame_ms(),
    )
    plot_map(grid, truth, output / f'seed_{seed}.png')
    return result


class _TimedLoop(ClosedLoop):
    """A closed loop that keeps some frames, to measure how long detection takes."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._frames: list[Any] = []

    def _add(self, name: str, record: Any) -> None:
        if hasattr(record, 'depth') and len(self._frames) < _TIMED_FRAMES:
            self._frames.append(record)
        super()._add(name, record)

    def frame_ms(self) -> float:
        """Return the median processor time (ms) of detection; NaN without frames."""
        detector, spent = ObstacleDetector(self.config.agent.vision), []
        for frame in self._frames:
            begun = time.thread_time()
            detector.detect(frame)
            spent.append(1e3 * (time.thread_time() - begun))
        return float(np.median(spent)) if spent else float('nan')


class Truth:
    """Cells of a world, as points: of boards, of pits, and free ones not beside any obstacle.

    height: of the vehicles (m); what hangs higher does not count.
    """

    def __init__(self, world: World, height: float) -> None:
        laser = GridWorld.from_world(world, _FINE)
        full = GridWorld.from_world(world, _FINE, height)
        hazard = (laser.cells == FREE) & (full.cells != FREE)
        centers = full.to_point(np.argwhere(hazard))
        in_pit = np.zeros(len(centers), np.bool_)
        for pit in world.pits:
            off = np.abs(centers - (pit.x, pit.y))
            in_pit |= (off <= (pit.half_x, pit.half_y)).all(axis=1)
        self.world = world
        self.tops, self.pits = centers[~in_pit], centers[in_pit]
        inside = full.to_point(np.argwhere(full.clearance > _BESIDE))
        starts = world.starts.values()
        reach = ReachableArea(full, starts, _FINE).cells
        keys = {tuple(cell) for cell in full.to_cell(reach).tolist()}
        kept = [tuple(cell) in keys for cell in full.to_cell(inside).tolist()]
        self.free = inside[kept]

    @staticmethod
    def share(grid: OccupancyGrid, points: NDArray[np.float64]) -> float:
        """Return the share of points (N, 2) m that are occupied in a map; NaN without points."""
        if not len(points):
            return float('nan')
        cells = grid.to_cell(points)
        cells = cells[grid.contains(cells)]
        occupied = grid.to_trinary() == 100
        return float(occupied[cells[:, 0], cells[:, 1]].sum()) / len(points)


def run_study(
    study: ObstacleStudy, output: Path, workers: Workers = ALONE
) -> Iterator[ObstacleRun]:
    """Yield the run of each seed in order; obstacles.json and the table grow with them."""
    output.mkdir(parents=True, exist_ok=True)
    runs: list[ObstacleRun] = []
    for run in make_runs(run_seed, [(study, seed, output) for seed in study.seeds], workers):
        runs.append(run)
        save_results(study, runs, output)
        yield run


def save_results(study: ObstacleStudy, runs: Sequence[ObstacleRun], output: Path) -> Path:
    """Write obstacles.json and table.md; return the path of the former."""
    content = {
        'world': str(study.world),
        'vehicles': study.vehicles,
        'depth': study.depth,
        'duration': study.duration,
        'settings': dict(study.settings),
        'runs': [asdict(run) for run in runs],
    }
    path = output / 'obstacles.json'
    tables.write_json(path, content)
    write_text(output / 'table.md', markdown_table(runs))
    return path


HEADER = (
    'seed', 'status', 'time (s)', 'contacts', 'with boards or steps', 'tops in the map',
    'steps in the map', 'free area lost', 'explored', 'position RMS (m)', 'ms per frame',
)  # fmt: skip


def markdown_table(runs: Sequence[ObstacleRun]) -> str:
    """Return the table of a study."""
    rows = [
        (
            str(run.seed), run.status, f'{run.duration:.0f}', str(run.contacts), str(run.hazards),
            f'{run.tops:.1%}', f'{run.pits:.1%}', f'{run.lost:.2%}', f'{run.explored:.1%}',
            f'{run.position_rms:.4f}', f'{run.frame_ms:.1f}',
        )
        for run in runs
    ]  # fmt: skip
    return tables.markdown_table(HEADER, rows) + '\n'


def plot_map(grid: OccupancyGrid, truth: Truth, path: Path) -> None:
    """Draw a map, with the outlines of boards and pits."""
    figure, axes = new_figure(rows=1, width=8.0, height=6.0)
    axis = axes.flat[0]
    (x, y), (rows, columns) = grid.origin, grid.shape
    side = grid.resolution
    shade = np.where(grid.known(), 1.0 - grid.probability(), 0.75)
    axis.imshow(
        shade,
        origin='lower',
        extent=(x, x + columns * side, y, y + rows * side),
        cmap='gray',
        vmin=0.0,
        vmax=1.0,
    )
    for points, color in ((truth.tops, '#d95f02'), (truth.pits, '#1f78b4')):
        axis.plot(points[:, 0], points[:, 1], '.', color=color, markersize=0.8)
    x0, y0, x1, y1 = truth.world.bounds
    axis.set(xlim=(x0, x1), ylim=(y0, y1), xlabel='x (m)', ylabel='y (m)', aspect='equal')
    axis.set_title('occupied in the map; true table tops and shelves (orange), steps (blue)')
    figure.savefig(path, dpi=110)
