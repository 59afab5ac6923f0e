"""Endurance study: memory, map and update time of a team that patrols after exploring.

A closed loop without ROS; features are extracted on the vehicles, so that the time of an update is
that of the filter. Samples are written during the run.
"""

import json
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from explore_slam.errors import EvaluationError
from explore_slam.files import write_text
from explore_slam.settings import with_values
from explore_slam.studies.closed_loop import ClosedLoop, ClosedLoopConfig
from explore_slam.studies.figures import new_figure
from explore_slam.studies.patrol import Patrol


class Sample(NamedTuple):
    """State at a simulated time t (s).

    memory_mb: resident memory of the process (MiB). landmarks: of the best particle. update_ms:
    median wall time of the updates since the last sample, NaN without any. anchors: keyframes
    with a scan that later ones are searched on. keyframes: variables of the joint graphs.
    """

    t: float
    memory_mb: float
    landmarks: int
    update_ms: float
    anchors: int
    keyframes: int


@dataclass(frozen=True)
class EnduranceStudy:
    """Definition of a study; period (s) between samples, settings of ClosedLoopConfig by name."""

    world: Path
    vehicles: int = 2
    duration: float = 3600.0
    seed: int = 0
    period: float = 60.0
    settings: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not (math.isfinite(self.period) and 0.0 < self.period <= self.duration):
            raise EvaluationError(
                f'endurance study: period is {self.period} s, expected 0 to {self.duration} s'
            )
        self.config()

    def config(self) -> ClosedLoopConfig:
        """Return the configuration of the run; ConfigError for a wrong setting."""
        return with_values(ClosedLoopConfig(), dict(self.settings) | {'time_limit': self.duration})


def run_study(study: EnduranceStudy, output: Path) -> Iterator[Sample]:
    """Yield a sample per period; endurance.json and endurance.png grow with them."""
    output.mkdir(parents=True, exist_ok=True)
    loop = ClosedLoop(study.world, study.config(), study.vehicles, study.seed, vision='vehicle')
    samples: list[Sample] = []
    patrol: Patrol | None = None
    explored: float | None = None
    try:
        while loop.simulator.time < study.duration:
            loop.step()
            now = loop.simulator.time
            if patrol is None and loop.planner.result.status.explored:
                patrol = Patrol(loop.agent, loop.area.cells, study.seed)
                loop.planner, explored = patrol, now
            if now >= study.period * (len(samples) + 1) - 1e-6:
                samples.append(take_sample(loop))
                content = {
                    'world': str(study.world),
                    'vehicles': study.vehicles,
                    'seed': study.seed,
                    'settings': dict(study.settings),
                    'explored_at': explored,
                    'waypoints_reached': 0 if patrol is None else patrol.reached,
                    'collisions': loop.simulator.collisions,
                }
                save_samples(samples, content, output)
                yield samples[-1]
    finally:
        loop.simulator.close()


def take_sample(loop: ClosedLoop) -> Sample:
    """Return the current state of a closed loop, and forget what it has recorded until now."""
    seconds = loop.update_seconds
    sample = Sample(
        loop.simulator.time,
        resident_memory(),
        len(loop.agent.landmarks()),
        1e3 * float(np.median(seconds)) if seconds else math.nan,
        len(loop.agent.loops.search.anchors),
        loop.agent.belief.graph_keyframes(),
    )
    loop.discard_records()
    return sample


def resident_memory() -> float:
    """Return the resident memory of this process (MiB)."""
    pages = int(Path('/proc/self/statm').read_text(encoding='ascii').split()[1])
    return pages * os.sysconf('SC_PAGE_SIZE') / 2**20


def save_samples(samples: Sequence[Sample], content: Mapping[str, Any], output: Path) -> Path:
    """Write endurance.json (content, and a list per field of Sample) and endurance.png."""
    series = {
        name: [None if math.isnan(value) else value for value in column]
        for name, column in zip(Sample._fields, zip(*samples, strict=True), strict=True)
    }
    path = output / 'endurance.json'
    write_text(path, json.dumps(dict(content) | series, indent=2, allow_nan=False) + '\n')
    plot_samples(samples, output / 'endurance.png')
    return path


def plot_samples(samples: Sequence[Sample], path: Path) -> None:
    """Plot all series over time."""
    table = np.array(samples, dtype=np.float64)
    labels = ('memory (MiB)', 'landmarks', 'update (ms)', 'anchors', 'keyframes in the graph')
    figure, axes = new_figure(columns=3, rows=2, height=2.6)
    axes.flat[-1].set_axis_off()
    for axis, values, label in zip(axes.flat, table[:, 1:].T, labels, strict=False):
        axis.plot(table[:, 0] / 60.0, values, marker='.')
        axis.set(xlabel='time (min)', ylabel=label, xlim=(0.0, None), ylim=(0.0, None))
    figure.savefig(path, dpi=110)
