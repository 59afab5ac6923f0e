"""The folder that a run writes: map, trajectories, landmarks, configuration, metrics, report.

Contents: map.pgm and map.yaml (map_server), `<vehicle>_<kind>.tum` trajectories, landmarks.ply,
settings.yaml (effective configuration), metrics.json, report.html. `latest` links to the newest
folder.
"""

import json
import logging
import re
from collections.abc import Callable, Mapping
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from explore_slam.errors import EvaluationError, ExploreSlamError
from explore_slam.failures import cause
from explore_slam.files import replace_link, write_bytes, write_text
from explore_slam.mapping import OccupancyGrid, save_map
from explore_slam.results.report import render_report
from explore_slam.results.run_data import LandmarkCloud, RunData
from explore_slam.results.tables import json_value
from explore_slam.results.trajectory import Trajectory, save_tum
from explore_slam.settings import Section, save_settings

logger = logging.getLogger(__name__)

KINDS = ('estimated', 'online', 'true', 'odometry')
LATEST = 'latest'


class RunFolder:
    """Writes the results of one run; every file is written atomically."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @classmethod
    def create(cls, base: Path, now: datetime | None = None) -> 'RunFolder':
        """Make `base/<local time>/` and link `base/latest` to it."""
        stem = (now or datetime.now().astimezone()).strftime('%Y-%m-%d_%H-%M-%S')
        try:
            base.mkdir(parents=True, exist_ok=True)
            for number in range(1, 1000):
                path = base / (stem if number == 1 else f'{stem}_{number}')
                try:
                    path.mkdir()
                    break
                except FileExistsError:
                    continue
            else:
                raise EvaluationError(f'{base} already holds 999 runs named {stem}')
            _link_latest(base, path.name)
        except OSError as error:
            raise EvaluationError(f'a run folder cannot be made in {base}: {error}') from error
        return cls(path)

    def write_map(self, grid: OccupancyGrid) -> Path:
        """Write map.pgm and map.yaml; return the path of the YAML file."""
        save_map(grid, self.path / 'map')
        return self.path / 'map.yaml'

    def write_trajectory(
        self, vehicle: str, kind: str, stamps: ArrayLike, poses: ArrayLike
    ) -> Path:
        """Write `<vehicle>_<kind>.tum`; kind: estimated, online, true or odometry."""
        if kind not in KINDS:
            raise EvaluationError(f'trajectory kind is {kind!r}, expected one of {list(KINDS)}')
        path = self.path / f'{file_name(vehicle)}_{kind}.tum'
        save_tum(path, Trajectory.of(stamps, poses))
        return path

    def write_landmarks(self, landmarks: LandmarkCloud) -> Path:
        """Write landmarks.ply: position and standard deviation (m), number of observations."""
        path = self.path / 'landmarks.ply'
        save_ply(path, landmarks)
        return path

    def write_config(self, section: Section) -> Path:
        """Write settings.yaml, a ROS parameter file that `replay --config` reads."""
        path = self.path / 'settings.yaml'
        save_settings(section, path)
        return path

    def write_metrics(self, metrics: Mapping[str, Any]) -> Path:
        """Write metrics.json; a value that is not finite becomes null."""
        path = self.path / 'metrics.json'
        text = json.dumps(json_value(metrics), indent=2, sort_keys=False, allow_nan=False)
        write_text(path, text + '\n')
        return path

    def write_report(self, data: RunData) -> Path:
        """Write report.html, which is self-contained."""
        path = self.path / 'report.html'
        write_text(path, render_report(data))
        return path

    def write_run(self, data: RunData) -> Path:
        """Write all files of a run; return the path of the report.

        A file that cannot be written, on a full disk, does not keep the others from being written;
        the report is the last one. EvaluationError then names those that are missing.
        """
        writers: list[Callable[[], object]] = []
        if data.grid is not None:
            writers.append(partial(self.write_map, data.grid))
        for vehicle in data.vehicles:
            for kind, trajectory in vehicle.trajectories().items():
                writers.append(
                    partial(
                        self.write_trajectory,
                        vehicle.name,
                        kind,
                        trajectory.stamps,
                        trajectory.poses,
                    )
                )
        if data.landmarks is not None:
            writers.append(partial(self.write_landmarks, data.landmarks))
        if data.settings is not None:
            writers.append(partial(self.write_config, data.settings))
        writers.append(partial(self.write_metrics, data.metrics))
        writers.append(partial(self.write_report, data))
        problems: list[str] = []
        for write in writers:
            try:
                write()
            except (OSError, ExploreSlamError) as error:
                problems.append(cause(error))
        if problems:
            raise EvaluationError(
                f'{len(problems)} of {len(writers)} results cannot be written, the others are in '
                f'{self.path}: {"; ".join(problems)}'
            )
        return self.path / 'report.html'


def file_name(vehicle: str) -> str:
    """Return the name of a vehicle, perhaps a namespace with slashes, as part of a file name."""
    return re.sub(r'[^A-Za-z0-9.-]+', '_', vehicle).strip('_') or 'vehicle'


def save_ply(path: Path, landmarks: LandmarkCloud) -> None:
    """Write landmarks as a binary PLY point cloud, which MeshLab, CloudCompare and Open3D read."""
    means = np.asarray(landmarks.means, dtype=np.float64).reshape(-1, 3)
    table = np.empty(
        len(means), [('x', '<f4'), ('y', '<f4'), ('z', '<f4'), ('sigma', '<f4'), ('count', '<u4')]
    )
    table['x'], table['y'], table['z'] = means.T
    covariances = np.asarray(landmarks.covariances).reshape(-1, 3, 3)
    table['sigma'] = np.sqrt(np.maximum(np.trace(covariances, axis1=1, axis2=2), 0.0))
    table['count'] = np.asarray(landmarks.counts).reshape(-1)
    header = (
        'ply\nformat binary_little_endian 1.0\n'
        'comment landmarks of the best particle, map frame, m\n'
        f'element vertex {len(table)}\n'
        'property float x\nproperty float y\nproperty float z\n'
        'property float sigma\nproperty uint count\nend_header\n'
    )
    write_bytes(path, header.encode('ascii') + table.tobytes())


def _link_latest(base: Path, name: str) -> None:
    link = base / LATEST
    if link.exists() and not link.is_symlink():
        logger.warning('%s is not a symbolic link and is left as it is', link)
        return
    try:
        replace_link(link, name)
    except OSError as error:
        logger.warning('%s cannot be linked to %s: %s', link, name, error)
